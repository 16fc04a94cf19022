"""A quadruped's body as plain numbers: links, joints, lengths, joint ranges, standing
pose.

A leg hangs straight down at zero joint angles. Then the frames of its links are
parallel to the trunk's (x forward, y left, z up), the abduction joint turns about +x,
hip and knee about +y, and a spring shortens the lower leg along +z. Legs are in the
order of `LEGS`; SI units.
"""

import dataclasses
import functools
import math
from types import ModuleType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from bp2_rl.base.arrays import Array, ArrayT, Number
from bp2_rl.base.bounds import Range, Within
from bp2_rl.base.errors import UserError, shown
from bp2_rl.robot.conventions import MOTOR_NAMES

# Beyond reach the cosine of the knee stops this far from +-1 and the lengths this far
# from 0, so that every derivative stays finite. Inside BP2's joint ranges (knee <= -0.1
# rad: cosine <= 0.995) it has no effect.
COSINE_MARGIN = 1e-6
SHORTEST_SQUARED = 1e-8  # m2
_LEAST_MOMENT = 1e-12  # kg m2

Vector = tuple[float, float, float]
Inertia = tuple[float, float, float, float, float, float]
"""Inertia tensor, kg m2, about the centre of mass in the link's axes: xx, yy, zz, xy,
xz, yz."""
Place = Annotated[Vector, Within(-10.0, 10.0)]
Radius = Annotated[float, Within(0.0, 1.0, open_below=True)]
"""Radius of a part, m."""
LONGEST_NAME = 80


@dataclasses.dataclass(frozen=True)
class Link:
    """Mass, centre of mass and inertia of a rigid part, in the part's own frame."""

    mass: Annotated[float, Within(0.0, 1e4, open_below=True)]  # kg
    com: Annotated[Vector, Within(-10.0, 10.0)]  # m, its centre of mass
    inertia: Annotated[Inertia, Within(-1e4, 1e4)]

    @property
    def inertia_matrix(self) -> np.ndarray:
        """Return the inertia as a matrix (3, 3), kg m2."""
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def six(inertia: np.ndarray) -> Inertia:
    """Return the six numbers of a symmetric matrix (3, 3), in the order of `Inertia`."""
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    xx, yy, zz, xy, xz, yz = (float(x) for x in inertia[rows, columns])
    return xx, yy, zz, xy, xz, yz


def possible_moments(moments: np.ndarray | Vector, margin: float = 1e-12) -> np.ndarray:
    """Return the nearest principal moments (3), kg m2, that a body can have: positive,
    none above the others' sum.

    They keep off that sum by a margin, a share for rounding, which MuJoCo does not
    allow for.
    """
    positive = np.maximum(moments, _LEAST_MOMENT)
    return np.minimum(positive, (1.0 - margin) * (positive.sum() - positive))


@dataclasses.dataclass(frozen=True, kw_only=True)
class LegParts:
    """A leg's links and the places of its joints; each link's frame is at the joint
    that moves the link."""

    anchor: Place  # m, the abduction joint in the trunk's frame
    hip: Place  # m, the hip joint from the abduction joint
    knee: Place  # m, the knee joint from the hip joint; x is 0
    # m, the centre of the foot's sphere from the knee joint, with the spring at rest; x
    # is 0
    foot: Place
    foot_radius: Radius
    abad: Link
    thigh: Link
    shank: Link
    toe: Link | None = None  # below the spring; None: the shank is rigid
    # m, the toe's frame from the knee joint, with the spring at rest; x is 0; a rigid
    # shank's is unused
    seat: Place = (0.0, 0.0, 0.0)
    # sign of the knee's angle in the gait: -1 bends the knee backwards
    bend: Literal[-1, 1] = -1


