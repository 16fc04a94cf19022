"""The equations of motion: the inertia matrix, an arrow, and the bias of velocities and gravity.

The unknowns are the acceleration of the trunk's origin, the trunk's angular acceleration, both in the world's axes, and
those of the legs' coordinates. Legs are coupled through the trunk alone, which makes the matrix an arrow.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp

from bp2_rl.robot.kernel.design import Design
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Composite, Inertia, Legs, Masses, Momentum, Part, Plane, Rotation
from bp2_rl.robot.kernel.vectors import Number, Vector, add, cross, dot, over_legs, scaled

Rows = list[list[Number]]


class Accelerations(NamedTuple):
    """Or velocities, or forces: of the trunk, six of (N,), and of each leg's four coordinates, (4, N)."""

    trunk: list[Number]
    legs: list[Number]

    def in_world(self, rotation: Rotation) -> "Accelerations":
        """Return these accelerations in the world's axes; in MuJoCo's the trunk turns about its own axes."""
        x, y, z, *turn = self.trunk
        return Accelerations([x, y, z, *rotation.to_world((turn[0], turn[1], turn[2]))], self.legs)

    def in_mujoco(self, rotation: Rotation) -> "Accelerations":
        """Return these accelerations in MuJoCo's coordinates, where the trunk turns about its own axes."""
        x, y, z, *turn = self.trunk
        return Accelerations([x, y, z, *rotation.to_trunk((turn[0], turn[1], turn[2]))], self.legs)


class Arrow(NamedTuple):
    """A symmetric matrix by its lower halves."""

    trunk: Rows  # 6 x 6, (N,)
    coupling: Rows  # leg's coordinate x the trunk's six, (4, N)
    legs: Rows  # 4 x 4, (4, N)


def inertia_matrix(barriers: FusionBarriers, design: Design, masses: Masses, legs: Legs, rotation: Rotation) -> Arrow:
    """The inertia matrix, kg, kg m and kg m2."""
    whole = barriers(Composite.of, legs)
    momenta = barriers(Legs.momenta, legs, whole)
    return Arrow(
        trunk=barriers(partial(_trunk_block, design), masses, legs, whole, rotation),
        coupling=barriers(partial(_coupling, design), legs, momenta, rotation),
        legs=barriers(partial(_legs_block, design), legs, momenta),
    )


def smooth_force(
    design: Design,
    masses: Masses,
    legs: Legs,
    rotation: Rotation,
    compression: Number,
    velocity: Accelerations,
    applied: Accelerations,
) -> Accelerations:
    """All forces but the constraints': applied ones, springs, gravity and what velocities cost, N and Nm.

    The springs' compression in m; velocities and applied forces in MuJoCo's coordinates.
    """
    _, _, _, *spin = velocity.trunk
    trunk, joints = _bias(design, masses, legs, rotation, (spin[0], spin[1], spin[2]), velocity.legs)
    stiffness, damping = design.spring
    spring = -stiffness * compression - damping * velocity.legs[3]
    for stop, least, most in design.stops:
        spring = spring - stop * (compression - jnp.clip(compression, least, most))
    outside = applied.in_world(rotation)
    free = [force - bias for force, bias in zip(outside.legs, joints, strict=True)]
    free[3] = free[3] + spring
    return Accelerations([force - bias for force, bias in zip(outside.trunk, trunk, strict=True)], free)


