"""What benchmarks at several speeds share: the runs, the whole strides of each, the
optimiser's beside them."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TypeVar

from bp2_rl.evaluation.benchmarks.conditions import robot_of
from bp2_rl.learning.policy import Policy
from bp2_rl.optimiser.family import family_of
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.reference.library.file import load_library
from bp2_rl.robot.conventions import LEGS
from bp2_rl.settings.reference import CollocationConfig
from bp2_rl.simulation.gait import contacts, touchdowns
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

LEG = LEGS.index("RR")  # whose touchdowns begin the strides
EASING = 1.5  # s of the hold that are not looked at
Result = TypeVar("Result")


def commands_below(speeds: Sequence[float], top: float) -> tuple[float, ...]:
    """Return the speeds below the top speed, and the top speed, m/s."""
    return (*(speed for speed in speeds if speed < top), top)


def run_speeds(
    measure: Callable[[Ramp, Trajectory], Result],
    policy: Policy,
    ramp: Ramp,
    commands: Sequence[float],
    setup: DeepSetup,
) -> list[Result]:
    """`measure` of the run at each command, m/s, that `ramp` is led to, in their order;
    it must be picklable."""
    robot = robot_of(policy, setup)
    ramps = [dataclasses.replace(ramp, to=speed) for speed in commands]
    requests = [RunRequest(each, robot, setup.operator) for each in ramps]
    return simulate_all(functools.partial(_measure, measure), policy, requests)


def _measure(
    measure: Callable[[Ramp, Trajectory], Result], one: RunRequest, run: Trajectory
) -> Result:
    assert isinstance(one.schedule, Ramp)
    return measure(one.schedule, run)


def steady_strides(
    run: Trajectory, ramp: Ramp, most: int | None = None
) -> tuple[Trajectory, int] | None:
    """`whole_strides` of the hold behind its `EASING`; None of a run that fell, too."""
    steady = ramp.steady_from + min(EASING, 0.5 * ramp.hold)
    end = len(run) * run.dt
    if run.fell_at is not None or end - steady <= 2 * run.dt:
        return None
    return whole_strides(run.between(steady, end), most)


def whole_strides(
    run: Trajectory, most: int | None = None
) -> tuple[Trajectory, int] | None:
    """The last whole strides of a run, from one touchdown of `LEG` to another, and how
    many; None without two."""
    landed = touchdowns(contacts(run)[:, LEG])
    if most is not None:
        landed = landed[-most - 1 :]
    if len(landed) < 2:
        return None
    return run.between(float(run.time[landed[0]]), float(run.time[landed[-1]])), len(
        landed
    ) - 1


def nearest_solutions(speeds: Sequence[float]) -> list[Solution]:
    """The shipped library's motion at the speed nearest to each of these, m/s."""
    library = load_library(CollocationConfig().file)
    family = family_of(library.arrays, library.provenance)
    return [
        min(family, key=lambda solution: abs(solution.problem.speed - speed))
        for speed in speeds
    ]
