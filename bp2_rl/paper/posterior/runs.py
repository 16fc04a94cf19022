"""Plausible robots under several policies: how fast each runs on the treadmill and on
the road."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from bp2_rl.evaluation.plausible import (
    Assumption,
    Values,
    on_the_belt,
    plausible_robot,
    road,
)
from bp2_rl.evaluation.races import TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2
from bp2_rl.simulation.measuring import time_at
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

RISE = 1.2  # m/s2, of the command: slow, so that a robot is told its own best speed
HOLD = 1.0  # s, of the greatest command
SECOND = 1000  # samples
BATCH = 32  # robots, after which what was found is handed on
HIND = slice(6, 12)  # motors of the hind legs


class Second(NamedTuple):
    """A run's fastest second, and the motors' peaks at the paper's pace."""

    speed: float  # m/s; 0 where the run did not last a second
    told: float  # m/s, in its middle
    # W, of hind hip and hind knee, in the second that comes nearest to the paper's pace
    powers: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class PlausibleRun:
    """What a plausible robot does under a policy, in the paper's numbers."""

    robot: int
    policy: str
    belt: float  # m/s, best second on the treadmill
    road: float  # m/s, best second outdoors
    # s, from the paper's launch, told what gave the best second; None: it fell
    time_100m: float | None
    hip: float  # W, peak of the hind hips outdoors, at the paper's speed or the best
    knee: float  # W, of the hind knees


def draw_robots(
    assumptions: Mapping[str, Assumption], count: int, seed: int = 0
) -> list[Values]:
    """Return robots that fill the assumptions' ranges evenly (a scrambled Sobol
    sequence)."""
    shares = qmc.Sobol(len(assumptions), rng=np.random.default_rng(seed)).random(
        2 ** math.ceil(math.log2(count))
    )[:count]
    columns = [
        one.at(share) for one, share in zip(assumptions.values(), shares.T, strict=True)
    ]
    return [
        dict(zip(assumptions, map(float, row), strict=True))
        for row in zip(*columns, strict=True)
    ]


def run_robots(
    policies: Mapping[str, Policy], robots: Sequence[Values]
) -> Iterator[list[PlausibleRun]]:
    """Run every robot under every policy; yield what they did, some robots at a
    time."""
    for first in range(0, len(robots), BATCH):
        batch = range(first, min(first + BATCH, len(robots)))
        yield [
            run
            for name, policy in policies.items()
            for run in _run_batch(name, policy, batch, [robots[i] for i in batch])
        ]


def _run_batch(
    name: str, policy: Policy, numbers: Sequence[int], robots: Sequence[Values]
) -> list[PlausibleRun]:
    """Run robots on belt and road, then over 100 m."""
    control = policy.card.env.control
    rise = Ramp(policy.card.env.commands.max_forward, acceleration=RISE, hold=HOLD)
    requests = [RunRequest(rise.under(control), on_the_belt(one)) for one in robots]
    requests += [
        RunRequest(rise.under(control), plausible_robot(one), world=road(one))
        for one in robots
    ]
    ran = simulate_all(fastest_second, policy, requests)
    belt, outdoors = ran[: len(robots)], ran[len(robots) :]
    races = [
        RunRequest(
            _race(best.told).under(control),
            plausible_robot(one),
            world=road(one),
            finish=TRACK,
        )
        for one, best in zip(robots, outdoors, strict=True)
    ]
    times = simulate_all(_race_time, policy, races)
    return [
        PlausibleRun(number, name, there.speed, here.speed, time, *here.powers)
        for number, there, here, time in zip(
            numbers, belt, outdoors, times, strict=True
        )
    ]


def _race(speed: float) -> Ramp:
    """Return the paper's launch to a speed (m/s), held for as long as half of it would
    take over the track."""
    speed = max(speed, 1.0)
    return Ramp(speed, acceleration=bp2.LAUNCH_ACCELERATION, hold=2.0 * TRACK / speed)


def fastest_second(_: RunRequest, run: Trajectory) -> Second:
    """Measure a run's fastest second, and the hind motors' peaks at the paper's
    pace."""
    if len(run) <= SECOND:
        return Second(0.0, 0.0, (0.0, 0.0))
    speeds = second_means(run.ground_velocity[:, 0])
    best = int(np.argmax(speeds))
    pace = int(np.argmax(speeds >= min(bp2.OUTDOOR_TOP_SPEED, speeds[best])))
    during = slice(pace, pace + SECOND)
    power = (run.torque * run.joint_velocity)[during, HIND].max(axis=0)
    _, hip, knee = power.reshape(2, 3).max(axis=0)
    told = float(run.command[best + SECOND // 2, 0])
    return Second(float(speeds[best]), told, (float(hip), float(knee)))


def second_means(speed: Float[np.ndarray, " N"]) -> Float[np.ndarray, " K"]:
    """Return the mean speed of every second."""
    total = np.concatenate(([0.0], np.cumsum(speed)))
    return (total[SECOND:] - total[:-SECOND]) / SECOND


def _race_time(_: RunRequest, run: Trajectory) -> float | None:
    return time_at(run, TRACK)
