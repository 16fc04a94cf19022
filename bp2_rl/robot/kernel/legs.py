"""Where the legs are, how they turn the trunk's frame into theirs, and the momentum of each of their joints.

A leg's frame is the trunk's, turned about x by the abduction angle; in it, thigh, shank and toe move in a plane across
y. Three frames are used, each where it has the fewest products: the leg's, the trunk's, and the world's axes about the
trunk's origin.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from bp2_rl.robot.kernel.design import Design, Masses
from bp2_rl.robot.kernel.vectors import Number, Vector, add, cos_sin, cross, dot, scaled

PlanePoint = tuple[Number, Number]
"""x and z in a leg's plane."""


class Rotation(NamedTuple):
    """From the trunk's axes to the world's, by its rows."""

    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def of(cls, quaternion: tuple[Number, Number, Number, Number]) -> "Rotation":
        """Return the rotation of a quaternion of length 1."""
        w, x, y, z = quaternion
        return cls(
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )

    def to_world(self, v: Vector) -> Vector:
        """A vector of the trunk in the world's axes."""
        return dot(self.x, v), dot(self.y, v), dot(self.z, v)

    def to_trunk(self, v: Vector) -> Vector:
        """A vector of the world in the trunk's axes."""
        return add(scaled(v[0], self.x), scaled(v[1], self.y), scaled(v[2], self.z))


class Inertia(NamedTuple):
    """A rotational inertia, kg m2; a leg's parts have no xy and no yz of their own."""

    xx: Number
    yy: Number
    zz: Number
    xz: Number

    @classmethod
    def turned(cls, principal: Vector, cos: Number, sin: Number) -> "Inertia":
        """Return the inertia of a body that is turned about y."""
        x, y, z = principal
        along, across, both = cos * cos, sin * sin, sin * cos
        return cls(along * x + across * z, y, across * x + along * z, both * (z - x))

    def times(self, v: Vector) -> Vector:
        """I v."""
        return self.xx * v[0] + self.xz * v[2], self.yy * v[1], self.xz * v[0] + self.zz * v[2]


class Part(NamedTuple):
    """A body of the legs: mass, centre of mass from the abduction joint, and inertia about it; the leg's frame."""

    mass: Number
    com: Vector
    inertia: Inertia


class Momentum(NamedTuple):
    """The momentum of all that a joint moves at unit rate: linear, and angular about the abduction joint."""

    linear: Vector
    angular: Vector


