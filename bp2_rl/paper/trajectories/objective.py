"""What of a trajectory is the objective's and what the robot's: F bar of one, two and
three body weights side by side.

The paper has one cost for analysis and co-design and leaves open what forces are
divided by (`CostWeights.force`). The library is made with one body weight, co-design
with three. Here both are made with all of them.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.table import Table

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.optimiser.family import FamilyConfig
from bp2_rl.optimiser.problem import Intervals, Problem, Speed, Starts
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.codesign.chain import Chain, read_solution, solve_chains
from bp2_rl.paper.trajectories.codesign.search import start_chain
from bp2_rl.paper.trajectories.codesign.settings import CodesignSettings, DesignBounds
from bp2_rl.robot import bp2, conventions

BODY_WEIGHT = bp2.TOTAL_MASS * conventions.GRAVITY  # N
ROBOTS = AS_IS, WITH_RESERVE, FREE = (
    "BP2",
    "BP2 with the library's reserve",
    "co-design",
)
COLUMNS = {
    "robot": "{0.robot}",
    "m/s": "{0.speed:g}",
    "F bar": "{0.body_weights:g} m g",
    "period": "{0.period:.3f} s",
    "duty": "{0.duty:.3f}",
    "force": "{0.peak_force:.0f} N",
    "torque": "{0.peak_torque:.0f} Nm",
    "C_z": "{0.velocity_force:.2f}",
    "covered": "{0.covered:.2f}",
    "gear": "{0.gear_ratio:.2f}",
    "stiffness": "{0.spring_stiffness:.0f} N/m",
    "length": "{0.leg_length:.3f} m",
    "spread": "{0.spread:.1%}",
}
"""The table's columns: heading -> format of a row."""


@dataclasses.dataclass(frozen=True)
class ObjectiveSettings(Bounded):
    """Speeds and weights of forces that are compared."""

    speeds: tuple[Speed, ...] = (10.0, 8.0)  # m/s
    # F bar
    body_weights: tuple[Annotated[float, Within(0.1, 100.0)], ...] = (1.0, 2.0, 3.0)
    starts: Starts = 2  # of each; the cheapest counts
    intervals: Intervals = 16  # of each segment, of what is compared


@dataclasses.dataclass(frozen=True)
class ObjectiveRow:
    """The cheapest trajectory of one robot under one F bar."""

    robot: str
    speed: float  # m/s
    body_weights: float  # F bar
    period: float  # s
    duty: float
    peak_force: float  # N, vertical, of a foot
    peak_torque: float  # Nm
    velocity_force: float  # peak of C_z over the weight
    covered: float  # as `Coupling.covered`, of the hips
    gear_ratio: float
    spring_stiffness: float  # N/m
    leg_length: float  # m
    spread: float  # dearest over cheapest of what was solved, less 1


@dataclasses.dataclass(frozen=True)
class Objective:
    """A whole comparison."""

    settings: ObjectiveSettings
    rows: tuple[ObjectiveRow, ...]


def compare_objectives(
    settings: ObjectiveSettings, folder: Path, workers: int = 1
) -> list[ObjectiveRow]:
    """A row for each robot, speed and F bar that has a trajectory; solutions are kept
    in `folder`."""
    cases = [
        (robot, share, speed, ways)
        for speed in settings.speeds
        for share in settings.body_weights
        for robot, ways in _chains(settings, speed, share).items()
    ]
    solve_chains(
        [chain for *_, ways in cases for chain in ways], folder, workers, "objectives"
    )
    rows = []
    for robot, share, _, ways in cases:
        solved = [
            solution
            for chain in ways
            if (solution := read_solution(chain, folder)) is not None
        ]
        if solved:
            rows.append(describe(robot, share, solved))
    return sorted(
        rows, key=lambda row: (-row.speed, ROBOTS.index(row.robot), row.body_weights)
    )


def describe(
    robot: str, body_weights: float, solved: Sequence[Solution]
) -> ObjectiveRow:
    """The cheapest of several solutions of one problem, in numbers."""
    from bp2_rl.paper.trajectories.decomposition import (  # SciPy, CasADi
        coupling_opposes,
        decompose,
        peak_velocity_force,
    )

    costs = [solution.cost for solution in solved]
    best = solved[int(np.argmin(costs))]
    terms, hardware = decompose(best), best.problem.hardware
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


def tabulate_objectives(rows: Sequence[ObjectiveRow]) -> Table:
    """A line for each row."""
    table = Table(*COLUMNS)
    for row in rows:
        table.add_row(*(form.format(row) for form in COLUMNS.values()))
    return table


def _chains(
    settings: ObjectiveSettings, speed: float, body_weights: float
) -> dict[str, list[Chain]]:
    """Ways to the cheapest trajectory of each robot."""
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
