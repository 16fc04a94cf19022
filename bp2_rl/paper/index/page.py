"""The index as one HTML page: every item of the paper beside ours, with pictures and
films."""

import base64
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from bp2_rl.base.assets import render
from bp2_rl.base.files import read_bytes
from bp2_rl.paper.index.item import IndexRow, Verdict
from bp2_rl.paper.index.sources import Source

VERDICTS: tuple[Verdict, ...] = (
    "same",
    "differs",
    "not comparable",
    "needs hardware",
    "not run",
)
FILM = ".mp4"


class Made(NamedTuple):
    """A command that was run, and its folder."""

    source: Source
    folder: Path
    seconds: float


def index_page(
    groups: Mapping[str, Iterable[IndexRow]],
    made: Iterable[Made],
    commands: Mapping[str, str],
    missing: Mapping[str, str],
    said: str,
) -> str:
    """Return the index page as HTML.

    Args:
        groups: rows by heading.
        made: the commands whose reports are there.
        commands: all there are, by name.
        missing: why others' are not, by name.
        said: how all was made, in one line.
    """
    groups = {heading: tuple(rows) for heading, rows in groups.items()}
    verdicts = [row.verdict for rows in groups.values() for row in rows]
    shown = [(each, _shown(each.folder)) for each in made]
    return render(
        "paper/index/page.html",
        groups=groups,
        counts=[(verdict, verdicts.count(verdict)) for verdict in VERDICTS],
        made=shown,
        there={
            (each.source.name, file.name) for each, files in shown for file in files
        },
        commands=commands,
        missing=missing,
        said=said,
        data_of=lambda file: base64.b64encode(read_bytes(file)).decode(),
        FILM=FILM,
    )


def _shown(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in (".png", FILM))
