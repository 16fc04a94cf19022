"""Adapt a preset to another robot: ranges of its randomisation, and settings scaled to
its size."""

import dataclasses
import math

import numpy as np

from bp2_rl.base.bounds import Range
from bp2_rl.base.errors import UserError
from bp2_rl.robot.conventions import GRAVITY, NUM_MOTORS
from bp2_rl.robot.hardware import IDEAL, HardwareSpec, Losses
from bp2_rl.robot.kinematics import reach
from bp2_rl.settings.env import CommandConfig, EnvConfig, RandomizationConfig
from bp2_rl.settings.reference import KinematicConfig
from bp2_rl.settings.training import TrainConfig

MOST_REACH = 0.98
"""Share of the legs' reach that the kinematic gait uses."""
FIRST_COMMANDS = 0.25
"""Share of the greatest command that a new robot's first commands reach: the robot's
possible speed is unknown, and most robots under faster commands fall all the time."""
FADE = 0.02
"""Share of the relaxed stage after which the entropy cost has halved. A robot runs
faster without the noise that it learned with: Go1, at a command of 1 m/s, by 0.12 m/s
at the standard deviation of 0.17 that the cost holds up, by 0.05 at 0.1."""
SLOW_FRACTION = 0.4
"""Least share of slow commands in the relaxed stage."""


GROUND: Range = 0.5, 1.1
"""Range of the ground's friction that training draws."""
MILD_GROUND: Range = 0.6, 1.1
"""Range of the ground's friction in presets with little randomisation."""


def drawn_for(
    robot: HardwareSpec, others: RandomizationConfig, ground: Range = GROUND
) -> RandomizationConfig:
    """Return the domain randomisation for a robot, with friction and losses drawn as
    widely as its assumed values are uncertain."""
    return dataclasses.replace(
        others,
        friction=(ground[0] / robot.friction, ground[1] / robot.friction),
        losses=(1.0, 1.0) if robot.losses == Losses() else (0.8, 1.2),
    )


def on_robot(env: EnvConfig, robot: HardwareSpec) -> EnvConfig:
    """Return an environment written for BP2 with another robot, sized and randomised
    for it."""
    drawn = drawn_for(robot, env.randomization)
    return sized(dataclasses.replace(env, hardware=robot, randomization=drawn))


def sized(env: EnvConfig) -> EnvConfig:
    """Return settings that were written for BP2, scaled to the size of their robot; those
    of BP2 stay.

    Times of a robot's motion scale with the square root of its length. Times of the
    training stay: episodes, the interval between pushes, the curriculum's evidence and
    the stand before a first launch.
    """
    size = env.hardware.size
    robot = env.hardware
    if robot.is_bp2:
        return env
    speed = speed_factor(robot)
    first = env.curriculum.start_speed or FIRST_COMMANDS * CommandConfig().max_forward
    factors = {
        "library": {"stepping_speed": size.speed},
        "control": {
            "stiffness": size.torque,
            "damping": size.torque * size.time,
            "torque_rate": size.torque / size.time,
            "stopping_time": size.time,
            "launching_speed": speed,
        },
        "commands": {
            "max_forward": speed,
            "max_lateral": size.speed,
            "max_yaw_rate": size.rate,
            "max_backward": size.speed,
            "slow": size.speed,
            "hold_time": size.time,
            "stand_time": size.time,
        },
        "reset": {"command_error": size.speed},
        "randomization": {"com_offset": size.length, "push_velocity": size.speed},
        "termination": {"min_height": size.length, "max_overlap": size.length},
    }
    groups = {
        group: dataclasses.replace(
            getattr(env, group),
            **{
                name: _multiple(factor, getattr(getattr(env, group), name))
                for name, factor in of_group.items()
            },
        )
        for group, of_group in factors.items()
    }
    return dataclasses.replace(
        env,
        **groups,
        reference="kinematic" if env.reference == "collocation" else env.reference,
        gait=_sized_gait(env.gait, robot),
        curriculum=dataclasses.replace(
            env.curriculum, start_speed=speed * min(first, env.commands.max_forward)
        ),
    )


def _multiple(factor: float, value: float | Range | None) -> float | Range | None:
    """Return a setting times a factor; a range is multiplied at both ends."""
    if isinstance(value, tuple):
        return factor * value[0], factor * value[1]
    return None if value is None else factor * value


def with_slow_commands(config: TrainConfig) -> TrainConfig:
    """Return settings of the relaxed stage in which a robot other than BP2 follows slow
    commands well, too."""
    env, ppo = config.env, config.ppo
    if env.hardware.is_bp2:
        return config
    shape = dataclasses.replace(
        env.reward.tracking_shape, floor=min(env.reward.tracking_shape.floor, 0.15)
    )
    commands = dataclasses.replace(
        env.commands, slow_fraction=max(env.commands.slow_fraction, SLOW_FRACTION)
    )
    decay = min(ppo.entropy_decay, FADE * config.run.steps / ppo.steps_per_train_step)
    return dataclasses.replace(
        config,
        env=dataclasses.replace(
            env,
            commands=commands,
            reward=dataclasses.replace(
                env.reward, tracking_shape=shape, schedule="off"
            ),
        ),
        ppo=dataclasses.replace(ppo, entropy_decay=decay),
    )


def speed_factor(robot: HardwareSpec) -> float:
    """Return the factor on BP2's greatest commanded speed that a robot's size, joint
    speeds and power allow."""
    if robot.is_bp2:
        return 1.0
    shares = (
        own / of_bp2 for own, of_bp2 in zip(_limits(robot), _limits(IDEAL), strict=True)
    )
    return min(robot.size.speed, *shares)


def _limits(robot: HardwareSpec) -> tuple[float, float]:
    """Return two measures of a robot's speed, m/s: hip no-load speed times leg length,
    and motors' torque times speed over weight."""
    torque, speed = (
        np.broadcast_to(x, NUM_MOTORS)
        for x in (robot.joint_peak_torque, robot.joint_no_load_speed)
    )
    hips = slice(1, None, 3)
    power = float(np.mean(torque * speed)) / (robot.mass * GRAVITY)
    return float(np.min(speed[hips])) * 2.0 * robot.anatomy.leg_length, power


def _sized_gait(gait: KinematicConfig, robot: HardwareSpec) -> KinematicConfig:
    """Return the kinematic gait with times for the robot's size, and as high as the
    knees' ranges allow for the sweep.

    Raises:
        UserError: the knees cannot stretch even for the sweep.
    """
    size = robot.size
    # as lengths are for BP2's leg
    longest = MOST_REACH * reach(hardware=robot)[1] / size.length
    if longest <= gait.sweep / 2.0:
        raise UserError(
            f"the knees of {robot.anatomy.name} let its legs reach {reach(hardware=robot)[1]:.3g} m, and the gait "
            f"needs {0.5 * gait.sweep * size.length / MOST_REACH:.3g} m: correct the knees' range"
        )
    return dataclasses.replace(
        gait,
        height=min(gait.height, math.sqrt(longest**2 - (gait.sweep / 2.0) ** 2)),
        slow_stance=size.time * gait.slow_stance,
        swing_time=size.time * gait.swing_time,
        stepping_speed=size.speed * gait.stepping_speed,
    )
