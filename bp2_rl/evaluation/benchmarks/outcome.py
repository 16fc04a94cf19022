"""What a benchmark hands to the terminal, the page, the file and a policy's card."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from bp2_rl.simulation.trajectory import Trajectory

NOT_MEASURED = "-"
MEASURES = "Measure", "Value", "Definition"  # head of a table of rows


class Row(NamedTuple):
    """One line of the table."""

    label: str
    value: str
    meaning: str


class Table(NamedTuple):
    """A further table of the page; all columns but the first (and the last, if `words`)
    hold numbers."""

    title: str
    head: Sequence[str]
    lines: Sequence[Sequence[str]]
    words: bool = False


class Picture(NamedTuple):
    """A figure of the page, and of a file of this name."""

    name: str
    caption: str
    figure: Figure
    narrow: Figure | None = None  # the same for a narrow screen


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """A benchmark's outcome: what was done and what came out, for every reader."""

    benchmark: str
    subject: str  # who ran, for titles
    backend: str  # the simulator, for titles
    conditions: dict[str, str]  # what a reader must know to do it again
    verdict: str  # in one sentence ...
    good: bool  # ... and whether it is a good one
    rows: tuple[Row, ...]  # the figures of merit, each with what it means
    tiles: tuple[str, ...]  # labels of the rows that are shown large
    pictures: tuple[Picture, ...]
    metrics: Any  # a dataclass: everything that was measured
    # what a policy's card says: SI units, shares of 1, None where it was not measured
    results: dict[str, Any]
    tables: tuple[Table, ...] = ()
    trajectory: Trajectory | None = None  # of the one run, where there was one


def show(value: float | None, form: str, unit: str = "") -> str:
    """A number with its unit, or a dash."""
    return NOT_MEASURED if value is None else f"{value:{form}} {unit}".strip()


def show_fall(fell_at: float | None) -> str:
    """When a robot fell, if it did; `fell_at` in s."""
    return "none" if fell_at is None else f"at {fell_at:.2f} s"


def rounded(results: dict[str, Any]) -> dict[str, Any]:
    """Round numbers to four digits, within lists and groups too; None stands for what
    is not finite."""

    def four_digits(value: Any) -> Any:
        if isinstance(value, float):
            return float(f"{value:.4g}") if math.isfinite(value) else None
        if isinstance(value, dict):
            return rounded(value)
        return (
            [four_digits(entry) for entry in value]
            if isinstance(value, list | tuple)
            else value
        )

    return {name: four_digits(value) for name, value in results.items()}
