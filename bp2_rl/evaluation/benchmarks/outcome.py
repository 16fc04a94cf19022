"""The outcome of a benchmark, from which terminal, HTML page, metrics.json and card are
written."""

import dataclasses
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from bp2_rl.base.metric import Row, Table
from bp2_rl.simulation.backend import TITLES
from bp2_rl.simulation.trajectory import Trajectory


class Picture(NamedTuple):
    """A figure of a report, with its file name and caption."""

    name: str
    caption: str
    figure: Figure
    narrow: Figure | None = None  # the same for a narrow screen


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """The outcome of a benchmark: conditions, verdict, figures of merit, pictures and
    tables."""

    benchmark: str
    subject: str  # who ran, for titles
    conditions: dict[str, str]  # the conditions under which it can be repeated
    verdict: str  # in one sentence ...
    good: bool  # ... and whether it is a good one
    rows: tuple[Row, ...]  # the figures of merit, each with what it means
    tiles: tuple[str, ...]  # labels of the rows that are shown large
    pictures: tuple[Picture, ...]
    metrics: Any  # a dataclass: all measurements
    # results for the policy's card: SI units, shares of 1, None if not measured
    results: dict[str, Any]
    tables: tuple[Table, ...] = ()
    backend: str = TITLES["mujoco"]  # the simulator, for titles
    trajectory: Trajectory | None = None  # of the one run, where there was one
