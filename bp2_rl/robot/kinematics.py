"""Leg kinematics: where the soles are for given joint angles, and the joint angles that
put them there.

A leg hangs from an abduction axis (+x through the hip), then a hip axis and a knee axis
(+y), a thigh, and a lower leg whose spring shortens it by its compression. With all
joints at zero it hangs straight down. Everything is batched over leading axes, pure,
and works on NumPy (float64 where exactness matters) and JAX arrays alike, in the
caller's precision.
"""

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import Array, ArrayT
from bp2_rl.robot.hardware import IDEAL, HardwareSpec


def leg_origins(hardware: HardwareSpec = IDEAL) -> Float[np.ndarray, "4 3"]:
    """Where each leg's abduction axis crosses the plane of its hip axis, in the trunk
    frame, m."""
    return np.asarray(hardware.anatomy.geometry.origins)


def hip_places(hardware: HardwareSpec = IDEAL) -> Float[np.ndarray, "4 3"]:
    """Where each leg's hip axis crosses the plane of its abduction axis, in the trunk
    frame at no abduction, m."""
    legs = hardware.anatomy.geometry
    return legs.origins - legs.drop[:, None] * np.array([0.0, 0.0, 1.0])


def straightest_knees(hardware: HardwareSpec = IDEAL) -> Float[np.ndarray, "4"]:
    """Return the knees' angles, within their ranges, at which the legs are the longest,
    rad."""
    low, high = np.transpose([leg.ranges[2] for leg in hardware.anatomy.legs])
    return np.clip(0.0, low, high)


def foot_position(
    joints: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"] | float = 0.0,
    hardware: HardwareSpec = IDEAL,
) -> Float[Array, "... 4 3"]:
    """Return the soles' positions in the trunk frame, m.

    Args:
        joints: rad, legs FR FL RR RL x (abad, hip, knee).
        compression: of each leg's spring along the lower leg, m.
        hardware: the robot, by the lengths of its legs.
    """
    xp = joints.__array_namespace__()
    legs = hardware.anatomy.geometry.cast(xp, joints.dtype)
    abad, hip, knee = joints[..., 0], joints[..., 1], joints[..., 2]
    lower, d = legs.lower - compression, legs.lateral
    x = -legs.thigh * xp.sin(hip) - lower * xp.sin(hip + knee)
    # Below the abduction axis, in the leg's plane.
    h = legs.drop + legs.thigh * xp.cos(hip) + lower * xp.cos(hip + knee)
    y = d * xp.cos(abad) + h * xp.sin(abad)
    z = d * xp.sin(abad) - h * xp.cos(abad)
    return xp.stack([x, y, z], axis=-1) + legs.origins


def joint_angles(
    feet: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"] | float = 0.0,
    hardware: HardwareSpec = IDEAL,
) -> Float[Array, "... 4 3"]:
    """Joint angles (abad, hip, knee) that put each sole at `feet`, below the hip, with
    the knee bent as it is built.

    Exact inside reach. A foot out of reach is met in direction only, with the knee
    straight (or folded); the result and its derivatives stay finite for every finite
    foot position.
    """
    return hardware.anatomy.geometry.joint_angles(feet, compression)


def reach(
    compression: float = 0.0, hardware: HardwareSpec = IDEAL
) -> tuple[float, float]:
    """Least and greatest distance of a sole from its hip axis, in the leg's plane, that
    every leg's knee allows, m."""
    folded, straight = zip(
        *(leg.reach(compression) for leg in hardware.anatomy.legs), strict=True
    )
    return max(folded), min(straight)


def yaw_of(quaternion: ArrayT) -> ArrayT:
    """Yaw (rad, "...") of w-x-y-z quaternions ("... 4"): where the x axis points on the
    ground. NumPy and JAX alike."""
    xp = quaternion.__array_namespace__()
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return xp.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
