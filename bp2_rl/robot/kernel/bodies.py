"""Rigid bodies, and bodies joined to one."""

from typing import NamedTuple

from bp2_rl.robot.kernel.vectors import (
    NOWHERE,
    Number,
    Vector,
    about_x,
    add,
    dot,
    scaled,
)


class Inertia(NamedTuple):
    """A rotational inertia, kg m2, a symmetric matrix."""

    xx: Number
    yy: Number
    zz: Number
    xy: Number
    xz: Number
    yz: Number

    def times(self, v: Vector) -> Vector:
        """Return the inertia times a vector v."""
        xx, yy, zz, xy, xz, yz = self
        return dot((xx, xy, xz), v), dot((xy, yy, yz), v), dot((xz, yz, zz), v)

    def plus(self, other: "Inertia") -> "Inertia":
        """Return the sum of two inertias."""
        return Inertia(*(a + b for a, b in zip(self, other, strict=True)))

    def about_x(self, cos: Number, sin: Number) -> "Inertia":
        """Return the inertia after a rotation about x by an angle with this cosine and
        sine."""
        xx, yy, zz, xy, xz, yz = self
        cc, ss, cs = cos * cos, sin * sin, cos * sin
        both = 2.0 * cs * yz
        return Inertia(
            xx,
            cc * yy - both + ss * zz,
            ss * yy + both + cc * zz,
            cos * xy - sin * xz,
            sin * xy + cos * xz,
            cs * (yy - zz) + (cc - ss) * yz,
        )

    def about_y(self, cos: Number, sin: Number) -> "Inertia":
        """Return the inertia after a rotation about y by an angle with this cosine and
        sine."""
        return self._axes_renamed().about_x(cos, sin)._axes_renamed()._axes_renamed()

    def _axes_renamed(self) -> "Inertia":
        """Return the inertia with y called x, z called y and x called z."""
        return Inertia(self.yy, self.zz, self.xx, self.yz, self.xy, self.xz)


class Body(NamedTuple):
    """Mass, centre of mass and inertia of a rigid part, or of the corresponding part of
    all legs."""

    mass: Number  # kg
    com: Vector  # m, its centre of mass
    inertia: Inertia  # about the centre of mass

    def times(self, factor: Number) -> "Body":
        """Return the body with mass and inertia times a factor."""
        return Body(
            self.mass * factor, self.com, Inertia(*(x * factor for x in self.inertia))
        )


class Composite(NamedTuple):
    """Bodies joined rigidly: mass (kg), and first moment (kg m) and inertia about a
    point."""

    mass: Number
    moment: Vector
    inertia: Inertia

    @classmethod
    def of(cls, body: Body) -> "Composite":
        """Return a body as a composite about the point that its centre of mass is
        measured from."""
        return cls(body.mass, NOWHERE, body.inertia).moved(body.com)

    def moved(self, by: Vector) -> "Composite":
        """Return the composite about another point, from which the present point lies
        at `by`."""
        (x, y, z), old = by, self.moment
        new = add(old, scaled(self.mass, by))
        xx, yy, zz = x * (old[0] + new[0]), y * (old[1] + new[1]), z * (old[2] + new[2])
        xy = x * new[1] + y * old[0]
        xz = x * new[2] + z * old[0]
        yz = y * new[2] + z * old[1]
        return Composite(
            self.mass,
            new,
            self.inertia.plus(Inertia(yy + zz, xx + zz, xx + yy, -xy, -xz, -yz)),
        )

    def about_x(self, cos: Number, sin: Number) -> "Composite":
        """Return the composite after a rotation about x by an angle with this cosine
        and sine."""
        return Composite(
            self.mass, about_x(self.moment, cos, sin), self.inertia.about_x(cos, sin)
        )

    def plus(self, other: "Composite") -> "Composite":
        """Return the sum of two composites about the same point and in the same
        axes."""
        return Composite(
            self.mass + other.mass,
            add(self.moment, other.moment),
            self.inertia.plus(other.inertia),
        )
