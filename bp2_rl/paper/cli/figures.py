"""`bp2 paper figures FIGURE`: a figure of the paper with every number in it; `bp2 paper figures --all`: all of them."""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.base.folders import open_report
from bp2_rl.base.serialization import load_config, save_config, to_json
from bp2_rl.cli import app
from bp2_rl.cli.dispatch import choose
from bp2_rl.paper.cli.index import FLAG, run_all
from bp2_rl.paper.figures.registry import FIGURES, FigureEntry

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn

OUT = Path("reports/figures")
METRICS = "metrics.json"
NARROWEST = 130  # columns of a table: a number that is cut off is worse than a line that is folded


@dataclasses.dataclass(frozen=True)
class FigureReport:
    """What metrics.json holds."""

    figure: str
    panel: str  # of the paper
    settings: dict[str, Any]
    comparisons: tuple[dict[str, Any], ...]
    results: dict[str, Any]


def main(argv: Sequence[str] | None = None) -> int:
    """The figure that `argv` (the process's arguments by default) names; the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if FLAG in words:
        return run_all(words)
    commands = {name: f"{entry.what} ({entry.panel})" for name, entry in FIGURES.items()}
    commands[FLAG] = "every panel that can be made, and a page that says of each item of the paper what is ours"
    return choose("bp2 paper figures", commands, words, _run)


def _run(name: str, argv: Sequence[str]) -> int:
    return app.run(lambda: _figure(name, argv))


def _figure(name: str, argv: Sequence[str]) -> None:
    """Draw a figure as the command line says, print its tables, and leave its report."""
    entry = FIGURES[name]
    arguments = app.parse(_arguments(name, entry), argv, f"bp2 paper figures {name}")
    require_name(arguments.out)
    drawn = entry.draw(arguments.settings)  # what it is told is read first: a mistake leaves no folder
    open_folder(arguments.out, name)
    show(drawn)
    leave(arguments.out, name, arguments.settings, drawn)
    print(f"pictures and numbers: {arguments.out}")


def _arguments(name: str, entry: FigureEntry) -> type[Any]:
    """The figure's settings, and where its report goes."""
    where = tyro.conf.arg(metavar="DIR", help="the report's folder")
    fields = (
        ("settings", Annotated[entry.settings, tyro.conf.arg(name="")], entry.settings()),
        ("out", Annotated[Path, where], OUT / name),
    )
    return dataclasses.make_dataclass("Arguments", fields, frozen=True, namespace={"__doc__": entry.settings.__doc__})


def open_folder(folder: Path, name: str) -> None:
    """Make a folder for a figure's report, before anything is written to it.

    Raises:
        UserError: it cannot be made or written, or holds anything but an old report of this figure.
    """
    open_report(folder, METRICS, "report")
    if (folder / METRICS).is_file() and (old := load_config(FigureReport, folder / METRICS).figure) != name:
        raise UserError(f"--out {folder} holds a report of {old}: name another folder for {name}")


def leave(folder: Path, name: str, settings: Any, drawn: "Drawn") -> None:
    """Write a figure's pictures and numbers to a folder that `open_folder` opened."""
    from bp2_rl.base.plotting import save_figure

    said = tuple(to_json(comparison) for comparison in drawn.comparisons)
    report = FigureReport(name, FIGURES[name].panel, to_json(settings), said, to_json(drawn.results))
    save_config(folder / METRICS, report)
    for picture, figure in drawn.pictures.items():
        save_figure(figure, folder / f"{picture}.png")


def show(drawn: "Drawn") -> None:
    """A figure's tables, and what comes of the paper's statements, on the terminal."""
    console = Console(width=max(Console().width, NARROWEST))
    for title, head, lines, words in drawn.tables:
        table = Table(title=title, title_justify="left", title_style="bold")
        for place, column in enumerate(head):
            table.add_column(
                column,
                no_wrap=place == 0,
                justify="left" if place == 0 or (words and place == len(head) - 1) else "right",
            )
        for line in lines:
            table.add_row(*map(Text, line))
        console.print(table)
    if not drawn.comparisons:
        return
    table = Table("The paper", "Here", "", title="What the paper says", title_justify="left", title_style="bold")
    for said in drawn.comparisons:
        verdict = ": ".join(filter(None, (said.verdict, said.because)))
        table.add_row(*map(Text, (said.paper, said.ours, verdict)))
    console.print(table)
