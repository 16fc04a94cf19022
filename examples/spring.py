"""Change the stiffness of the legs' springs, and run a policy that was trained with
another stiffness.

    python examples/spring.py

The robot is a frozen dataclass: to change it, make a copy with another number.
"""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np

import bp2_rl as bp2
from bp2_rl.robot.hardware import BUILT


class Tried(NamedTuple):
    """The result of a run with one spring stiffness."""

    sag: float  # m, mean compression of the springs in a stand
    speed: float  # m/s, mean of the steady part
    travel: float  # m, largest compression of a spring
    fell_at: float | None  # s


def try_spring(
    stiffness: float, speed: float, hold: float, policy: Path | str = "built"
) -> Tried:
    """Launch the policy on the built robot with springs of this stiffness, N/m."""
    robot = dataclasses.replace(BUILT, spring_stiffness=stiffness)
    # `hardware` is the simulated robot; controller and policy still assume the robot of
    # their training.
    run = bp2.rollout(
        bp2.load_policy(policy), bp2.Ramp((speed, 0.0, 0.0), hold=hold), hardware=robot
    )
    metrics = run.metrics
    # the first sample is the settled stand
    sag = float(np.mean(run.spring_compression[0]))
    return Tried(sag, metrics.mean_speed, metrics.peak_spring_travel, metrics.fell_at)


def main() -> None:
    """Try springs softer and stiffer than BP2's own 6000 N/m."""
    print("   N/m   sag mm    m/s   travel mm")
    for stiffness in (4000.0, 6000.0, 9000.0):
        tried = try_spring(stiffness, speed=6.0, hold=4.0)
        fell = "" if tried.fell_at is None else f"   fell after {tried.fell_at:.1f} s"
        print(
            f"{stiffness:6.0f} {1000 * tried.sag:8.1f} {tried.speed:6.2f} {1000 * tried.travel:11.0f}{fell}"
        )
    print("train on it: python train.py --env.hardware.spring-stiffness 4000")


if __name__ == "__main__":
    main()
