"""Trajectories and designs under three weights of force in the cost: an F bar of one,
two and three body weights.

The paper has one cost for analysis and co-design and leaves open what forces are
divided by (`CostWeights.force`). The library is made with one body weight, co-design
with three. Here both are made with all of them.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.metric import metric
from bp2_rl.optimiser.family import FamilyConfig
from bp2_rl.optimiser.problem import Intervals, Problem, Speed, Starts
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.codesign import (
    Chain,
    CodesignSettings,
    DesignBounds,
    read_solution,
    solve_chains,
    start_chain,
)
from bp2_rl.robot import bp2, conventions

BODY_WEIGHT = bp2.TOTAL_MASS * conventions.GRAVITY  # N
ROBOTS = AS_IS, WITH_RESERVE, FREE = (
    "BP2",
    "BP2 with the library's reserve",
    "co-design",
)


@dataclasses.dataclass(frozen=True)
class ObjectiveSettings(Bounded):
    """Speeds, and weights of force in the cost, that are compared."""

    speeds: tuple[Speed, ...] = (10.0, 8.0)  # m/s
    # F bar
    body_weights: tuple[Annotated[float, Within(0.1, 100.0)], ...] = (1.0, 2.0, 3.0)
    starts: Starts = 2  # of each; the cheapest counts
    intervals: Intervals = 16  # of each segment, of what is compared


@dataclasses.dataclass(frozen=True)
class ObjectiveRow:
    """The cheapest trajectory of a robot under one F bar, what forces are divided by in
    the cost."""

    robot: str = metric("Robot", form="s")
    speed: float = metric("Speed", "m/s", "g")
    body_weights: float = metric("F bar", "m g", "g")
    period: float = metric("Period", "s", ".3f")
    duty: float = metric("Duty", form=".3f")
    peak_force: float = metric("Force", "N", ".0f")  # vertical, of a foot
    peak_torque: float = metric("Torque", "Nm", ".0f")
    velocity_force: float = metric("C_z")  # peak, over the weight
    covered: float = metric("Covered")  # as `Coupling.covered`, of the hips
    gear_ratio: float = metric("Gear")
    spring_stiffness: float = metric("Stiffness", "N/m", ".0f")
    leg_length: float = metric("Length", "m", ".3f")
    # dearest over cheapest of what was solved, less 1
    spread: float = metric("Spread", form=".1%")


@dataclasses.dataclass(frozen=True)
class Objective:
    """All rows of a comparison of F bars, what forces are divided by in the cost."""

    settings: ObjectiveSettings
    rows: tuple[ObjectiveRow, ...]


def compare_objectives(
    settings: ObjectiveSettings, folder: Path, workers: int = 1
) -> list[ObjectiveRow]:
    """Return a row for each robot, speed and F bar that has a trajectory; solutions are
    kept in `folder`."""
    cases = [
        (robot, share, speed, ways)
        for speed in settings.speeds
        for share in settings.body_weights
        for robot, ways in _chains(settings, speed, share).items()
    ]
    solve_chains([chain for *_, ways in cases for chain in ways], folder, workers)
    rows = []
    for robot, share, _, ways in cases:
        solved = [
            solution
            for chain in ways
            if (solution := read_solution(chain, folder)) is not None
        ]
        if solved:
            rows.append(describe_objective(robot, share, solved))
    return sorted(
        rows, key=lambda row: (-row.speed, ROBOTS.index(row.robot), row.body_weights)
    )


def describe_objective(
    robot: str, body_weights: float, solved: Sequence[Solution]
) -> ObjectiveRow:
    """Return the row of the cheapest of several solutions of a problem."""
    from bp2_rl.paper.trajectories.decomposition import (  # SciPy, CasADi
        coupling_opposes,
        decompose,
        peak_velocity_force,
    )

    costs = [solution.cost for solution in solved]
    best = solved[int(np.argmin(costs))]
    terms = decompose(best)
    hardware = best.problem.hardware
    return ObjectiveRow(
        robot=robot,
        speed=best.problem.speed,
        body_weights=body_weights,
        period=best.period,
        duty=best.duty,
        peak_force=float(np.max(best.motion.force[..., 1::2])),
        peak_torque=float(np.max(np.abs(best.motion.tau))),
        velocity_force=peak_velocity_force(terms),
        covered=coupling_opposes(terms).covered,
        gear_ratio=hardware.gear_ratio,
        spring_stiffness=hardware.spring_stiffness,
        leg_length=hardware.bp2.leg_length,
        spread=max(costs) / best.cost - 1.0,
    )


def _chains(
    settings: ObjectiveSettings, speed: float, body_weights: float
) -> dict[str, list[Chain]]:
    """Return the chains of problems that lead to each robot's cheapest trajectories, by
    robot."""
    bare = _weighed(Problem(speed=speed, intervals=settings.intervals), body_weights)
    family = FamilyConfig().problem
    reserved = dataclasses.replace(
        bare, hardware=family.hardware, speed_margin=family.speed_margin
    )
    free = _weighed(CodesignSettings().problem.at(speed), body_weights)
    codesign = CodesignSettings(problem=free)
    finer = free.on_mesh(settings.intervals)
    seeds = range(settings.starts)
    return {
        AS_IS: [Chain((bare,), (), DesignBounds(), seed) for seed in seeds],
        WITH_RESERVE: [Chain((reserved,), (), DesignBounds(), seed) for seed in seeds],
        FREE: [start_chain(codesign, seed).then(finer) for seed in seeds],
    }


def _weighed(problem: Problem, body_weights: float) -> Problem:
    force = float(round(body_weights * BODY_WEIGHT))
    return dataclasses.replace(
        problem, weights=dataclasses.replace(problem.weights, force=force)
    )
