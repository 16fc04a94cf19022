"""Trajectories under several weights of force in the cost: an F bar of one, two and
three body weights.

The paper has one cost and leaves open what forces are divided by (`CostWeights.force`).
The library is made with one body weight, co-design with three.
"""

import dataclasses
import functools
from typing import Annotated

import numpy as np

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.optimiser.problem import Intervals, Problem, Speed, Starts
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.codesign import TIME_LIMIT, solve_all
from bp2_rl.robot import bp2, conventions

BODY_WEIGHT = bp2.TOTAL_MASS * conventions.GRAVITY  # N


@dataclasses.dataclass(frozen=True)
class ObjectiveSettings(Bounded):
    """Speeds, and weights of force in the cost, that are compared."""

    speeds: tuple[Speed, ...] = (10.0, 8.0)  # m/s
    # F bar
    body_weights: tuple[Annotated[float, Within(0.1, 100.0)], ...] = (1.0, 2.0, 3.0)
    starts: Starts = 2  # of each; the cheapest counts
    intervals: Intervals = 16  # of each segment


@dataclasses.dataclass(frozen=True)
class ObjectiveRow:
    """BP2's cheapest trajectory under one F bar, what forces are divided by in the
    cost."""

    speed: float = metric("Speed", "m/s", "g")
    body_weights: float = metric("F bar", "m g", "g")
    period: float = metric("Period", "s", ".3f")
    duty: float = metric("Duty", form=".3f")
    peak_torque: float = metric("Peak torque", "Nm", ".0f")
    peak_force: float = metric("Force", "N", ".0f")  # vertical, of a foot
    velocity_force: float = metric("C_z")  # peak, over the weight
    covered: float = metric("Covered")  # as `Coupling.covered`, of the hips


@dataclasses.dataclass(frozen=True)
class Objective:
    """All rows of a comparison of F bars, what forces are divided by in the cost."""

    settings: ObjectiveSettings
    rows: tuple[ObjectiveRow, ...]


def compare_objectives(
    settings: ObjectiveSettings, workers: int = 1
) -> list[ObjectiveRow]:
    """Return a row for each speed and F bar that has a trajectory.

    Raises:
        UserError: no speed has a trajectory.
    """
    from bp2_rl.optimiser.collocation import solve_best  # CasADi

    problems = [
        weigh(Problem(speed=speed, intervals=settings.intervals), share)
        for speed in settings.speeds
        for share in settings.body_weights
    ]
    limit = TIME_LIMIT * settings.intervals
    solve = functools.partial(solve_best, starts=settings.starts, time_limit=limit)
    found = solve_all(solve, problems, workers=workers)
    rows = [describe_objective(best) for best in found if best is not None]
    if not rows:
        raise UserError("no trajectory was found: allow more --starts or intervals")
    return rows


def weigh(problem: Problem, body_weights: float) -> Problem:
    """Return a problem under another F bar."""
    force = float(round(body_weights * BODY_WEIGHT))
    return dataclasses.replace(
        problem, weights=dataclasses.replace(problem.weights, force=force)
    )


def describe_objective(best: Solution) -> ObjectiveRow:
    """Return the row of a trajectory."""
    from bp2_rl.paper.trajectories.decomposition import (  # SciPy, CasADi
        coupling_opposes,
        decompose,
        peak_velocity_force,
    )

    terms = decompose(best)
    return ObjectiveRow(
        speed=best.problem.speed,
        body_weights=round(best.problem.weights.force / BODY_WEIGHT, 2),
        period=best.period,
        duty=best.duty,
        peak_torque=float(np.max(np.abs(best.motion.tau))),
        peak_force=float(np.max(best.motion.force[..., 1::2])),
        velocity_force=peak_velocity_force(terms),
        covered=coupling_opposes(terms).covered,
    )
