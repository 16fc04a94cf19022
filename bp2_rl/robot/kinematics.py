"""Leg kinematics: where the soles are for given joint angles, and the joint angles that put them there.

A leg hangs from an abduction axis (+x through the hip), then a hip axis and a knee axis (+y), a thigh, and a
lower leg whose spring shortens it by its compression. With all joints at zero it hangs straight down. Where
abduction, roll and yaw are zero, legs move in the sagittal plane: the `planar_*` functions are for that.
Everything is batched over leading axes, pure, and works on NumPy (float64 where exactness matters) and JAX
arrays alike, in the caller's precision.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import Array, ArrayT, Number
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


def leg_extension(feet: Float[Array, "... 4 3"], hardware: HardwareSpec = IDEAL) -> Float[Any, "... 4"]:
    """Distance of each sole from its hip axis, in the leg's plane, m: what `reach` bounds."""
    xp = feet.__array_namespace__()
    p = feet - xp.asarray(leg_origins(hardware), dtype=feet.dtype)
    return xp.sqrt(xp.maximum(xp.sum(p * p, axis=-1) - specs.THIGH_LATERAL**2, 0.0))


def reach(compression: float = 0.0, *, leg_length: float = specs.THIGH_LENGTH) -> tuple[float, float]:
    """Least and greatest `leg_extension` that the knee's range allows, m."""
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


# --- In the sagittal plane: x forward, z up, angles about +y -------------------------------------------------------

Point = tuple[Any, Any]  # (x, z), m


class PlanarLeg(NamedTuple):
    """Where the links of a leg are; the angle of one that hangs straight down is 0 rad."""

    hip: Point
    knee: Point
    thigh: Any  # rad
    lower: Number  # rad


class PlanarBody(NamedTuple):
    """A rigid part of a leg (Table S3)."""

    mass: float  # kg
    inertia: float  # kg m2, about the centre of mass
    centre: Point  # of mass
    angle: Any  # rad


def hip_fore_aft(leg: str) -> float:
    """How far forward of the trunk's centre a leg's hip is, m; names of fore legs begin with F."""
    return specs.HIP_FORE_AFT if leg.startswith("F") else -specs.HIP_FORE_AFT


def planar_leg(
    xp: Any, trunk: Point, pitch: Number, fore_aft: Number, hip: Number, knee: Number, leg_length: Number
) -> PlanarLeg:
    """Hip, knee and links of a leg.

    Args:
        xp: has the cosine and sine for the others: `numpy` (complex numbers as well), `jax.numpy` or `casadi`.
        trunk: its centre.
        pitch: of the trunk, rad, nose down.
        fore_aft: of the hip on the trunk, m.
        hip: rad.
        knee: rad.
        leg_length: of the thigh, m.
    """
    hip_at = trunk[0] + fore_aft * xp.cos(pitch), trunk[1] + fore_aft * -xp.sin(pitch)
    thigh = pitch + hip
    return PlanarLeg(hip_at, planar_along(xp, hip_at, thigh, leg_length), thigh, thigh + knee)


def planar_along(xp: Any, start: Point, angle: Number, distance: Number) -> Point:
    """The point at a distance from `start` down a link."""
    return start[0] + distance * -xp.sin(angle), start[1] + distance * -xp.cos(angle)


def planar_bodies(
    xp: Any, leg: PlanarLeg, lower: Number, hardware: HardwareSpec
) -> tuple[PlanarBody, PlanarBody, PlanarBody]:
    """Thigh, shank and toe of a leg whose sole is `lower` metres from its knee, without the scale of all masses."""

    def body(mass: float, inertia: float, start: Point, angle: Number, distance: Number) -> PlanarBody:
        return PlanarBody(mass, inertia, planar_along(xp, start, angle, distance), angle)

    return (
        body(hardware.thigh_mass, hardware.thigh_inertia, leg.hip, leg.thigh, specs.THIGH_COM),
        body(specs.SHANK_MASS, specs.SHANK_INERTIA, leg.knee, leg.lower, specs.SHANK_LENGTH + specs.SHANK_COM),
        body(hardware.toe_mass, hardware.toe_inertia, leg.knee, leg.lower, lower + specs.TOE_COM),
    )


def planar_foot(
    joints: tuple[Any, Any, Any, Any], rates: tuple[Any, Any, Any, Any], leg_length: float
) -> tuple[Point, Point]:
    """Each leg's end from the trunk's centre, (x, z), and its rate, by pitch, hip, knee and length of the lower leg.

    What `planar_leg` says, with rates, but not to the last bit: policies were trained on motions in this arithmetic.
    """
    (pitch, hip, knee, lower), (pitch_rate, hip_rate, knee_rate, lower_rate) = joints, rates
    thigh, thigh_rate = pitch + hip, pitch_rate + hip_rate
    # Along the trunk, down the thigh, down the lower leg: length, its rate, angle, its rate.
    links: tuple[tuple[Any, Any, Any, Any], ...] = (
        (FORE_AFT, 0.0, pitch, pitch_rate),
        (leg_length, 0.0, thigh + np.pi / 2, thigh_rate),
        (lower, lower_rate, thigh + knee + np.pi / 2, thigh_rate + knee_rate),
    )
    x = np.sum([length * np.cos(angle) for length, _, angle, _ in links], axis=0)
    z = np.sum([-length * np.sin(angle) for length, _, angle, _ in links], axis=0)
    x_rate = np.sum([change * np.cos(at) - length * turn * np.sin(at) for length, change, at, turn in links], axis=0)
    z_rate = np.sum([-change * np.sin(at) - length * turn * np.cos(at) for length, change, at, turn in links], axis=0)
    return (x, z), (x_rate, z_rate)


def planar_joint_angles(x: Number, z: Number, thigh: float, lower: Number) -> tuple[Any, Any]:
    """Hip and knee that put a sole at (x, z) from the hip, knee bent backwards; out of reach in direction only.

    What `joint_angles` does in space, but short of straight: solves begin here, and a straight leg is no place to.
    """
    cosine = np.clip((x**2 + z**2 - thigh**2 - lower**2) / (2.0 * thigh * lower), -0.95, 0.999)
    knee = -np.arccos(cosine)
    hip = np.arctan2(-x, -z) - np.arctan2(lower * np.sin(knee), thigh + lower * np.cos(knee))
    return hip, knee


def _outwards(xp: Any, dtype: Any) -> Any:
    """Signed offset of each leg's plane from its abduction axis, m."""
    return xp.asarray(SIDE * specs.THIGH_LATERAL, dtype=dtype)
