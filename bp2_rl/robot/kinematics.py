"""Leg kinematics: where the soles are for given joint angles, and the joint angles that put them there.

A leg hangs from an abduction axis (+x through the hip), then a hip axis and a knee axis (+y), a thigh, and a
lower leg whose spring shortens it by its compression. With all joints at zero it hangs straight down.
Everything is batched over leading axes, pure, and works on NumPy (float64 where exactness matters) and JAX
arrays alike, in the caller's precision.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import Array, ArrayT
from bp2_rl.robot import specs
from bp2_rl.robot.specs import IDEAL, HardwareSpec

FORE_AFT = np.array([1.0, 1.0, -1.0, -1.0]) * specs.HIP_FORE_AFT  # m, x of each leg's hip in the trunk frame
SIDE = np.array([-1.0, 1.0, -1.0, 1.0])  # y of each leg's side: right, left, right, left

# Beyond reach the cosine of the knee stops this far from +-1 and the lengths this far from 0, so that every
# derivative stays finite. Inside the joint ranges (knee <= -0.1 rad: cosine <= 0.995) it has no effect.
_COSINE_MARGIN = 1e-6
_SHORTEST_SQUARED = 1e-8  # m2


def leg_origins(hardware: HardwareSpec = IDEAL) -> Float[np.ndarray, "4 3"]:
    """Where each leg's abduction axis crosses the plane of its hip axis, in the trunk frame, m."""
    return np.stack([FORE_AFT, np.array(hardware.hip_laterals), np.zeros(4)], axis=-1)


def foot_position(
    joints: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"] | float = 0.0,
    hardware: HardwareSpec = IDEAL,
) -> Float[Any, "... 4 3"]:
    """Position of each sole in the trunk frame, m.

    Args:
        joints: rad, legs FR FL RR RL x (abad, hip, knee).
        compression: of each leg's spring along the lower leg, m.
        hardware: the robot, by its leg length and its tracks.
    """
    xp = joints.__array_namespace__()
    abad, hip, knee = joints[..., 0], joints[..., 1], joints[..., 2]
    leg_length = hardware.leg_length
    lower = leg_length - compression
    x = -leg_length * xp.sin(hip) - lower * xp.sin(hip + knee)
    h = leg_length * xp.cos(hip) + lower * xp.cos(hip + knee)  # below the hip axis, in the leg's plane
    d = _outwards(xp, joints.dtype)
    y = d * xp.cos(abad) + h * xp.sin(abad)
    z = d * xp.sin(abad) - h * xp.cos(abad)
    return xp.stack([x, y, z], axis=-1) + xp.asarray(leg_origins(hardware), dtype=joints.dtype)


def joint_angles(
    feet: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"] | float = 0.0,
    hardware: HardwareSpec = IDEAL,
) -> Float[Any, "... 4 3"]:
    """Joint angles (abad, hip, knee) that put each sole at `feet`: knee bent backwards, foot below the hip.

    Exact inside reach. A foot out of reach is met in direction only, with the knee straight (or folded); the
    result and its derivatives stay finite for every finite foot position.
    """
    xp = feet.__array_namespace__()
    p, leg_length = feet - xp.asarray(leg_origins(hardware), dtype=feet.dtype), hardware.leg_length
    d = _outwards(xp, feet.dtype)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    # A foot on the abduction axis is moved below it, by more than it can be above.
    z = xp.where(y * y + z * z < _SHORTEST_SQUARED, z - 2.0 * _SHORTEST_SQUARED**0.5, z)
    h = xp.sqrt(xp.maximum(y * y + z * z - d * d, _SHORTEST_SQUARED))
    abad = xp.atan2(d * z + h * y, d * y - h * z)
    lower = leg_length - compression
    cosine = (x * x + h * h - leg_length**2 - lower * lower) / (2.0 * leg_length * lower)
    cosine = xp.clip(cosine, -1.0 + _COSINE_MARGIN, 1.0 - _COSINE_MARGIN)
    sine = -xp.sqrt(1.0 - cosine * cosine)
    knee = xp.atan2(sine, cosine)
    hip = xp.atan2(-x, h) - xp.atan2(lower * sine, leg_length + lower * cosine)
    return xp.stack([abad, hip, knee], axis=-1)


def reach(compression: float = 0.0, *, leg_length: float = specs.THIGH_LENGTH) -> tuple[float, float]:
    """Least and greatest distance of a sole from its hip axis, in the leg's plane, that the knee's range allows, m."""
    lower = leg_length - compression
    folded, straight = (
        float(np.sqrt(leg_length**2 + lower**2 + 2.0 * leg_length * lower * np.cos(knee))) for knee in specs.KNEE_RANGE
    )
    return folded, straight


def yaw_of(quaternion: ArrayT) -> ArrayT:
    """Yaw (rad, "...") of w-x-y-z quaternions ("... 4"): where the x axis points on the ground. NumPy and JAX alike."""
    xp = quaternion.__array_namespace__()
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return xp.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _outwards(xp: Any, dtype: Any) -> Any:
    """Signed offset of each leg's plane from its abduction axis, m."""
    return xp.asarray(SIDE * specs.THIGH_LATERAL, dtype=dtype)
