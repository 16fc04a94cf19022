"""Write a reference motion as plain numbers, from which `onboard.motion` plays the motion."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.env.controller import motion_of
from bp2_rl.reference.kinematic_trot import KinematicGait
from bp2_rl.reference.library.table import load_table
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.reference.standing import Standing
from bp2_rl.reference.stepping import foot_circle
from bp2_rl.robot import bp2, kinematics
from bp2_rl.settings.env import EnvConfig

Playback = tuple[dict[str, Any], dict[str, np.ndarray]]
"""`reference` of deploy.json, and the arrays of reference.npz."""


def playback(config: EnvConfig) -> Playback:
    """Return the numbers of the reference motion that `config` names, for the robot of `config`.

    Raises:
        UserError: the motion library cannot be read.
    """
    motion = motion_of(config)
    if isinstance(motion, CollocationGait):
        return _trot(motion)
    if isinstance(motion, Standing):
        with jax.enable_x64(True):
            pose, rate = motion(jnp.zeros(3), jnp.zeros(())), motion.phase_rate(jnp.zeros(3))
        return {"kind": "none", "phase_rate": float(rate)}, {"pose": np.asarray(pose.joint_position)}
    assert isinstance(motion, KinematicGait)
    return _kinematic(motion)


def _kinematic(gait: KinematicGait) -> Playback:
    law = dict(vars(gait.law))
    arrays = {**law.pop("legs")._asdict(), **{name: law.pop(name) for name in ("nominal", "sole_clearance")}}
    return {"kind": "kinematic", **law}, arrays


def _trot(gait: CollocationGait) -> Playback:
    hardware = gait.hardware
    table = load_table(gait.file, hardware.bp2.leg_length)
    with jax.enable_x64(True):
        rest = gait(jnp.zeros(3), jnp.zeros(()))
    sag = np.asarray(rest.spring_compression)
    angles = np.reshape(bp2.STAND_JOINTS, (4, 3))
    settings = {
        "kind": "collocation",
        "stepping_speed": gait.stepping_speed,  # m/s, below which steps shrink
        "foot_circle": foot_circle(hardware),  # m, of the outermost foot
        "sag": float(sag[0]),  # m, of a spring at rest
        "foot_radius": bp2.FOOT_RADIUS,  # m
        "leg_length": hardware.bp2.leg_length,  # m, of the thigh and of the lower leg alike
        "thigh_lateral": bp2.THIGH_LATERAL,  # m, abduction axis to the leg's plane
        "straight_knee": bp2.KNEE_RANGE[1],  # rad, at which a leg has no reach left
    }
    arrays = {
        "strides": table.strides,  # speed, durations of stance and flight, x of fore and hind foot in mid-stance
        "cubics": table.cubics,
        "stand_feet": kinematics.foot_position(angles, sag + bp2.FOOT_RADIUS, hardware),  # m
        "leg_origins": kinematics.leg_origins(hardware),  # m
        "stand_torque": np.asarray(rest.torque)[1:3],  # Nm, hip and knee
    }
    return settings, arrays
