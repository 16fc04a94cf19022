"""How widely each robot is randomised: as widely as its assumed values are uncertain."""

import dataclasses
from typing import NamedTuple

from bp2_rl.base.bounds import Range
from bp2_rl.robot.hardware import ROBOTS, RobotName
from bp2_rl.settings.env import EnvConfig


class RobotRanges(NamedTuple):
    """Factors on a robot's own friction and losses, from which training draws."""

    friction: Range  # for ground of 0.5 to 1.1
    mild_friction: Range  # for ground of 0.6 to 1.1
    losses: Range


def ranges_of(robot: RobotName) -> RobotRanges:
    """Return the ranges of a robot, whose friction is 0.9 if it is ideal and 0.8 if it is built."""
    if robot == "ideal":
        return RobotRanges(friction=(0.55, 1.22), mild_friction=(0.67, 1.22), losses=(1.0, 1.0))
    return RobotRanges(friction=(0.62, 1.38), mild_friction=(0.75, 1.38), losses=(0.8, 1.2))


def on_robot(env: EnvConfig, robot: RobotName) -> EnvConfig:
    """Return the environment with this robot, and friction and losses randomised in its ranges."""
    ranges = ranges_of(robot)
    drawn = dataclasses.replace(env.randomization, friction=ranges.friction, losses=ranges.losses)
    return dataclasses.replace(env, hardware=ROBOTS[robot], randomization=drawn)
