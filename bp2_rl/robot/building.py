"""Build an editable MuJoCo model from an `Anatomy`: BP2's scene with another robot in
BP2's place.

Ground, solver, contact settings and materials are those of `assets/bp2_mjcf`, and every
part has the name that the corresponding part of BP2 has there. The bodies are in
`quadruped.xml`. What a `HardwareSpec` says of motors, springs and contacts
`robot.model` applies.
"""

import math

import mujoco
import numpy as np

from bp2_rl.base.assets import asset_path, render
from bp2_rl.robot import bp2
from bp2_rl.robot.anatomy import Anatomy, Link, possible_moments
from bp2_rl.robot.conventions import GRAVITY, JOINTS, LEGS, MOTOR_NAMES

LENGTH = bp2.THIGH_LENGTH + bp2.SHANK_LENGTH + bp2.SPRING_REST_LENGTH + bp2.TOE_LENGTH
"""Length of BP2's straight leg, m, for which the cameras and the looks are drawn."""
TUBES = bp2.SHANK_REACH / bp2.THIGH_LENGTH
RODS = bp2.RODS_BELOW_KNEE / bp2.THIGH_LENGTH
"""Ends of a sprung leg's shank (`TUBES`) and toe, as shares of the lower leg's length:
BP2's shares."""


def build_spec(
    anatomy: Anatomy, *, spring_stiffness: float = bp2.SPRING_STIFFNESS
) -> mujoco.MjSpec:
    """Return the robot on BP2's ground as an `MjSpec`.

    Args:
        anatomy: the robot's body, which names the model.
        spring_stiffness: N/m, with which the springs sag in the keyframe `stand`.
    """
    scene, robot = (
        asset_path(f"bp2_mjcf/{name}.xml").read_text() for name in ("scene_flat", "bp2")
    )
    text = render(
        "robot/quadruped.xml",
        head=robot.partition("<worldbody>")[0],
        body=anatomy,
        legs=list(zip(LEGS, anatomy.legs, strict=True)),
        motors=MOTOR_NAMES,
        joints=(*JOINTS, *["spring"] * anatomy.sprung),
        stand=standing(anatomy, spring_stiffness).tolist(),
        principal=_principal_inertia,
        scale=max(2.0 * anatomy.leg_length / LENGTH, 0.4),
        tubes=TUBES,
        rods=RODS,
    )
    spec = mujoco.MjSpec.from_string(scene, include={"bp2.xml": text.encode()})
    spec.modelname = anatomy.name
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec


def standing(
    anatomy: Anatomy, spring_stiffness: float = bp2.SPRING_STIFFNESS
) -> np.ndarray:
    """Return `qpos` of the standing pose: trunk level, lowest sole on the ground,
    springs loaded.

    A spring carries its share of what is above it, along the lower leg.
    """
    qpos = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    heights: list[float] = []
    for i, leg in enumerate(anatomy.legs):
        abad, hip, knee = anatomy.stand[3 * i : 3 * i + 3]
        sag = 0.0
        if leg.toe is not None:
            load = GRAVITY * (anatomy.mass / len(LEGS) - leg.toe.mass)
            sag = load * math.cos(abad) * math.cos(hip + knee) / spring_stiffness
        qpos += [abad, hip, knee, *([sag] if anatomy.sprung else [])]
        below_hip = (
            leg.thigh_length * math.cos(hip)
            - (leg.foot[2] + sag) * math.cos(hip + knee)
            - leg.hip[2]
        )
        heights.append(
            leg.foot_radius
            + below_hip * math.cos(abad)
            - leg.lateral * math.sin(abad)
            - leg.anchor[2]
        )
    qpos[2] = max(heights)
    return np.array(qpos)


def _principal_inertia(link: Link) -> str:
    """Return a link's principal moments of inertia, and their axes where needed, as
    attributes of MJCF."""
    if not any(link.inertia[3:]):
        return f'diaginertia="{_row(possible_moments(link.inertia[:3]))}"'
    principal, axes = np.linalg.eigh(link.inertia_matrix)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.flatten())
    moments = possible_moments(principal)
    return f'diaginertia="{_row(moments)}" quat="{_row(quaternion)}"'


def _row(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))