def _trunk_block(design: Design, masses: Masses, legs: Legs, whole: Composite, rotation: Rotation) -> Rows:
    """Return the trunk's block of the mass matrix: all bodies as one, about the trunk's origin, in the world's axes."""
    anchor, com, own = design.anchor, masses.trunk_com, masses.trunk_inertia
    moment = legs.to_trunk(whole.moment)
    # The inertia of a leg, turned by its abduction ...
    cc, ss, cs = legs.cos * legs.cos, legs.sin * legs.sin, legs.cos * legs.sin
    xx, yy = whole.xx, cc * whole.yy - 2.0 * cs * whole.yz + ss * whole.zz
    zz = ss * whole.yy + 2.0 * cs * whole.yz + cc * whole.zz
    xy, xz = legs.cos * whole.xy - legs.sin * whole.xz, legs.sin * whole.xy + legs.cos * whole.xz
    yz = cs * (whole.yy - whole.zz) + (cc - ss) * whole.yz
    # ... and moved from the abduction joint, on the plane z = 0, to the trunk's origin.
    ax, ay, _ = anchor
    on_x, on_y = 2.0 * ax * moment[0] + whole.mass * (ax * ax), 2.0 * ay * moment[1] + whole.mass * (ay * ay)
    xx, yy, zz = xx + on_y, yy + on_x, zz + on_x + on_y
    xy = xy - (ax * moment[1] + ay * moment[0] + whole.mass * (ax * ay))
    xz, yz = xz - ax * moment[2], yz - ay * moment[2]

    mass = masses.trunk + over_legs(whole.mass)
    first = add(
        scaled(masses.trunk, com),
        (
            over_legs(moment[0] + whole.mass * ax),
            over_legs(moment[1] + whole.mass * ay),
            over_legs(moment[2]),
        ),
    )
    mx, my, mz = scaled(masses.trunk, com)
    ixx, ixy = own[0] + my * com[1] + mz * com[2] + over_legs(xx), over_legs(xy) - mx * com[1]
    iyy, ixz = own[1] + mx * com[0] + mz * com[2] + over_legs(yy), over_legs(xz) - mx * com[2]
    izz, iyz = own[2] + mx * com[0] + my * com[1] + over_legs(zz), over_legs(yz) - my * com[2]
    half = [(dot(row, (ixx, ixy, ixz)), dot(row, (ixy, iyy, iyz)), dot(row, (ixz, iyz, izz))) for row in rotation]
    x, y, z = rotation.to_world(first)
    return [
        [mass],
        [0.0, mass],
        [0.0, 0.0, mass],
        [0.0, -z, y, dot(half[0], rotation.x)],
        [z, 0.0, -x, dot(half[1], rotation.x), dot(half[1], rotation.y)],
        [-y, x, 0.0, dot(half[2], rotation.x), dot(half[2], rotation.y), dot(half[2], rotation.z)],
    ]


def _coupling(design: Design, legs: Legs, momenta: tuple[Momentum, ...], rotation: Rotation) -> Rows:
    """Momentum about the trunk's origin of each joint at unit rate, in the world's axes."""
    rows: Rows = []
    for linear, angular in momenta:
        in_trunk = legs.to_trunk(linear)
        about_origin = add(legs.to_trunk(angular), cross(design.anchor, in_trunk))
        rows.append([*rotation.to_world(in_trunk), *rotation.to_world(about_origin)])
    return rows


def _legs_block(design: Design, legs: Legs, momenta: tuple[Momentum, ...]) -> Rows:
    """Return a leg's block of the mass matrix: what a joint feels of the momentum of the joints below it."""
    knee_x, knee_z = legs.knee
    block: Rows = [
        [momenta[0].angular[0]],
        [momenta[1].angular[0], momenta[1].angular[1]],
        [momenta[2].angular[0], momenta[2].angular[1]],
        [momenta[3].angular[0], momenta[3].angular[1]],
    ]
    for row, (linear, angular) in zip(block[2:], momenta[2:], strict=True):  # about the knee
        row.append(angular[1] - (knee_z * linear[0] - knee_x * linear[2]))
    block[3].append(legs.parts[3].mass)
    for i in range(3):
        block[i][i] = block[i][i] + design.armature
    return block


