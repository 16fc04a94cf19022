"""`bp2 paper figures FIGURE`: a figure of the paper with every number in it; `bp2 paper
figures --all`: all of them."""

import dataclasses
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.base.folders import open_report
from bp2_rl.base.metric import Table
from bp2_rl.base.serialization import load_config, save_config, to_json
from bp2_rl.cli.app import Command, choose, entries
from bp2_rl.cli.printing import print_table
from bp2_rl.cli.trajopt import spinner
from bp2_rl.paper.cli.index import FLAG, make_all
from bp2_rl.paper.cli.report import with_folder
from bp2_rl.paper.figures.registry import FIGURES, draw
from bp2_rl.paper.index.item import Statement, statements_of

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn

OUT = Path("reports/figures")
METRICS = "metrics.json"


@dataclasses.dataclass(frozen=True)
class FigureReport:
    """The content of a figure's metrics.json."""

    figure: str
    settings: dict[str, Any]
    comparisons: tuple[Statement, ...]  # items of the paper, where the figure has them
    results: dict[str, Any]


def _figure(name: str, arguments: Any) -> None:
    """Draw a figure as the command line says, print its tables, and leave its
    report."""
    require_name(arguments.out)
    if arguments.out.exists():
        open_figure_folder(arguments.out, name)  # before the work
    with spinner(name):
        drawn = draw(name, arguments.settings)  # a mistake leaves no folder
    open_figure_folder(arguments.out, name)
    show_and_leave(arguments, name, drawn)
    print(f"pictures and numbers: {arguments.out}")


def open_figure_folder(folder: Path, name: str) -> None:
    """Make the folder of a figure's report, before anything is written to it.

    Raises:
        UserError: it cannot be made or written, or holds anything but an old report of
            this figure.
    """
    open_report(folder, METRICS, "report")
    if not (folder / METRICS).is_file():
        return
    if (old := load_config(FigureReport, folder / METRICS).figure) != name:
        raise UserError(
            f"--out {folder} holds a report of {old}: name another folder for {name}"
        )


def show_and_leave(arguments: Any, name: str, drawn: "Drawn") -> None:
    """Print a figure's tables and its verdicts on the paper's items, and write numbers
    and pictures to the folder `arguments.out`."""
    from bp2_rl.base.plotting import save_figure

    found = drawn.results
    results: dict[str, Any] = (
        {kind: [to_json(one) for one in found[kind]] for kind in found}
        if isinstance(found, dict)
        else to_json(found)
    )
    said = statements_of(name, {"results": results})
    for table in drawn.tables:
        print_table(table)
    if said:
        rows = [
            (
                f"{s.item}: {s.paper}",
                s.ours,
                ": ".join(filter(None, (s.verdict, s.because))),
            )
            for s in said
        ]
        head = "The paper", "Here", ""
        print_table(Table("What the paper says", head, rows), folded=True)
    settings = to_json(arguments.settings)
    save_config(arguments.out / METRICS, FigureReport(name, settings, said, results))
    for picture, figure in drawn.pictures.items():
        save_figure(figure, arguments.out / f"{picture}.{arguments.format}")


COMMANDS = entries(
    {
        name: Command(
            f"bp2 paper figures {name}",
            with_folder(settings, OUT / name),
            partial(_figure, name),
        )
        for name, (settings, _) in FIGURES.items()
    }
) | {
    FLAG: (
        "every figure, and a page with our result for each item of the paper",
        make_all,
    )
}


def main(words: Sequence[str]) -> int:
    """Run the figure that `words` name; return its exit status."""
    # wherever --all stands
    return choose(
        "bp2 paper figures", COMMANDS, sorted(words, key=lambda word: word != FLAG)
    )
