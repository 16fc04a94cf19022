"""The index as one page of HTML: every item of the paper, what is ours, and the pictures and films inside."""

import base64
import html
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from bp2_rl.base.files import read_bytes
from bp2_rl.evaluation.report.page import document
from bp2_rl.paper.index.item import IndexRow, ReportNumber, Verdict
from bp2_rl.paper.index.sources import Source

VERDICTS: tuple[Verdict, ...] = ("same", "differs", "not comparable", "needs hardware", "not run")
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
    """The page.

    Args:
        groups: rows by heading.
        made: the commands whose reports are there.
        commands: all there are, by name.
        missing: why others' are not, by name.
        said: how all was made, in one line.
    """
    made, groups = tuple(made), {heading: tuple(rows) for heading, rows in groups.items()}
    rows = [row for of_group in groups.values() for row in of_group]
    there = {(each.source.name, file.name) for each in made for file in _shown(each.folder)}
    tables = "".join(
        f"<h2>{html.escape(heading)}</h2>{_table(rows, commands, there)}" for heading, rows in groups.items()
    )
    pictures = "".join(map(_section, made))
    left = "".join(f"<li><code>{html.escape(name)}</code>: {html.escape(why)}</li>" for name, why in missing.items())
    return document(
        "The paper, item by item",
        f"<p class=quiet>{html.escape(said)}</p>",
        f"{_tiles(rows)}{tables}{f'<h2>Not run</h2><ul>{left}</ul>' if left else ''}{pictures}",
        _STYLE,
    )


def _tiles(rows: Iterable[IndexRow]) -> str:
    rows = tuple(rows)
    counts = ((verdict, sum(row.verdict == verdict for row in rows)) for verdict in VERDICTS)
    tiles = "".join(f"<div><b>{count}</b><span>{verdict}</span></div>" for verdict, count in counts)
    return f"<section class=tiles>{tiles}</section>"


def _table(rows: Iterable[IndexRow], commands: Mapping[str, str], there: set[tuple[str, str]]) -> str:
    head = "".join(f"<th>{name}</th>" for name in ("Item", "The paper", "Ours", "Verdict", "Command"))
    body = "".join(_line(row, commands, there) for row in rows)
    return f"<table class=items><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _line(row: IndexRow, commands: Mapping[str, str], there: set[tuple[str, str]]) -> str:
    item = row.item
    command = item.command or commands.get(item.source, "")
    shown = f"<code>{html.escape(command)}</code>" if command else ""
    if (item.source, item.picture) in there:
        kind = "film" if item.picture.endswith(FILM) else "picture"
        shown += f' <a href="#{_anchor(item.source, item.picture)}">{kind}</a>'
    because = f"<p class=quiet>{_filled(row.because)}</p>" if row.because else ""
    return (
        f"<tr id={item.id}><th>{html.escape(item.number)}</th><td>{html.escape(item.shows)}</td>"
        f'<td>{_filled(row.ours)}{because}</td><td class="verdict v-{row.verdict.replace(" ", "-")}">{row.verdict}</td>'
        f"<td>{shown}</td></tr>"
    )


def _filled(parts: Iterable[str | ReportNumber]) -> str:
    return "".join(
        f'<data data-at="{html.escape(part.at)}" value="{html.escape(json.dumps(part.value))}">'
        f"{html.escape(part.text)}</data>"
        if isinstance(part, ReportNumber)
        else html.escape(part)
        for part in parts
    )


def _section(made: Made) -> str:
    """A command's pictures and film."""
    name = made.source.name
    shown = "".join(_figure(name, file) for file in _shown(made.folder))
    command = html.escape(made.source.command)
    return f'<h2 id="{name}"><code>{command}</code></h2><p class=quiet>{made.seconds:.0f} s; {name}/</p>{shown}'


def _shown(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in (".png", FILM))


def _figure(name: str, file: Path) -> str:
    content, caption = base64.b64encode(read_bytes(file)).decode(), f"{name}/{file.name}"
    if file.suffix == FILM:
        inner = f'<video src="data:video/mp4;base64,{content}" controls loop muted playsinline></video>'
    else:
        inner = f'<img alt="{caption}" src="data:image/png;base64,{content}">'
    return f'<figure id="{_anchor(name, file.name)}">{inner}<figcaption>{caption}</figcaption></figure>'


def _anchor(name: str, file: str) -> str:
    return f"{name}-{file.replace('.', '-')}"


_STYLE = """
body { max-width: 76rem; }
code { font-size: .85em; overflow-wrap: anywhere; }
.items td, .items th { padding-right: 1rem; }
.items th { min-width: 5.5rem; }
.items td:nth-child(2) { width: 24%; } .items td:nth-child(3) { width: 38%; } .items td:nth-child(5) { width: 18%; }
.items .verdict { margin: 0; font-size: .92rem; white-space: nowrap; }
.items p { font-size: .95em; }
.v-same { color: var(--good); } .v-differs { color: var(--bad); }
.v-not-comparable, .v-needs-hardware, .v-not-run { color: var(--quiet); font-weight: 400; }
figure img, figure video { max-width: 60rem; }
@media (max-width: 44rem) {
  body { padding: 1.5rem 1rem 3rem; }
  .items thead { display: none; }
  .items tr { display: block; padding: .6rem 0; border-bottom: 1px solid var(--line); }
  .items td, .items th { display: block; border: 0; padding: .1rem 0; }
  .items td:nth-child(n) { width: auto; }
}
"""
