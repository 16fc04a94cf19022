"""Robots or gaits beside each other in the plane: what each costs over speed, and how
fast each gets.

The objective counts every segment alike, and gaits have different numbers of them. So
they are set beside each other by the mean over time of its running cost.
"""

import contextlib
import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from bp2_rl.base import serialization as config
from bp2_rl.base.metric import Table, metrics_of
from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import (
    NotSolved,
    Solution,
    is_saved,
    load_solution,
    save_solution,
    speed_name,
)
from bp2_rl.paper.trajectories.gait_summary import GaitSummary, summarise_gait

GREATEST = "greatest"  # name of the file


@dataclasses.dataclass(frozen=True)
class ComparisonRow:
    """The gait of a variant at one speed."""

    name: str
    speed: float | None  # m/s, asked for or, of the greatest, found
    greatest: bool
    gait: GaitSummary | None  # None where no trajectory was found
    pitch: tuple[float, float] | None  # rad, least and greatest; nose down is positive


@dataclasses.dataclass(frozen=True)
class VariantComparison:
    """All rows of a comparison of variants."""

    problem: Problem
    speeds: tuple[float, ...]  # m/s
    rows: tuple[ComparisonRow, ...]


def compare_variants(
    problem: Problem,
    variants: Mapping[str, Problem],
    speeds: Sequence[float],
    folder: Path,
    *,
    what: str,
    workers: int = 1,
) -> Iterator[list[ComparisonRow]]:
    """Yield the rows of every variant: of all speeds, then of its greatest speed.

    Each is the cheaper of two searches, from the cold guess and from the speed before;
    a greatest speed is the better of what the last two speeds lead to. Solutions are
    kept in `folder`, and what is there is not solved again.

    Args:
        problem: what is varied.
        variants: problems by name.
        speeds: m/s, the slowest first.
        folder: of the solutions.
        what: is compared, for the message that says that the folder holds something
            else.
        workers: processes; 1: this one.

    Raises:
        UserError: the folder holds such of another problem.
    """
    config.claim_folder(folder, "problem.json", problem, what)
    with contextlib.ExitStack() as stack:
        run = map if workers == 1 else stack.enter_context(spawned(workers)).map
        yield from run(
            _rows,
            variants,
            variants.values(),
            itertools.repeat(speeds),
            itertools.repeat(folder),
        )


def _rows(
    name: str, problem: Problem, speeds: Sequence[float], folder: Path
) -> list[ComparisonRow]:
    # CasADi, where something is solved
    from bp2_rl.optimiser.collocation import fastest, solve

    kept = folder / re.sub(r"[^\w.-]+", "-", name).strip("-")
    found: list[Solution] = []
    rows = []
    for speed in speeds:
        asked = problem.at(speed)
        starts = [None, *(solution.motion for solution in found[-1:])]
        tries = [
            lambda start=start, asked=asked: solve(asked, start) for start in starts
        ]
        solution = _kept(
            kept / speed_name(speed), tries, lambda solution: -solution.cost
        )
        found += [] if solution is None else [solution]
        rows.append(_row(name, speed, solution, greatest=False))
    tries = [lambda start=start: fastest(start) for start in found[-2:]]
    top = _kept(kept / GREATEST, tries, lambda solution: solution.problem.speed)
    return [
        *rows,
        _row(name, None if top is None else top.problem.speed, top, greatest=True),
    ]


def _kept(
    path: Path,
    tries: Sequence[Callable[[], Solution]],
    worth: Callable[[Solution], float],
) -> Solution | None:
    """Return the solution that is kept at `path`, or else the worthiest of the tries,
    which is then kept."""
    if is_saved(path):
        return load_solution(path)
    found: list[Solution] = []
    for solve_it in tries:
        with contextlib.suppress(NotSolved):
            found.append(solve_it())
    best = max(found, key=worth, default=None)
    if best is not None:
        save_solution(path, best)
    return best


def _row(
    name: str, speed: float | None, solution: Solution | None, *, greatest: bool
) -> ComparisonRow:
    if solution is None:
        return ComparisonRow(name, speed, greatest, None, None)
    pitch = solution.motion.q[..., 2]
    return ComparisonRow(
        name,
        speed,
        greatest,
        summarise_gait(solution),
        (float(np.min(pitch)), float(np.max(pitch))),
    )


def tabulate_variants(rows: Sequence[ComparisonRow]) -> Table:
    """Return a table with a line for each variant at each speed."""
    names = list(metrics_of(GaitSummary))
    declared = [metrics_of(GaitSummary)[name] for name in names]
    lines: list[list[str]] = []
    for row in rows:
        top = " (greatest)" if row.greatest else ""
        cells = [
            one.show(getattr(row.gait, name, None), unit=False)
            for name, one in zip(names, declared, strict=True)
        ]
        pitch = (
            []
            if row.pitch is None
            else [f"{np.rad2deg(end):+.1f}" for end in row.pitch]
        )
        lines.append([f"{row.name}{top}", *cells, " to ".join(pitch) or "not found"])
    return Table("", ["Variant", *(one.head for one in declared), "Pitch [deg]"], lines)
