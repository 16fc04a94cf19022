"""`bp2 paper figures FIGURE`: a figure of the paper with every number in it; `bp2 paper
figures --all`: all of them."""

import dataclasses
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from bp2_rl.base.files import require_name, write_npz
from bp2_rl.base.serialization import load_config, save_config, to_json
from bp2_rl.cli.app import Command, Entry, choose
from bp2_rl.cli.trajopt import spinner
from bp2_rl.paper.cli.index import FLAG, make_all
from bp2_rl.paper.cli.report import METRICS, open_folder, print_table, with_folder
from bp2_rl.paper.figures.registry import FIGURES, draw

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn

OUT = Path("reports/figures")
COLUMNS = 130  # of a table


@dataclasses.dataclass(frozen=True)
class FigureReport:
    """What metrics.json holds."""

    figure: str
    settings: dict[str, Any]
    comparisons: tuple[dict[str, Any], ...]
    results: dict[str, Any]


def _figure(name: str, arguments: Any) -> None:
    """Draw a figure as the command line says, print its tables, and leave its
    report."""
    require_name(arguments.out)
    report = (
        arguments.out,
        name,
        lambda metrics: load_config(FigureReport, metrics).figure,
    )
    if arguments.out.exists():
        open_folder(*report)  # before the work
    with spinner(name):
        drawn = draw(name, arguments.settings)  # a mistake leaves no folder
    open_folder(*report)
    show(drawn)
    leave(arguments, name, drawn)
    print(f"pictures and numbers: {arguments.out}")


def leave(arguments: Any, name: str, drawn: "Drawn") -> None:
    """Write a figure's pictures and numbers to the open folder that its arguments
    name."""
    from bp2_rl.base.plotting import save_figure

    said = tuple(to_json(comparison) for comparison in drawn.comparisons)
    several, found = isinstance(drawn.results, dict), drawn.results
    results = (
        {kind: [to_json(one) for one in found[kind]] for kind in found}
        if several
        else to_json(found)
    )
    report = FigureReport(name, to_json(arguments.settings), said, results)
    save_config(arguments.out / METRICS, report)
    if drawn.arrays:
        write_npz(arguments.out / f"{name}.npz", drawn.arrays, compressed=True)
    for picture, figure in drawn.pictures.items():
        save_figure(figure, arguments.out / f"{picture}.{arguments.format}")


def show(drawn: "Drawn") -> None:
    """A figure's tables, and what comes of the paper's statements, on the terminal."""
    for title, head, lines, words in drawn.tables:
        table = Table(title=title, title_justify="left", title_style="bold")
        for place, column in enumerate(head):
            table.add_column(
                column,
                no_wrap=place == 0,
                justify="left"
                if place == 0 or (words and place == len(head) - 1)
                else "right",
            )
        for line in lines:
            table.add_row(*map(Text, line))
        print_table(table, COLUMNS)
    if not drawn.comparisons:
        return
    table = Table(
        "The paper",
        "Here",
        "",
        title="What the paper says",
        title_justify="left",
        title_style="bold",
    )
    for said in drawn.comparisons:
        verdict = ": ".join(filter(None, (said.verdict, said.because)))
        table.add_row(*map(Text, (said.paper, said.ours, verdict)))
    print_table(table, COLUMNS)


def _entry(name: str, settings: type[Any]) -> Entry:
    command = Command(
        f"bp2 paper figures {name}",
        with_folder(settings, OUT / name),
        partial(_figure, name),
    )
    return (settings.__doc__ or "").splitlines()[0], command


COMMANDS = {name: _entry(name, settings) for name, (settings, _) in FIGURES.items()} | {
    FLAG: (
        "every panel that can be made, and a page that says of each item of the paper what is ours",
        make_all,
    )
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the figure that `argv` (the process's arguments by default) names; return its
    exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    # wherever --all stands
    return choose(
        "bp2 paper figures", COMMANDS, sorted(words, key=lambda word: word != FLAG)
    )