class Legs(NamedTuple):
    """The pose of the legs. Lengths in m, from the abduction joint, in the leg's frame unless another is named."""

    cos: Number  # of the abduction angle
    sin: Number
    shank: PlanePoint  # cosine and sine of the shank's pitch
    knee: PlanePoint
    foot: Vector  # its centre
    parts: tuple[Part, Part, Part, Part]  # abad, thigh, shank, toe

    @classmethod
    def of(cls, design: Design, masses: Masses, coordinates: list[Number]) -> "Legs":
        """Return the pose at these coordinates: abad, hip and knee in rad, spring in m."""
        abad, hip, knee, compression = coordinates
        (cos, sin), (cos_t, sin_t), (cos_s, sin_s) = cos_sin(abad), cos_sin(hip), cos_sin(hip + knee)
        knee_x, knee_z = -design.thigh * sin_t, -design.thigh * cos_t
        toe, foot = design.toe_com - compression, design.foot - compression
        zero = jnp.zeros_like(abad)
        coms = (
            (design.abad_com + zero, zero, zero),
            (-design.thigh_com * sin_t, design.hip, -design.thigh_com * cos_t),
            (knee_x - design.shank_com * sin_s, design.hip, knee_z - design.shank_com * cos_s),
            (knee_x - toe * sin_s, design.hip, knee_z - toe * cos_s),
        )
        principal = masses.inertias
        inertias = (
            Inertia(*principal[0], zero),
            Inertia.turned(principal[1], cos_t, sin_t),
            Inertia.turned(principal[2], cos_s, sin_s),
            Inertia.turned(principal[3], cos_s, sin_s),
        )
        parts: Any = tuple(Part(*part) for part in zip(masses.bodies, coms, inertias, strict=True))
        return cls(
            cos=cos,
            sin=sin,
            shank=(cos_s, sin_s),
            knee=(knee_x, knee_z),
            foot=(knee_x - foot * sin_s, design.hip, knee_z - foot * cos_s),
            parts=parts,
        )

    def to_trunk(self, v: Vector) -> Vector:
        """A vector of the legs in the trunk's axes."""
        return v[0], self.cos * v[1] - self.sin * v[2], self.sin * v[1] + self.cos * v[2]

    def from_trunk(self, v: Vector) -> Vector:
        """A vector of the trunk in the legs' axes."""
        return v[0], self.cos * v[1] + self.sin * v[2], self.cos * v[2] - self.sin * v[1]

    def momenta(self, whole: "Composite") -> tuple[Momentum, Momentum, Momentum, Momentum]:
        """Return the momenta of abduction, hip, knee and spring."""
        h, toe = whole.moment, self.parts[3]
        cos, sin = self.shank
        along = toe.mass * sin, jnp.zeros_like(cos), toe.mass * cos
        return (
            Momentum((jnp.zeros_like(cos), -h[2], h[1]), (whole.xx, whole.xy, whole.xz)),
            _pitch_momentum((0.0, 0.0), self.parts[1:]),
            _pitch_momentum(self.knee, self.parts[2:]),
            Momentum(along, cross(toe.com, along)),
        )


class RobotPose(NamedTuple):
    """How the trunk is turned, and where the legs are."""

    rotation: Rotation
    legs: Legs


class Composite(NamedTuple):
    """A whole leg as one rigid body: mass, first moment and inertia about the abduction joint, in the leg's frame."""

    mass: Number
    moment: Vector
    xx: Number
    yy: Number
    zz: Number
    xy: Number
    xz: Number
    yz: Number

    @classmethod
    def of(cls, legs: Legs) -> "Composite":
        """Return the composite inertia of legs in their present pose."""
        parts = legs.parts
        moments = [scaled(part.mass, part.com) for part in parts]
        squares = [(m[0] * r[0], m[1] * r[1], m[2] * r[2]) for m, (_, r, _) in zip(moments, parts, strict=True)]
        return cls(
            mass=sum(part.mass for part in parts),
            moment=add(*moments),
            xx=sum(part.inertia.xx + s[1] + s[2] for part, s in zip(parts, squares, strict=True)),
            yy=sum(part.inertia.yy + s[0] + s[2] for part, s in zip(parts, squares, strict=True)),
            zz=sum(part.inertia.zz + s[0] + s[1] for part, s in zip(parts, squares, strict=True)),
            xy=-sum(m[0] * part.com[1] for part, m in zip(parts, moments, strict=True)),
            xz=sum(part.inertia.xz - m[0] * part.com[2] for part, m in zip(parts, moments, strict=True)),
            yz=-sum(m[1] * part.com[2] for part, m in zip(parts, moments, strict=True)),
        )


def _pitch_momentum(about: PlanePoint, parts: tuple[Part, ...]) -> Momentum:
    """Return the momentum of a turn about y through this point of the plane."""
    levers = [(part.com[0] - about[0], part.com[2] - about[1]) for part in parts]
    x = sum(part.mass * z for part, (_, z) in zip(parts, levers, strict=True))
    z = -sum(part.mass * x for part, (x, _) in zip(parts, levers, strict=True))
    turn = sum(
        part.inertia.yy + part.mass * (part.com[2] * dz + part.com[0] * dx)
        for part, (dx, dz) in zip(parts, levers, strict=True)
    )
    side = parts[0].com[1]  # all parts are as far from the abduction axis's plane
    return Momentum((x, jnp.zeros_like(x), z), (side * z, turn, -side * x))