def _bias(
    design: Design, masses: Masses, legs: Legs, rotation: Rotation, spin: Vector, rates: list[Number]
) -> tuple[list[Number], list[Number]]:
    """The forces that keep every coordinate unaccelerated, world's axes: on the trunk's six, and on each leg's four."""
    upward = scaled(design.gravity, rotation.z)  # gravity is as if all were accelerated upwards
    com, own = masses.trunk_com, masses.trunk_inertia
    trunk_force = scaled(masses.trunk, add(upward, cross(spin, cross(spin, com))))
    trunk_moment = cross(spin, (own[0] * spin[0], own[1] * spin[1], own[2] * spin[2]))
    trunk_moment = add(trunk_moment, cross(com, trunk_force))

    abad, hip, knee, slide = rates
    start = legs.from_trunk(add(upward, cross(spin, cross(spin, design.anchor))))
    turning = legs.from_trunk(spin)
    leg = _Turning((turning[0] + abad, turning[1], turning[2]), (0.0 * abad, turning[2] * abad, -turning[1] * abad))
    thigh, shank = leg.pitched(hip), leg.pitched(hip + knee)

    abad_part, thigh_part, shank_part, toe_part = legs.parts
    side = design.hip
    at_hip = add(start, leg.swing((0.0 * side, side, 0.0 * side)))
    knee_x, knee_z = legs.knee
    at_knee = add(at_hip, thigh.swing((knee_x, 0.0 * knee_x, knee_z)))
    cos, sin = legs.shank
    sliding = scaled(2.0 * slide, cross(shank.rate, (sin, 0.0 * sin, cos)))
    accelerations = (
        add(start, leg.swing(abad_part.com)),
        add(at_hip, thigh.swing((thigh_part.com[0], 0.0 * cos, thigh_part.com[2]))),
        add(at_knee, shank.swing((shank_part.com[0] - knee_x, 0.0 * cos, shank_part.com[2] - knee_z))),
        add(at_knee, shank.swing((toe_part.com[0] - knee_x, 0.0 * cos, toe_part.com[2] - knee_z)), sliding),
    )
    forces = [scaled(part.mass, a) for part, a in zip(legs.parts, accelerations, strict=True)]
    turns = (leg, thigh, shank, shank)
    moments = [turn.moment(part.inertia) for part, turn in zip(legs.parts, turns, strict=True)]

    force = add(*forces)
    moment = add(*moments, *(cross(part.com, f) for part, f in zip(legs.parts, forces, strict=True)))
    below = list(zip(legs.parts, forces, moments, strict=True))
    joints = [
        moment[0],
        sum(_pitch(*body, (0.0, 0.0)) for body in below[1:]),
        sum(_pitch(*body, legs.knee) for body in below[2:]),
        sin * forces[3][0] + cos * forces[3][2],
    ]
    in_trunk = legs.to_trunk(force)
    on_trunk = add(legs.to_trunk(moment), cross(design.anchor, in_trunk))
    total_force = add(trunk_force, (over_legs(in_trunk[0]), over_legs(in_trunk[1]), over_legs(in_trunk[2])))
    total_moment = add(trunk_moment, (over_legs(on_trunk[0]), over_legs(on_trunk[1]), over_legs(on_trunk[2])))
    return [*rotation.to_world(total_force), *rotation.to_world(total_moment)], joints


class _Turning(NamedTuple):
    """How a part of the legs turns while no coordinate accelerates: rad/s and rad/s2, leg's frame."""

    rate: Vector
    change: Vector

    def pitched(self, rate: Number) -> "_Turning":
        """Return the turning of a part that turns about y at this rate in the present frame."""
        (x, y, z), (ax, ay, az) = self
        return _Turning((x, y + rate, z), (ax - z * rate, ay, az + x * rate))

    def swing(self, lever: Vector) -> Vector:
        """The acceleration of a point of the part over that of another, m/s2."""
        return add(cross(self.change, lever), cross(self.rate, cross(self.rate, lever)))

    def moment(self, inertia: Inertia) -> Vector:
        """What this turning needs about the centre of mass, Nm."""
        return add(inertia.times(self.change), cross(self.rate, inertia.times(self.rate)))


def _pitch(part: Part, force: Vector, moment: Vector, about: Plane) -> Number:
    """The moment about y through a point of the plane, Nm."""
    return moment[1] + (part.com[2] - about[1]) * force[0] - (part.com[0] - about[0]) * force[2]
