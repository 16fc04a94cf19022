"""Stand-in until the builder lands."""

import mujoco

from bp2_rl.robot.anatomy import Anatomy


def build(anatomy: Anatomy) -> mujoco.MjSpec:
    raise NotImplementedError
