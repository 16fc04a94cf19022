"""The links of a leg in the sagittal plane: x forward, z up, angles about +y, in m and
rad.

A model in the plane has left and right alike: the left legs of an `Anatomy` stand for
the right ones, too. Abduction is zero, so that the abduction links belong to the trunk.

The functions take numbers of NumPy (complex ones as well), JAX or CasADi.
"""

from types import ModuleType
from typing import NamedTuple

import numpy as np

from bp2_rl.base.arrays import Number
from bp2_rl.robot.anatomy import Anatomy, Leg, Link
from bp2_rl.robot.conventions import LEGS

Point = tuple[Number, Number]  # (x, z)


class LegLinks(NamedTuple):
    """Places of a leg's links in the plane; a link that hangs straight down has the
    angle 0."""

    hip: Point
    knee: Point
    foot: Point  # the point of the lower leg that was asked for
    thigh: Number  # angle
    lower: Number  # angle


class LinkBody(NamedTuple):
    """Mass, inertia, centre of mass and angle of a rigid part in the plane."""

    mass: float  # kg, before masses are scaled
    inertia: float  # kg m2, about the centre of mass, before masses are scaled
    centre: Point  # of mass
    angle: Number


def leg_of(anatomy: Anatomy, name: str) -> Leg:
    """Return the leg in the plane that a name stands for; names of fore legs begin with
    F."""
    return anatomy.legs[LEGS.index("FL" if name.startswith("F") else "RL")]


def hip_of(leg: Leg) -> tuple[float, float]:
    """Return the place (x, z) of a leg's hip axis in the trunk's frame, m."""
    return leg.anchor[0] + leg.hip[0], leg.anchor[2] + leg.hip[2]


def place(xp: ModuleType, start: Point, angle: Number, point: Point) -> Point:
    """Return a point of a link, given from the link's `start` in axes turned by
    `angle`."""
    (x, z), c, s = point, xp.cos(angle), xp.sin(angle)
    return start[0] + x * c + z * s, start[1] - x * s + z * c


def leg_links(
    xp: ModuleType,
    trunk: tuple[Number, Number, Number],
    leg: Leg,
    joints: tuple[Number, Number],
    below: Number,
    stretch: Number = 0.0,
) -> LegLinks:
    """Return the places of hip, knee and a point of the lower leg, and the angles of a
    leg's links.

    Args:
        xp: has the cosine and sine for the others: `numpy`, `jax.numpy` or `casadi`.
        trunk: x and z of its frame, and its pitch, nose down.
        leg: its lengths.
        joints: angles of hip and knee.
        below: how far the point is from the knee.
        stretch: by which the thigh is longer than the leg's.
    """
    (x, z, pitch), (hip, knee) = trunk, joints
    hip_at, thigh = place(xp, (x, z), pitch, hip_of(leg)), pitch + hip
    knee_at = place(xp, hip_at, thigh, (0.0, -leg.thigh_length - stretch))
    return LegLinks(
        hip_at,
        knee_at,
        place(xp, knee_at, thigh + knee, (0.0, -below)),
        thigh,
        thigh + knee,
    )


def leg_bodies(
    xp: ModuleType,
    leg: Leg,
    links: LegLinks,
    compression: Number,
    stretch: Number = 0.0,
) -> list[LinkBody]:
    """Return thigh, shank and, below a spring, toe of a leg as rigid parts; `stretch`
    lengthens the lower leg above the toe."""

    def body(link: Link, start: Point, angle: Number, down: Number = 0.0) -> LinkBody:
        x, _, z = link.com
        return LinkBody(
            link.mass, link.inertia[1], place(xp, start, angle, (x, z + down)), angle
        )

    bodies = [
        body(leg.thigh, links.hip, links.thigh),
        body(leg.shank, links.knee, links.lower),
    ]
    if leg.toe is not None:
        bodies.append(
            body(leg.toe, links.knee, links.lower, leg.seat[2] - stretch + compression)
        )
    return bodies


def trunk_body(
    xp: ModuleType,
    anatomy: Anatomy,
    legs: tuple[str, ...],
    trunk: tuple[Number, Number, Number],
) -> LinkBody:
    """Return these legs' share of the trunk, with their abduction links, as a rigid
    part."""
    share = len(legs) / len(LEGS)
    parts = [(share, anatomy.trunk, (0.0, 0.0, 0.0))]
    parts += [
        (1.0, leg_of(anatomy, name).abad, leg_of(anatomy, name).anchor) for name in legs
    ]
    masses = np.array([part * link.mass for part, link, _ in parts])
    centres = np.array([np.add(at, link.com)[[0, 2]] for _, link, at in parts])
    centre = masses @ centres / np.sum(masses)
    own = sum(part * link.inertia[1] for part, link, _ in parts)
    inertia = own + float(masses @ np.sum((centres - centre) ** 2, axis=1))
    x, z, pitch = trunk
    return LinkBody(
        float(np.sum(masses)),
        inertia,
        place(xp, (x, z), pitch, (centre[0], centre[1])),
        pitch,
    )


def hip_and_knee(
    x: Number, z: Number, thigh: float, lower: Number, bend: int = -1
) -> tuple[Number, Number]:
    """Return the angles of hip and knee that put a sole at (x, z) from the hip; out of
    reach, in that direction only.

    What `kinematics.joint_angles` does in space, but short of straight: solves begin
    here, and a straight leg is no place to. `bend` is the sign of the knee's angle; -1
    bends it backwards.
    """
    cosine = np.clip(
        (x**2 + z**2 - thigh**2 - lower**2) / (2.0 * thigh * lower), -0.95, 0.999
    )
    knee = bend * np.arccos(cosine)
    hip = np.arctan2(-x, -z) - np.arctan2(
        lower * np.sin(knee), thigh + lower * np.cos(knee)
    )
    return hip, knee
