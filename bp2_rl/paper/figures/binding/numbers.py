"""What holds the optimiser back over speed, and how far a policy is from it."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import CostWeights, Problem
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.paper.benchmarks.efficiency.measured import measure_energy
from bp2_rl.paper.benchmarks.speeds import whole_strides
from bp2_rl.paper.figures.reports import read_runs
from bp2_rl.paper.figures.settings import BindingSettings
from bp2_rl.paper.trajectories.described import Gait, describe, running_cost
from bp2_rl.paper.trajectories.shadow_prices import LIMITS, LOSSES, Change, Weighed, weigh
from bp2_rl.robot.specs import IDEAL, LEGS, ROBOTS
from bp2_rl.simulation.account import replay
from bp2_rl.simulation.gait import contacts
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.windows import steady_window

BENCHMARK = "topspeed"
SPEED = "speed"
MOTORS = [3 * leg + joint for leg in range(len(LEGS)) for joint in (1, 2)]  # hips and knees
Runs = tuple[Trajectory, ...]


@dataclasses.dataclass(frozen=True)
class BindingAtSpeed:
    """The optimiser at a speed."""

    speed: float  # m/s
    gait: Gait | None  # None where no trajectory was found
    cost: float | None  # of the optimiser's own objective
    touched: dict[str, float]  # by limit: share of motors or feet times instants
    prices: dict[str, float]  # d ln cost / d ln of the parameter


@dataclasses.dataclass(frozen=True)
class Gap:
    """A policy's gait, and the optimiser's at the same speed on the same robot."""

    name: str
    policy: Gait
    optimiser: Gait | None


@dataclasses.dataclass(frozen=True)
class BindingNumbers:
    """All that the figure shows."""

    robot: str
    speeds: tuple[BindingAtSpeed, ...]
    greatest: BindingAtSpeed  # its prices are d speed / d ln of the parameter, m/s; without a gait: not found
    gaps: tuple[Gap, ...]


def measure(settings: BindingSettings) -> BindingNumbers:
    """Solve at each speed, weigh the limits, and set the runs beside.

    Raises:
        UserError: a run is of another robot, or has no two strides.
    """
    hardware = ROBOTS[settings.robot]
    ran = read_runs(settings.runs, BENCHMARK)
    for name, _, run in ran:
        if run.hardware != hardware:
            raise UserError(f"--runs: {name} is not of the robot that --robot names, {settings.robot}")
    policies = [(name, describe_run(run)) for name, _, run in ran]
    problem = Problem(intervals=settings.intervals, hardware=hardware)
    changes: dict[str, Change] = {**LIMITS, **(LOSSES if hardware.losses != IDEAL.losses else {})}
    found: list[BindingAtSpeed] = []
    solutions: list[Solution] = []
    for speed in settings.speeds:
        weighed = _cheapest(problem.at(speed), solutions, changes | {SPEED: _speed})
        found.append(_relative(speed, weighed))
        if weighed is not None:
            solutions.append(weighed.solution)
    if not solutions:
        raise UserError("--speeds: no trajectory was found at any of them: name slower ones, or more --intervals")
    greatest = _greatest(solutions[-1], changes)
    gaps = tuple(Gap(name, gait, _beside(problem.at(gait.speed), solutions)) for name, gait in policies)
    return BindingNumbers(settings.robot, tuple(found), greatest, gaps)


def _greatest(start: Solution, changes: dict[str, Change]) -> BindingAtSpeed:
    try:
        top = weigh(start, changes, greatest=True)
    except NotSolved:
        return _relative(start.problem.speed, None)
    return BindingAtSpeed(
        top.solution.problem.speed, describe(top.solution), top.solution.cost, top.touched, dict(top.prices)
    )


def _speed(problem: Problem, factor: float) -> Problem:
    return problem.at(factor * problem.speed)


def _cheapest(problem: Problem, before: list[Solution], changes: dict[str, Change]) -> Weighed | None:
    """The cheaper of what the cold guess and the neighbour lead to, weighed; None where neither leads anywhere."""
    best = min(_solved(problem, before), key=lambda solution: solution.cost, default=None)
    try:
        return None if best is None else weigh(best, changes)
    except NotSolved:
        return None


def _solved(problem: Problem, before: list[Solution]) -> Iterator[Solution]:
    near = sorted(before, key=lambda solution: abs(solution.problem.speed - problem.speed))[:1]
    for start in (None, *(solution.motion for solution in near)):
        try:
            yield solve(problem, start)
        except NotSolved:
            continue


def _beside(problem: Problem, solutions: list[Solution]) -> Gait | None:
    best = min(_solved(problem, solutions), key=lambda solution: solution.cost, default=None)
    return None if best is None else describe(best)


def _relative(speed: float, weighed: Weighed | None) -> BindingAtSpeed:
    if weighed is None:
        return BindingAtSpeed(speed, None, None, {}, {})
    cost = weighed.solution.cost
    prices = {name: price / cost for name, price in weighed.prices.items()}
    return BindingAtSpeed(speed, describe(weighed.solution), cost, weighed.touched, prices)


def describe_run(run: Trajectory) -> Gait:
    """A policy's, over the whole strides of the steady part of its run.

    Raises:
        UserError: it has no two.
    """
    chosen = whole_strides(steady_window(run))
    energy = None if chosen is None else measure_energy(chosen[0], replay(chosen[0])[0], chosen[1])
    if chosen is None or energy is None:
        raise UserError(f"--runs: {run.name} makes no two strides: name a longer run")
    part, strides = chosen
    torque, qd = part.torque[:, MOTORS], part.joint_velocity[:, MOTORS]
    cos, sin = np.cos(part.heading)[:, None], np.sin(part.heading)[:, None]
    along = cos * part.foot_force[..., 0] + sin * part.foot_force[..., 1]
    force = np.stack([along, part.foot_force[..., 2]], axis=-1).reshape(len(part), -1)
    return Gait(
        speed=float(np.mean(part.ground_velocity[:, 0])),
        period=len(part) * part.dt / strides,
        duty=float(np.mean(contacts(part))),
        peak_torque=float(np.max(np.abs(torque))),
        rms_torque=float(np.sqrt(np.mean(torque**2))),
        peak_force=float(np.max(part.foot_force[..., 2])),
        positive=energy.positive,
        running_cost=float(np.mean(running_cost(torque, qd, force, run.hardware, CostWeights()))),
    )
