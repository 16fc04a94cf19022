"""Runs of a policy at several speeds, and the whole strides of each."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TypeVar

from bp2_rl.evaluation.benchmarks.conditions import robot_of
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.robot.conventions import LEGS
from bp2_rl.simulation.gait import contacts, touchdowns
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

LEG = LEGS.index("RR")  # whose touchdowns begin the strides
EASING = 1.5  # s of the hold that are not looked at
Result = TypeVar("Result")


@dataclasses.dataclass(frozen=True)
class AtSpeed:
    """How a run under one command went."""

    commanded_speed: float  # m/s
    speed: float  # m/s, over the strides, or the mean of a run that has none
    fell_at: float | None  # s


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
    """Return `measure` of the run under each command, m/s, to which `ramp` is led.

    `measure` must be picklable.
    """
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
    """Return `whole_strides` of the hold behind its `EASING`; None if the robot fell."""
    steady = ramp.steady_from + min(EASING, 0.5 * ramp.hold)
    end = len(run) * run.dt
    if run.fell_at is not None or end - steady <= 2 * run.dt:
        return None
    return whole_strides(run.between(steady, end), most)


def whole_strides(
    run: Trajectory, most: int | None = None
) -> tuple[Trajectory, int] | None:
    """Return a run's last whole strides, between touchdowns of `LEG`, and their number.

    None of a run without two touchdowns.
    """
    landed = touchdowns(contacts(run)[:, LEG])
    if most is not None:
        landed = landed[-most - 1 :]
    if len(landed) < 2:
        return None
    return run.between(float(run.time[landed[0]]), float(run.time[landed[-1]])), len(
        landed
    ) - 1
