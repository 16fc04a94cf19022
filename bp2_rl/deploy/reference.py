"""Write a reference motion as plain numbers, from which `onboard.motion` plays the motion."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.env.controller import motion_of
from bp2_rl.reference.kinematic_trot import KinematicGait
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.reference.standing import Standing
from bp2_rl.settings.env import EnvConfig


def playback(config: EnvConfig) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return `reference` of deploy.json and the arrays of reference.npz for the motion and the robot of `config`.

    Raises:
        UserError: the motion library cannot be read.
    """
    motion = motion_of(config)
    if isinstance(motion, Standing):
        with jax.enable_x64(True):
            pose, rate = motion(jnp.zeros(3), jnp.zeros(())), motion.phase_rate(jnp.zeros(3))
        return {"kind": "none", "phase_rate": float(rate)}, {"pose": np.asarray(pose.joint_position)}
    assert isinstance(motion, CollocationGait | KinematicGait)
    numbers = dict(vars(motion.law))
    legs = numbers.pop("legs")._asdict()
    arrays = {name: numbers.pop(name) for name, value in list(numbers.items()) if isinstance(value, np.ndarray)}
    return {"kind": config.reference, **numbers}, {**legs, **arrays}
