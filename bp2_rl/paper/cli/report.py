"""What commands of the paper share: where a report goes, what may be in its folder, and
tables on the terminal."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import open_report

METRICS = "metrics.json"


def with_folder(settings: type[Any], out: Path) -> type[Any]:
    """Return the arguments of a command: its `settings`, `out`, the folder where its
    report goes, and `format`."""
    where = tyro.conf.arg(metavar="DIR", help="the report's folder")
    how = tyro.conf.arg(help="of the pictures")
    fields = (
        ("settings", Annotated[settings, tyro.conf.arg(name="")], settings()),
        ("out", Annotated[Path, where], out),
        ("format", Annotated[Literal["png", "pdf", "svg"], how], "png"),
    )
    return dataclasses.make_dataclass(
        "Arguments", fields, frozen=True, namespace={"__doc__": settings.__doc__}
    )


def open_folder(folder: Path, name: str, read_name: Callable[[Path], str]) -> None:
    """Make a folder for a command's report, before anything is written to it.

    Args:
        folder: what --out names.
        name: the command's, as `read_name` reads it from `METRICS` of a report.
        read_name: raises UserError for another kind of report.

    Raises:
        UserError: it cannot be made or written, or holds anything but an old report of
            this command.
    """
    open_report(folder, METRICS, "report")
    if (folder / METRICS).is_file() and (old := read_name(folder / METRICS)) != name:
        raise UserError(
            f"--out {folder} holds a report of {old}: name another folder for {name}"
        )


def print_table(table: Table, columns: int) -> None:
    """Print a table on so many columns at least: a number that is cut off is worse than
    a line that is folded."""
    Console(width=max(Console().width, columns)).print(table)
