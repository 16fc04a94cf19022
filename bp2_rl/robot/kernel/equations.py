"""The equations of motion: the inertia matrix, an arrowhead matrix, and the bias of velocities and gravity.

The unknowns are the acceleration of the trunk's origin, the trunk's angular acceleration, both in the world's axes, and
those of the legs' coordinates. Legs are coupled through the trunk alone, which makes the matrix an arrowhead.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp

from bp2_rl.robot.kernel.arrowhead import ArrowheadMatrix, Block, GeneralizedVector
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Composite, Inertia, Legs, Momentum, Part, PlanePoint, RobotPose, Rotation
from bp2_rl.robot.kernel.vectors import Number, Vector, add, cross, dot, over_legs, scaled


def inertia_matrix(barriers: FusionBarriers, robots: Robots, pose: RobotPose) -> ArrowheadMatrix:
    """The inertia matrix, kg, kg m and kg m2."""
    (design, masses, _), (rotation, legs) = robots, pose
    whole = barriers(Composite.of, legs)
    momenta = barriers(Legs.momenta, legs, whole)
    return ArrowheadMatrix(
        trunk=barriers(partial(_trunk_block, design), masses, legs, whole, rotation),
        coupling=barriers(partial(_coupling, design), legs, momenta, rotation),
        legs=barriers(partial(_legs_block, design), legs, momenta),
    )


def smooth_force(
    design: Design,
    masses: Masses,
    pose: RobotPose,
    compression: Number,
    velocity: GeneralizedVector,
    applied: GeneralizedVector,
) -> GeneralizedVector:
    """All forces but the constraints': applied ones, springs, gravity and what velocities cost, N and Nm.

    The springs' compression in m; velocities and applied forces in MuJoCo's coordinates.
    """
    _, _, _, *spin = velocity.trunk
    trunk, joints = _bias(design, masses, pose, (spin[0], spin[1], spin[2]), velocity.legs)
    stiffness, damping = design.spring
    spring = -stiffness * compression - damping * velocity.legs[3]
    for stop, least, most in design.stops:
        spring = spring - stop * (compression - jnp.clip(compression, least, most))
    outside = applied.in_world(pose.rotation)
    free = [force - bias for force, bias in zip(outside.legs, joints, strict=True)]
    free[3] = free[3] + spring
    return GeneralizedVector([force - bias for force, bias in zip(outside.trunk, trunk, strict=True)], free)


def _trunk_block(design: Design, masses: Masses, legs: Legs, whole: Composite, rotation: Rotation) -> Block:
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


def _coupling(design: Design, legs: Legs, momenta: tuple[Momentum, ...], rotation: Rotation) -> Block:
    """Momentum about the trunk's origin of each joint at unit rate, in the world's axes."""
    rows: Block = []
    for linear, angular in momenta:
        in_trunk = legs.to_trunk(linear)
        about_origin = add(legs.to_trunk(angular), cross(design.anchor, in_trunk))
        rows.append([*rotation.to_world(in_trunk), *rotation.to_world(about_origin)])
    return rows


def _legs_block(design: Design, legs: Legs, momenta: tuple[Momentum, ...]) -> Block:
    """Return a leg's block of the mass matrix: what a joint feels of the momentum of the joints below it."""
    knee_x, knee_z = legs.knee
    block: Block = [
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
    design: Design, masses: Masses, pose: RobotPose, spin: Vector, rates: list[Number]
) -> tuple[list[Number], list[Number]]:
    """The forces that keep every coordinate unaccelerated, world's axes: on the trunk's six, and on each leg's four."""
    rotation, legs = pose
    upward = scaled(design.gravity, rotation.z)  # gravity is as if all were accelerated upwards
    com, own = masses.trunk_com, masses.trunk_inertia
    trunk_force = scaled(masses.trunk, add(upward, cross(spin, cross(spin, com))))
    trunk_moment = cross(spin, (own[0] * spin[0], own[1] * spin[1], own[2] * spin[2]))
    trunk_moment = add(trunk_moment, cross(com, trunk_force))

    abad, hip, knee, slide = rates
    start = legs.from_trunk(add(upward, cross(spin, cross(spin, design.anchor))))
    turning = legs.from_trunk(spin)
    leg = _AngularMotion(
        (turning[0] + abad, turning[1], turning[2]), (0.0 * abad, turning[2] * abad, -turning[1] * abad)
    )
    thigh, shank = leg.pitched(hip), leg.pitched(hip + knee)

    abad_part, thigh_part, shank_part, toe_part = legs.parts
    side = design.hip
    at_hip = add(start, leg.relative_acceleration((0.0 * side, side, 0.0 * side)))
    knee_x, knee_z = legs.knee
    at_knee = add(at_hip, thigh.relative_acceleration((knee_x, 0.0 * knee_x, knee_z)))
    cos, sin = legs.shank
    sliding = scaled(2.0 * slide, cross(shank.velocity, (sin, 0.0 * sin, cos)))
    accelerations = (
        add(start, leg.relative_acceleration(abad_part.com)),
        add(at_hip, thigh.relative_acceleration((thigh_part.com[0], 0.0 * cos, thigh_part.com[2]))),
        add(at_knee, shank.relative_acceleration((shank_part.com[0] - knee_x, 0.0 * cos, shank_part.com[2] - knee_z))),
        add(
            at_knee,
            shank.relative_acceleration((toe_part.com[0] - knee_x, 0.0 * cos, toe_part.com[2] - knee_z)),
            sliding,
        ),
    )
    forces = [scaled(part.mass, a) for part, a in zip(legs.parts, accelerations, strict=True)]
    turns = (leg, thigh, shank, shank)
    moments = [turn.torque(part.inertia) for part, turn in zip(legs.parts, turns, strict=True)]

    force = add(*forces)
    moment = add(*moments, *(cross(part.com, f) for part, f in zip(legs.parts, forces, strict=True)))
    below = list(zip(legs.parts, forces, moments, strict=True))
    joints = [
        moment[0],
        sum(_pitch_moment(*body, (0.0, 0.0)) for body in below[1:]),
        sum(_pitch_moment(*body, legs.knee) for body in below[2:]),
        sin * forces[3][0] + cos * forces[3][2],
    ]
    in_trunk = legs.to_trunk(force)
    on_trunk = add(legs.to_trunk(moment), cross(design.anchor, in_trunk))
    total_force = add(trunk_force, (over_legs(in_trunk[0]), over_legs(in_trunk[1]), over_legs(in_trunk[2])))
    total_moment = add(trunk_moment, (over_legs(on_trunk[0]), over_legs(on_trunk[1]), over_legs(on_trunk[2])))
    return [*rotation.to_world(total_force), *rotation.to_world(total_moment)], joints


class _AngularMotion(NamedTuple):
    """Angular velocity (rad/s) and acceleration (rad/s2) of a part of the legs while no coordinate accelerates.

    Vectors are in the leg's frame.
    """

    velocity: Vector
    acceleration: Vector

    def pitched(self, rate: Number) -> "_AngularMotion":
        """Return the motion of a part that turns about y at this rate relative to this one."""
        (x, y, z), (ax, ay, az) = self
        return _AngularMotion((x, y + rate, z), (ax - z * rate, ay, az + x * rate))

    def relative_acceleration(self, lever: Vector) -> Vector:
        """The acceleration of a point of the part relative to the point at the lever's other end, m/s2."""
        return add(cross(self.acceleration, lever), cross(self.velocity, cross(self.velocity, lever)))

    def torque(self, inertia: Inertia) -> Vector:
        """The torque about the centre of mass that this motion needs, Nm."""
        return add(inertia.times(self.acceleration), cross(self.velocity, inertia.times(self.velocity)))


def _pitch_moment(part: Part, force: Vector, moment: Vector, about: PlanePoint) -> Number:
    """The moment about y through a point of the plane, Nm."""
    return moment[1] + (part.com[2] - about[1]) * force[0] - (part.com[0] - about[0]) * force[2]
