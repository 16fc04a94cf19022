"""Arguments of a command that writes a report: its settings, folder and format."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro


def with_folder(settings: type[object], out: Path) -> type[object]:
    """Return the dataclass of a command's arguments: its `settings`, the report's
    folder `out`, and the pictures' `format`."""
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
