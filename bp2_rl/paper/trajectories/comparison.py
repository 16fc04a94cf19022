"""Robots or gaits beside each other in the plane: what each costs over speed, and how
fast each gets.

The objective counts every segment alike, and gaits have different numbers of them. So
they are set beside each other by the mean over time of its running cost.
"""

import contextlib
import dataclasses
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from bp2_rl.base import serialization as config
from bp2_rl.base.metric import Table, metric, metrics_of
from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.cycle import cost_of_transport, whole_cycle
from bp2_rl.optimiser.problem import CostWeights, Problem
from bp2_rl.optimiser.solution import (
    Solution,
    speed_name,
)
from bp2_rl.optimiser.verifier_laws import at_motors
from bp2_rl.optimiser.verify import StrideSummary, summarise
from bp2_rl.paper.trajectories.codesign import keep_best
from bp2_rl.robot.hardware import HardwareSpec

GREATEST = "greatest"  # name of the file


@dataclasses.dataclass(frozen=True, kw_only=True)
class GaitSummary(StrideSummary):
    """Metrics of a gait at one speed, the optimiser's or a policy's; hips and knees,
    forces along the track and up."""

    speed: float = metric("Speed", "m/s")
    rms_torque: float = metric("RMS torque", "Nm", ".1f")
    # cost of transport: the motors' positive work
    positive: float = metric("Work / m g d", form=".3f")
    # mean over time of the optimiser's R without its smoothness
    running_cost: float = metric("R")


def summarise_gait(solution: Solution) -> GaitSummary:
    """Summarise a solution as a whole robot's gait: the running cost of half a robot
    counts twice."""
    cycle = whole_cycle(solution)
    motion = cycle.motion
    weights = cycle.weights / cycle.period

    def mean(values: Float[np.ndarray, "segments points"]) -> float:
        return float(np.sum(weights * values))

    qd = motion.v[..., cycle.problem.stride.motors]
    R = running_cost(
        motion.tau,
        qd,
        motion.force,
        solution.problem.hardware,
        solution.problem.weights,
    )
    return GaitSummary(
        speed=solution.problem.speed,
        **vars(summarise(solution)),
        rms_torque=float(np.sqrt(mean(np.mean(motion.tau**2, axis=-1)))),
        positive=cost_of_transport(solution),
        running_cost=mean(R) / solution.problem.share,
    )


def running_cost(
    torque: Float[np.ndarray, "... motors"],
    qd: Float[np.ndarray, "... motors"],
    force: Float[np.ndarray, "... contacts"],
    hardware: HardwareSpec,
    weights: CostWeights,
) -> Float[np.ndarray, "..."]:
    """Return the running cost R (paper, Eq. R) at each instant without its smoothness:
    powers, torques and forces as shares of the greatest."""
    count = torque.shape[-1]
    tau = torque / at_motors(hardware.joint_peak_torque, count)
    load = force / weights.force
    power = tau * qd / at_motors(hardware.joint_no_load_speed, count)
    return weights.power * _squares(power) + weights.load * (
        _squares(tau) + _squares(load)
    )


def _squares(values: Float[np.ndarray, "... k"]) -> Float[np.ndarray, "..."]:
    return np.sum(values**2, axis=-1)


# --- Variants -------------------------------------------------------------------------


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
    """Yield the rows of every variant: its gaits at all speeds, then at its greatest
    speed.

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
        solution = keep_best(
            kept / speed_name(speed), tries, lambda solution: -solution.cost
        )
        found += [] if solution is None else [solution]
        rows.append(_row(name, speed, solution, greatest=False))
    tries = [lambda start=start: fastest(start) for start in found[-2:]]
    top = keep_best(kept / GREATEST, tries, lambda solution: solution.problem.speed)
    return [
        *rows,
        _row(name, None if top is None else top.problem.speed, top, greatest=True),
    ]


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
