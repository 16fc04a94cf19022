"""Describe a reference motion as plain numbers, from which `onboard.motion` plays
it."""

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.deploy.onboard.contents import Settings
from bp2_rl.env.controller import motion_of
from bp2_rl.reference.kinematic_trot import KinematicGait, Standing
from bp2_rl.reference.library.table import load_table
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.reference.stepping import foot_circle
from bp2_rl.robot import kinematics
from bp2_rl.settings.env import EnvConfig

Playback = tuple[Settings, dict[str, np.ndarray]]
"""Content of deploy.json, or of its `reference`, and the arrays of reference.npz."""


def playback(config: EnvConfig) -> Playback:
    """Return the settings and arrays of an environment's reference motion, for
    `onboard.motion`.

    Raises:
        UserError: the motion library cannot be read.
    """
    motion = motion_of(config)
    if isinstance(motion, CollocationGait):
        return _trot(motion)
    if isinstance(motion, Standing):
        with jax.enable_x64(True):
            pose = motion(jnp.zeros(3), jnp.zeros(()))
            rate = motion.phase_rate(jnp.zeros(3))
        return {"kind": "none", "phase_rate": float(rate)}, {
            "pose": np.asarray(pose.joint_position)
        }
    assert isinstance(motion, KinematicGait)
    law = dict(vars(motion.law))
    arrays = {
        **law.pop("legs")._asdict(),
        **{name: law.pop(name) for name in ("nominal", "sole_clearance")},
    }
    return {"kind": "kinematic", **law}, arrays


def _trot(gait: CollocationGait) -> Playback:
    hardware = gait.hardware
    table, legs = load_table(gait.file, hardware.anatomy), hardware.anatomy.geometry
    with jax.enable_x64(True):
        rest = gait(jnp.zeros(3), jnp.zeros(()))
    sag = np.asarray(rest.spring_compression)
    angles = np.reshape(hardware.anatomy.stand, (4, 3))
    columns = {
        "sag": sag,  # m, of a spring at rest
        "thigh": legs.thigh,  # m
        # m, knee to the foot's centre, spring at rest
        "lower": legs.lower - legs.foot_radius,
        "lateral": legs.lateral,  # m, abduction axis to the leg's plane, to the left
        "drop": legs.drop,  # m, of the hip axis below the abduction axis
        "bend": legs.bend,  # sign of the knee's angle
        # rad, at which a leg has no reach left
        "straight_knee": kinematics.straightest_knees(hardware),
    }
    settings = {
        "kind": "collocation",
        "stepping_speed": gait.stepping_speed,  # m/s, below which steps shrink
        "foot_circle": foot_circle(hardware),  # m, of the outermost foot
        "legs": [
            dict(zip(columns, map(float, leg), strict=True))
            for leg in zip(*columns.values(), strict=True)
        ],
    }
    arrays = {
        # speed, durations of stance and flight, x of fore and hind foot in mid-stance
        "strides": table.strides,
        "cubics": table.cubics,
        # m
        "stand_feet": kinematics.foot_position(
            angles, sag + legs.foot_radius, hardware
        ),
        "leg_origins": kinematics.leg_origins(hardware),  # m
        # Nm, hip and knee
        "stand_torque": np.asarray(rest.torque).reshape(4, 3)[:, 1:],
    }
    return settings, arrays
