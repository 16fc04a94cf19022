"""What a command leaves: metrics.json with every number, the arrays of its picture, the picture; and what it prints."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.status import Status
from rich.table import Table

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import write_npz
from bp2_rl.base.folders import open_report
from bp2_rl.base.serialization import load_config, save_config, to_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = "metrics.json"


@dataclasses.dataclass(frozen=True)
class PendulumReport:
    """What metrics.json holds."""

    command: str
    settings: dict[str, Any]
    results: dict[str, Any]


def open_folder(folder: Path, command: str) -> None:
    """Make a folder for a command's report, before anything is computed for it.

    Raises:
        UserError: it cannot be made or written, or holds anything but an old report of this command.
    """
    open_report(folder, METRICS, "report")
    if (folder / METRICS).is_file() and (
        old := load_config(PendulumReport, folder / METRICS).command
    ) != f"pendulum {command}":
        raise UserError(f"--out {folder} holds a report of {old}: name another folder for pendulum {command}")


def leave(
    folder: Path, command: str, arguments: Any, results: Mapping[str, Any], arrays: Mapping[str, Any], figure: "Figure"
) -> None:
    """Write the report and say where it is.

    Args:
        folder: opened by `open_folder`.
        command: its name, and that of its files.
        arguments: a dataclass, what the command was told.
        results: dataclasses, or sequences of them, by name: the numbers that the picture and the terminal show.
        arrays: what the picture's curves are drawn from.
        figure: the picture.
    """
    from bp2_rl.base.plotting import save_figure

    settings = {name: value for name, value in to_json(arguments).items() if name != "out"}
    written = {name: _plain(value) for name, value in results.items()}
    save_config(folder / METRICS, PendulumReport(f"pendulum {command}", settings, written))
    write_npz(folder / f"{command}.npz", arrays, compressed=True)
    save_figure(figure, folder / f"{command}.png")
    print(f"picture, numbers and curves: {folder}")


def tabulate(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on the terminal."""
    table = Table(*columns)
    for row in rows:
        table.add_row(*row)
    # A number that is cut off is worse than a line that is folded.
    Console(width=max(Console().width, 110)).print(table)


def spinner(text: str) -> Status:
    """Something that turns on standard error while there is nothing to count."""
    return Console(stderr=True).status(text)


def _plain(value: Any) -> Any:
    """The JSON of a dataclass or of several."""
    return to_json(value) if dataclasses.is_dataclass(value) else [to_json(entry) for entry in value]