@dataclasses.dataclass(frozen=True, kw_only=True)
class Leg(LegParts):
    """A leg's links, the places of its joints, and the ranges of their angles."""

    ranges: tuple[Range, Range, Range]  # rad, of abad, hip and knee

    @property
    def thigh_length(self) -> float:
        """Distance from the hip axis to the knee axis, m."""
        return -self.knee[2]

    @property
    def lower_length(self) -> float:
        """Distance from the knee axis to the sole, with the spring at rest, m."""
        return self.foot_radius - self.foot[2]

    @property
    def lateral(self) -> float:
        """Lateral offset of the foot from the abduction axis, m, positive to the
        left."""
        return self.hip[1] + self.knee[1] + self.foot[1]

    def reach(self, compression: float = 0.0) -> tuple[float, float]:
        """Least and greatest distance of the sole from the hip axis that the knee's
        range allows, m."""
        thigh, lower = self.thigh_length, self.lower_length - compression
        low, high = self.ranges[2]
        # The leg is straight at 0 and folded at +-pi, and so on, which may be inside
        # the range.
        knees = (
            low,
            high,
            *(
                math.pi * n
                for n in range(math.ceil(low / math.pi), math.floor(high / math.pi) + 1)
            ),
        )
        distances = [
            math.hypot(thigh + lower * math.cos(knee), lower * math.sin(knee))
            for knee in knees
        ]
        return min(distances), max(distances)

    @property
    def links(self) -> tuple[Link, ...]:
        """The links from the trunk to the foot."""
        rigid = self.abad, self.thigh, self.shank
        return rigid if self.toe is None else (*rigid, self.toe)


@dataclasses.dataclass(frozen=True)
class JointConvention:
    """Conversion from a joint angle of the robot's own model to `Anatomy`: `sign` times
    the angle plus `offset`."""

    name: str
    sign: Annotated[int, Within(-1, 1)] = 1
    offset: Annotated[float, Within(-100.0, 100.0)] = 0.0  # rad


@dataclasses.dataclass(frozen=True)
class Anatomy:
    """A quadruped's body: trunk, four legs, standing pose and outer dimensions."""

    name: str  # of the robot
    trunk: Link
    legs: tuple[Leg, Leg, Leg, Leg]
    stand: tuple[float, ...]  # rad, the twelve joints' angles in the standing pose
    # m, half extents of the box that the trunk fills, about its frame's origin
    trunk_size: Vector
    # kg, of the robot as it is published; its links may add up to a little less
    weighed_mass: float
    footprint: tuple[float, ...]
    """m, half length and half width of the body with its covers, seen from above: two
    numbers, and no `Range`"""
    thigh_radius: float  # m, of the capsule from hip to knee that a solid leg is
    lower_radius: float  # m, of the capsule from knee to foot
    gear_ratio: float  # behind which the motors' torques and speeds are given
    joints: tuple[JointConvention, ...] = tuple(map(JointConvention, MOTOR_NAMES))

    def __post_init__(self) -> None:
        """Raise `UserError` for a robot's name that no terminal or title can show; in
        titles $ begins mathematics."""
        if not (
            0 < len(self.name) <= LONGEST_NAME
            and self.name.isprintable()
            and "$" not in self.name
        ):
            raise UserError(
                f"a robot's name takes 1 to {LONGEST_NAME} printable letters and no $, got {shown(self.name)}"
            )

    @classmethod
    def of_parts(
        cls,
        trunk: Link,
        legs: tuple[Leg, Leg, Leg, Leg],
        trunk_size: Vector,
        **others: Any,
    ) -> "Anatomy":
        """Return a body from its links: mass and width follow from the links, and motor
        values are at the joint.

        `others` are the remaining fields by name.
        """
        return cls(
            trunk=trunk,
            legs=legs,
            trunk_size=trunk_size,
            weighed_mass=trunk.mass
            + sum(link.mass for leg in legs for link in leg.links),
            footprint=(
                trunk_size[0],
                max(trunk_size[1], *(abs(leg.anchor[1] + leg.lateral) for leg in legs)),
            ),
            gear_ratio=1.0,
            **others,
        )

    @property
    def sprung(self) -> bool:
        """Return whether the legs have springs in their shanks."""
        return self.legs[0].toe is not None

    @property
    def nq(self) -> int:
        """Number of MuJoCo's position coordinates (`qpos`); there is one velocity
        less."""
        return 7 + sum(len(leg.links) for leg in self.legs)

    @property
    def mass(self) -> float:
        """Mass of all links, kg."""
        return self.trunk.mass + sum(
            link.mass for leg in self.legs for link in leg.links
        )

    @property
    def leg_length(self) -> float:
        """Half the length of a straight leg from hip axis to sole, in the mean over the
        legs, m."""
        return sum(leg.thigh_length + leg.lower_length for leg in self.legs) / (
            2.0 * len(self.legs)
        )

    @property
    def beams(self) -> tuple[float, float, float]:
        """Return radius, half length and lateral offset, m, of the two capsules that
        model the trunk."""
        length, width, radius = self.trunk_size
        return radius, max(length - radius, 0.0), max(width - radius, 0.0)

    @functools.cached_property
    def geometry(self) -> "LegGeometry":
        """Return the lengths that kinematics needs, as arrays over the legs."""
        legs = self.legs
        return LegGeometry(
            origins=np.array(
                [np.add(leg.anchor, (leg.hip[0], 0.0, 0.0)) for leg in legs]
            ),
            lateral=np.array([leg.lateral for leg in legs]),
            drop=np.array([-leg.hip[2] for leg in legs]),
            thigh=np.array([leg.thigh_length for leg in legs]),
            lower=np.array([leg.lower_length for leg in legs]),
            bend=np.array([float(leg.bend) for leg in legs]),
            foot_radius=np.array([leg.foot_radius for leg in legs]),
        )


