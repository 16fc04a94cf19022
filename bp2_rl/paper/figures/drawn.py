"""What a figure hands to the terminal, the files and a page."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from matplotlib.figure import Figure

from bp2_rl.evaluation.benchmarks.outcome import Table

Verdict = Literal["same", "differs", "not comparable"]


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One statement of the paper, and what comes of it here."""

    paper: str  # what it says
    ours: str  # what we find
    verdict: Verdict
    because: str = ""  # where it is not the same


class Drawn(NamedTuple):
    """A figure, and all that it shows."""

    # every number in pictures, tables and comparisons, not rounded: a dataclass, or
    # several by name
    results: Any
    tables: tuple[Table, ...]
    comparisons: tuple[Comparison, ...]
    pictures: Mapping[str, Figure]  # by name
    # what the curves are drawn from, where no other file has them
    arrays: Mapping[str, Any] = {}
