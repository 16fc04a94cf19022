"""The links of a leg in the sagittal plane: x forward, z up, angles about +y, in m and rad.

The functions take numbers of NumPy (complex ones as well), JAX or CasADi.
"""

from typing import Any, NamedTuple

import numpy as np

from bp2_rl.base.arrays import Number
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec

Point = tuple[Any, Any]  # (x, z)


class LegLinks(NamedTuple):
    """Where the links of a leg are; the angle of one that hangs straight down is 0."""

    hip: Point
    knee: Point
    thigh: Any  # angle
    lower: Number  # angle


class LinkBody(NamedTuple):
    """A rigid part of a leg (Table S3)."""

    mass: float  # kg
    inertia: float  # kg m2, about the centre of mass
    centre: Point  # of mass
    angle: Any


def hip_fore_aft(leg: str) -> float:
    """How far forward of the trunk's centre a leg's hip is; names of fore legs begin with F."""
    return bp2.HIP_FORE_AFT if leg.startswith("F") else -bp2.HIP_FORE_AFT


def leg_links(
    xp: Any, trunk: tuple[Any, Any, Any], fore_aft: Number, joints: tuple[Any, Any], leg_length: Number
) -> LegLinks:
    """Hip, knee and links of a leg.

    Args:
        xp: has the cosine and sine for the others: `numpy`, `jax.numpy` or `casadi`.
        trunk: x and z of its centre, and its pitch, nose down.
        fore_aft: of the hip on the trunk.
        joints: angles of hip and knee.
        leg_length: of the thigh.
    """
    (x, z, pitch), (hip, knee) = trunk, joints
    hip_at = x + fore_aft * xp.cos(pitch), z + fore_aft * -xp.sin(pitch)
    thigh = pitch + hip
    return LegLinks(hip_at, down_link(xp, hip_at, thigh, leg_length), thigh, thigh + knee)


def down_link(xp: Any, start: Point, angle: Number, distance: Number) -> Point:
    """The point at a distance from `start` down a link."""
    return start[0] + distance * -xp.sin(angle), start[1] + distance * -xp.cos(angle)


def leg_bodies(xp: Any, leg: LegLinks, lower: Number, hardware: HardwareSpec) -> tuple[LinkBody, LinkBody, LinkBody]:
    """Thigh, shank and toe of a leg whose sole is `lower` from its knee, without the scale of all masses."""

    def body(mass: float, inertia: float, start: Point, angle: Number, distance: Number) -> LinkBody:
        return LinkBody(mass, inertia, down_link(xp, start, angle, distance), angle)

    return (
        body(hardware.bp2.thigh_mass, hardware.bp2.thigh_inertia, leg.hip, leg.thigh, bp2.THIGH_COM),
        body(bp2.SHANK_MASS, bp2.SHANK_INERTIA, leg.knee, leg.lower, bp2.SHANK_LENGTH + bp2.SHANK_COM),
        body(hardware.bp2.toe_mass, hardware.bp2.toe_inertia, leg.knee, leg.lower, lower + bp2.TOE_COM),
    )


def hip_and_knee(x: Number, z: Number, thigh: float, lower: Number) -> tuple[Any, Any]:
    """Hip and knee that put a sole at (x, z) from the hip, knee bent backwards; out of reach in direction only.

    What `kinematics.joint_angles` does in space, but short of straight: solves begin here, and a straight leg is no
    place to.
    """
    cosine = np.clip((x**2 + z**2 - thigh**2 - lower**2) / (2.0 * thigh * lower), -0.95, 0.999)
    knee = -np.arccos(cosine)
    hip = np.arctan2(-x, -z) - np.arctan2(lower * np.sin(knee), thigh + lower * np.cos(knee))
    return hip, knee
