"""Items of the paper in the index: the command that reproduces an item, and the checks
that decide "same" or "differs"."""

import contextlib
import dataclasses
import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json

Verdict = Literal["same", "differs", "not comparable", "needs hardware", "not run"]
Stated = Literal["same", "differs", "not comparable", "needs hardware"]


@dataclasses.dataclass(frozen=True)
class Check:
    """A check of our result: a number within bounds from the paper, or the paper's
    words."""

    at: str  # SOURCE:PATH
    least: float = -math.inf
    most: float = math.inf
    words: str | None = None

    def holds(self, value: Any) -> bool:
        """Return whether a value passes the check; a value that was not measured fails."""
        if self.words is not None:
            return value == self.words
        return isinstance(value, int | float) and self.least <= value <= self.most


@dataclasses.dataclass(frozen=True)
class Item:
    """One item of the paper, such as a panel, a table or a claim, and what ours says.
    Numbers in `ours` and `because` stand as {SOURCE:PATH|FORMAT}, read from the
    source's file."""

    number: str  # as the paper has it
    shows: str  # in our words
    # SOURCE or SOURCE/PICTURE: the command whose numbers are ours, and the file of its
    # folder to show
    place: str = ""
    command: str = ""  # where it is no source's
    ours: str = ""
    checks: tuple[Check, ...] = ()  # all hold: same; else: differs
    stated: Stated | None = None  # where no number decides
    because: str = ""  # what makes the difference, or why it cannot be said
    beyond: bool = False  # the paper has no such item

    @property
    def id(self) -> str:
        """HTML anchor of the item's row: fig-4-a, table-s1, eq-3, movie-s2, or
        beyond-SOURCE."""
        return (
            f"beyond-{self.source}"
            if self.beyond
            else re.sub("[^a-z0-9]+", "-", self.number.lower())
        )

    @property
    def source(self) -> str:
        """Name of the command that reproduces the item; empty where there is none."""
        return self.place.partition("/")[0]

    @property
    def picture(self) -> str:
        """Name of the item's picture in the source's folder; empty where none is
        shown."""
        return self.place.partition("/")[2]


def read_items() -> dict[str, tuple[Item, ...]]:
    """Read items.toml: all items by heading, in the paper's order, then what goes
    beyond the paper."""
    with Path(__file__).with_name("items.toml").open("rb") as file:
        return {
            heading: tuple(from_json(Item, entry) for entry in entries)
            for heading, entries in tomllib.load(file).items()
        }


class ReportNumber(NamedTuple):
    """A number on the index page: its text, its value, and its place in a report."""

    text: str  # as shown
    value: Any  # as in the file
    at: str  # SOURCE:PATH


class IndexRow(NamedTuple):
    """A row of the index page: an item, its verdict, and its texts with the numbers
    filled in."""

    item: Item
    verdict: Verdict
    ours: tuple[str | ReportNumber, ...]
    because: tuple[str | ReportNumber, ...]


@dataclasses.dataclass(frozen=True)
class Statement:
    """One item of the paper, and its verdict by one report."""

    item: str  # its number in the paper
    paper: str  # what it shows
    ours: str
    verdict: Verdict
    because: str


Reports = Mapping[str, Any]
"""Contents of the files of numbers, by source; sources that were not run are left
out."""
_NUMBER = re.compile(r"\{(\w+:[^|{}]+)\|([^{}]*)\}")


def fill(item: Item, reports: Reports, missing: Mapping[str, str]) -> IndexRow:
    """Return an item's row of the index page, with verdict and numbers from the
    reports.

    Args:
        item: of the paper.
        reports: what is in the files of numbers.
        missing: why a source has none, by name.

    Raises:
        UserError: a report lacks a number that the item shows.
    """
    needed = {item.source} if item.source else set()
    needed |= {
        at.partition(":")[0]
        for at in (*places(item), *(check.at for check in item.checks))
    }
    lacking = sorted(needed - reports.keys())
    if lacking:
        return IndexRow(
            item,
            "not run",
            (),
            tuple(f"{name}: {missing.get(name, 'not run')}" for name in lacking[:1]),
        )
    if item.checks:
        held = all(check.holds(look_up(reports, check.at)) for check in item.checks)
        verdict: Verdict = "same" if held else "differs"
    else:
        verdict = item.stated or "not comparable"
    return IndexRow(
        item, verdict, _filled(item.ours, reports), _filled(item.because, reports)
    )


def statements_of(source: str, report: Mapping[str, Any]) -> tuple[Statement, ...]:
    """Return the verdicts on a source's items, for items that need no other source's
    report."""
    found = []
    for item in (item for items in read_items().values() for item in items):
        if item.source == source:
            # flags may leave out what an item needs
            with contextlib.suppress(UserError):
                found.append(fill(item, {source: report}, {}))
    return tuple(
        Statement(
            row.item.number,
            row.item.shows,
            _text(row.ours),
            row.verdict,
            _text(row.because),
        )
        for row in found
        if row.verdict != "not run"
    )


def _text(parts: tuple[str | ReportNumber, ...]) -> str:
    return "".join(part if isinstance(part, str) else part.text for part in parts)


def places(item: Item) -> tuple[str, ...]:
    """Return the places, SOURCE:PATH, of all numbers in an item's texts."""
    return tuple(match[1] for match in _NUMBER.finditer(f"{item.ours} {item.because}"))


def look_up(reports: Reports, at: str) -> Any:
    """Return the value at SOURCE:PATH in the reports.

    A path's steps are separated by /: a key, a place in a list, or KEY=VALUE for the
    entry of a list that has it.

    Raises:
        UserError: there is none.
    """
    source, _, path = at.partition(":")
    value = reports[source]
    for step in path.split("/"):
        key, equal, wanted = step.partition("=")
        if value is None:  # what was not measured has no parts
            return None
        try:
            if equal:
                value = next(entry for entry in value if _same(entry[key], wanted))
            else:
                value = value[int(step)] if isinstance(value, list) else value[step]
        except (KeyError, IndexError, ValueError, TypeError, StopIteration):
            raise UserError(
                f"the report of {source} has no {path}: remove its folder to have it made anew"
            ) from None
    return value


def _same(value: Any, wanted: str) -> bool:
    return value == float(wanted) if isinstance(value, float) else str(value) == wanted


def _filled(text: str, reports: Reports) -> tuple[str | ReportNumber, ...]:
    """Return a text in parts: its words and, in place of {SOURCE:PATH|FORMAT}, its
    numbers."""
    words, *rest = _NUMBER.split(text)
    parts: list[str | ReportNumber] = [words]
    for at, form, words in zip(rest[::3], rest[1::3], rest[2::3], strict=True):
        value = look_up(reports, at)
        plain = isinstance(value, str) or value is None
        shown = (value or "-") if plain else format(value, form)
        parts += [ReportNumber(shown, value, at), words]
    return tuple(filter(None, parts))
