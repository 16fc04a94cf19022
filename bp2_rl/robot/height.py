"""Height of a robot over the ground, in C MuJoCo."""

import mujoco
import numpy as np

DOWN = np.array((0.0, 0.0, -1.0))
GROUND = np.array((1, 0, 0, 0, 0, 0), np.uint8)
"""The groups of geoms that are ground: the first alone."""


def height_over_ground(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the height of the trunk's centre over the ground below it, m; -1 where
    there is no ground, or the trunk is in it."""
    return mujoco.mj_ray(model, data, data.qpos[:3], DOWN, GROUND, True, -1, None)
