"""Pose of the legs, rotations between the trunk's frame and theirs, and the momentum of
each joint.

A leg's frame is the trunk's, turned about x by the abduction angle; in it, thigh, shank
and toe turn about y. Three frames are used, each where it has the fewest products: the
leg's, the trunk's, and the world's axes about the trunk's origin.
"""

from typing import NamedTuple

from bp2_rl.robot.kernel.bodies import Body, Composite
from bp2_rl.robot.kernel.design import Design, Masses
from bp2_rl.robot.kernel.vectors import (
    NOWHERE,
    ZERO,
    Number,
    Vector,
    about_x,
    about_y,
    add,
    cos_sin,
    cross,
    dot,
    scaled,
)


class Rotation(NamedTuple):
    """Rotation matrix from the trunk's axes to the world's, as its rows."""

    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def of(cls, quaternion: tuple[Number, Number, Number, Number]) -> "Rotation":
        """Return the rotation matrix of a unit quaternion w-x-y-z."""
        w, x, y, z = quaternion
        return cls(
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )

    def to_world(self, v: Vector) -> Vector:
        """Return a vector given in the trunk's axes in the world's axes."""
        return dot(self.x, v), dot(self.y, v), dot(self.z, v)

    def to_trunk(self, v: Vector) -> Vector:
        """Return a vector given in the world's axes in the trunk's axes."""
        return add(scaled(v[0], self.x), scaled(v[1], self.y), scaled(v[2], self.z))


class Momentum(NamedTuple):
    """Momentum of all that a joint moves, at unit rate: linear, and angular about the
    abduction joint."""

    linear: Vector
    angular: Vector


class Legs(NamedTuple):
    """The pose of the legs; lengths in m, vectors in the leg's frame unless another is
    named."""

    cos: Number  # of the abduction angle
    sin: Number
    shank: tuple[Number, Number]  # cosine and sine of the shank's pitch
    hip: Vector  # from the abduction joint
    thigh: Vector  # from the hip to the knee
    foot: Vector  # the centre of its sole, from the abduction joint
    # abad, thigh, shank and, with a spring, toe: from the joints abad, hip, knee and
    # knee
    bodies: tuple[Body, ...]

    @classmethod
    def of(cls, design: Design, masses: Masses, coordinates: list[Number]) -> "Legs":
        """Return the legs' pose at coordinates abad, hip and knee, rad, and spring,
        m."""
        abad, hip, knee, *spring = coordinates
        cos, sin = cos_sin(abad)
        in_thigh = cos_sin(hip)
        in_shank = cos_sin(hip + knee)
        toe = add(design.toe, (ZERO, ZERO, spring[0])) if spring else NOWHERE
        thigh = about_y(design.knee, *in_thigh)
        own, thighs, *lower = masses.links
        bodies = [own, _pitched(thighs, in_thigh), _pitched(lower[0], in_shank)]
        bodies += [
            _pitched(body._replace(com=add(toe, body.com)), in_shank)
            for body in lower[1:]
        ]
        foot = add(design.hip, thigh, about_y(add(toe, design.foot), *in_shank))
        return cls(cos, sin, in_shank, design.hip, thigh, foot, tuple(bodies))

    @property
    def knee(self) -> Vector:
        """Place of the knee from the abduction joint, m."""
        return add(self.hip, self.thigh)

    @property
    def compressed(self) -> Vector:
        """Direction in which a spring is compressed, a unit vector."""
        cos, sin = self.shank
        return sin, ZERO, cos

    def to_trunk(self, v: Vector) -> Vector:
        """Return a vector given in the legs' frames in the trunk's axes."""
        return about_x(v, self.cos, self.sin)

    def from_trunk(self, v: Vector) -> Vector:
        """Return a vector given in the trunk's axes in the legs' frames."""
        return about_x(v, self.cos, -self.sin)

    def composites(self) -> tuple[Composite, Composite, Composite]:
        """Return the bodies that abad, hip and knee move, joined, each about the joint
        that moves them."""
        abad, thigh, shank, *toe = (Composite.of(body) for body in self.bodies)
        below_knee = shank.plus(toe[0]) if toe else shank
        below_hip = thigh.plus(below_knee.moved(self.thigh))
        return abad.plus(below_hip.moved(self.hip)), below_hip, below_knee

    def momenta(
        self, moved: tuple[Composite, Composite, Composite]
    ) -> tuple[Momentum, ...]:
        """Return the momenta, at unit rate, of abad, hip, knee and, if there is one,
        spring."""
        leg, below_hip, below_knee = moved
        _, y, z = leg.moment
        momenta = [
            Momentum((ZERO, -z, y), (leg.inertia.xx, leg.inertia.xy, leg.inertia.xz)),
            _pitch_momentum(below_hip, self.hip),
            _pitch_momentum(below_knee, self.knee),
        ]
        for toe in self.bodies[3:]:
            linear = scaled(toe.mass, self.compressed)
            momenta.append(Momentum(linear, cross(add(self.knee, toe.com), linear)))
        return tuple(momenta)


class RobotPose(NamedTuple):
    """Rotation of the trunk, and pose of the legs."""

    rotation: Rotation
    legs: Legs


def _pitched(body: Body, angle: tuple[Number, Number]) -> Body:
    """Return a body after a rotation about y by an angle with this cosine and sine."""
    return Body(body.mass, about_y(body.com, *angle), body.inertia.about_y(*angle))


def _pitch_momentum(moved: Composite, joint: Vector) -> Momentum:
    """Return the momentum of the bodies `moved` when they turn about y through a joint
    at unit rate."""
    x, _, z = moved.moment
    linear = z, ZERO, -x
    inertia = moved.inertia
    return Momentum(
        linear, add((inertia.xy, inertia.yy, inertia.yz), cross(joint, linear))
    )