class LegGeometry(NamedTuple):
    """Lengths of the four legs as arrays, m."""

    # (4, 3), where each abduction axis crosses the plane of the hip axis, in the
    # trunk's frame
    origins: Array
    lateral: Array  # from the abduction axis to the foot's plane, to the left
    drop: Array  # of the hip axis below the abduction axis
    thigh: Array
    lower: Array  # knee axis to sole, spring at rest
    bend: Array  # sign of the knee's angle
    foot_radius: Array

    def cast(self, xp: ModuleType, dtype: object) -> "LegGeometry":
        """Return the lengths as arrays of the library `xp` and of this dtype."""
        return LegGeometry(*(xp.asarray(x, dtype=dtype) for x in self))

    def joint_angles(self, feet: ArrayT, compression: Number = 0.0) -> ArrayT:
        """Return joint angles ("... 4 3", rad) that put each sole at `feet` ("... 4 3",
        m, trunk frame); see `kinematics.joint_angles`."""
        xp = feet.__array_namespace__()
        legs = self.cast(xp, feet.dtype)
        p, thigh, d = feet - legs.origins, legs.thigh, legs.lateral
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        # A foot on the abduction axis is moved below it, by more than it can be above.
        z = xp.where(
            y * y + z * z < SHORTEST_SQUARED, z - 2.0 * SHORTEST_SQUARED**0.5, z
        )
        from_abad = xp.sqrt(xp.maximum(y * y + z * z - d * d, SHORTEST_SQUARED))
        abad = xp.atan2(d * z + from_abad * y, d * y - from_abad * z)
        h, lower = from_abad - legs.drop, legs.lower - compression
        cosine = (x * x + h * h - thigh * thigh - lower * lower) / (2.0 * thigh * lower)
        cosine = xp.clip(cosine, -1.0 + COSINE_MARGIN, 1.0 - COSINE_MARGIN)
        sine = legs.bend * xp.sqrt(1.0 - cosine * cosine)
        knee = xp.atan2(sine, cosine)
        hip = xp.atan2(-x, h) - xp.atan2(lower * sine, thigh + lower * cosine)
        return xp.stack([abad, hip, knee], axis=-1)
