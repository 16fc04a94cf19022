"""The equations of motion: the inertia matrix, an arrowhead matrix, and the bias of
velocities and gravity.

The unknowns are the acceleration of the trunk's origin, the trunk's angular
acceleration, both in the world's axes, and those of the legs' coordinates. Legs are
coupled through the trunk alone, which makes the matrix an arrowhead.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from bp2_rl.robot.kernel.arrowhead import ArrowheadMatrix, Block, GeneralizedVector
from bp2_rl.robot.kernel.bodies import Body, Composite
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Legs, Momentum, RobotPose, Rotation
from bp2_rl.robot.kernel.vectors import (
    NOWHERE,
    ZERO,
    Number,
    Vector,
    add,
    cross,
    dot,
    over_legs,
    scaled,
)


def inertia_matrix(
    barriers: FusionBarriers, robots: Robots, pose: RobotPose
) -> ArrowheadMatrix:
    """Return the mass matrix of the robots, kg, kg m and kg m2."""
    (design, masses, _), (rotation, legs) = robots, pose
    moved = barriers(Legs.composites, legs)
    momenta = barriers(Legs.momenta, legs, moved)
    return ArrowheadMatrix(
        trunk=barriers(
            partial(_trunk_block, design), masses.trunk, legs, moved[0], rotation
        ),
        coupling=barriers(partial(_coupling, design), legs, momenta, rotation),
        legs=barriers(partial(_legs_block, design), legs, momenta),
    )


def smooth_force(
    design: Design,
    masses: Masses,
    pose: RobotPose,
    coordinates: list[Number],
    velocity: GeneralizedVector,
    applied: GeneralizedVector,
) -> GeneralizedVector:
    """Return all forces but the constraints', N and Nm: applied forces, springs,
    damping, gravity, centrifugal and Coriolis forces.

    The legs' coordinates in rad and m; velocities and applied forces in MuJoCo's
    coordinates.
    """
    _, _, _, *spin = velocity.trunk
    trunk, joints = _bias(
        design, masses, pose, (spin[0], spin[1], spin[2]), velocity.legs
    )
    outside = applied.in_world(pose.rotation)
    free = [
        force - bias - damping * rate
        for force, bias, damping, rate in zip(
            outside.legs, joints, design.damping, velocity.legs, strict=True
        )
    ]
    for compression in coordinates[3:]:
        free[3] = free[3] - design.stiffness * compression
        for stop, least, most in design.stops:
            free[3] = free[3] - stop * (
                compression - jnp.clip(compression, least, most)
            )
    return GeneralizedVector(
        [force - bias for force, bias in zip(outside.trunk, trunk, strict=True)], free
    )


def _trunk_block(
    design: Design, trunk: Body, legs: Legs, leg: Composite, rotation: Rotation
) -> Block:
    """Return the trunk's block of the mass matrix: all bodies as one, about the trunk's
    origin, in the world's axes."""
    all_legs = jax.tree.map(
        over_legs, leg.about_x(legs.cos, legs.sin).moved(design.anchor)
    )
    mass, moment, inertia = Composite.of(trunk).plus(all_legs)
    half = [inertia.times(row) for row in rotation]
    x, y, z = rotation.to_world(moment)
    return [
        [mass],
        [ZERO, mass],
        [ZERO, ZERO, mass],
        [ZERO, -z, y, dot(half[0], rotation.x)],
        [z, ZERO, -x, dot(half[1], rotation.x), dot(half[1], rotation.y)],
        [
            -y,
            x,
            ZERO,
            dot(half[2], rotation.x),
            dot(half[2], rotation.y),
            dot(half[2], rotation.z),
        ],
    ]


def _coupling(
    design: Design, legs: Legs, momenta: tuple[Momentum, ...], rotation: Rotation
) -> Block:
    """Return the coupling block of the mass matrix: each joint's momentum at unit rate,
    about the trunk's origin in the world's axes."""
    rows: Block = []
    for linear, angular in momenta:
        in_trunk = legs.to_trunk(linear)
        about_origin = add(legs.to_trunk(angular), cross(design.anchor, in_trunk))
        rows.append([*rotation.to_world(in_trunk), *rotation.to_world(about_origin)])
    return rows


def _legs_block(design: Design, legs: Legs, momenta: tuple[Momentum, ...]) -> Block:
    """Return a leg's block of the mass matrix: what a joint feels of the momentum of
    the joints below it."""
    block: Block = []
    for i, (linear, angular) in enumerate(momenta):
        pitches = [
            angular[1] - (z * linear[0] - x * linear[2])
            for x, _, z in (legs.hip, legs.knee)
        ]
        slides = [body.mass for body in legs.bodies[3:]]
        block.append([angular[0], *pitches, *slides][: i + 1])
        block[i][i] = block[i][i] + design.armature[i]
    return block


def _bias(
    design: Design, masses: Masses, pose: RobotPose, spin: Vector, rates: list[Number]
) -> tuple[list[Number], list[Number]]:
    """Return the forces that keep all coordinates unaccelerated: on the trunk (6,
    world's axes), and on each leg's coordinates."""
    rotation, legs = pose
    # gravity is as if all were accelerated upwards
    upward = rotation.to_trunk(scaled(-1.0, design.gravity))
    trunk = _wrench(masses.trunk, _AngularMotion(spin, NOWHERE), upward)

    abad, hip, knee, *slide = rates
    x, y, z = legs.from_trunk(spin)
    leg = _AngularMotion((x + abad, y, z), (ZERO, z * abad, -y * abad))
    thigh, shank = leg.pitched(hip), leg.pitched(hip + knee)
    at_anchor = legs.from_trunk(add(upward, cross(spin, cross(spin, design.anchor))))
    at_hip = add(at_anchor, leg.relative_acceleration(legs.hip))
    at_knee = add(at_hip, thigh.relative_acceleration(legs.thigh))

    # From the foot upwards, what each joint bears: force, and torque about it.
    force, torque = _wrench(legs.bodies[2], shank, at_knee)
    joints: list[Number] = []
    for toe, rate in zip(legs.bodies[3:], slide, strict=True):
        sliding = scaled(2.0 * rate, cross(shank.velocity, legs.compressed))
        more, turn = _wrench(toe, shank, add(at_knee, sliding))
        force, torque = add(force, more), add(torque, turn)
        joints = [dot(legs.compressed, more)]
    joints = [torque[1], *joints]
    more, turn = _wrench(legs.bodies[1], thigh, at_hip)
    force, torque = add(more, force), add(turn, torque, cross(legs.thigh, force))
    joints = [torque[1], *joints]
    more, turn = _wrench(legs.bodies[0], leg, at_anchor)
    force, torque = add(more, force), add(turn, torque, cross(legs.hip, force))
    joints = [torque[0], *joints]

    in_trunk = legs.to_trunk(force)
    on_trunk = add(legs.to_trunk(torque), cross(design.anchor, in_trunk))
    total_force, total_torque = (
        add(own, (over_legs(x), over_legs(y), over_legs(z)))
        for own, (x, y, z) in zip(trunk, (in_trunk, on_trunk), strict=True)
    )
    return [*rotation.to_world(total_force), *rotation.to_world(total_torque)], joints


class _AngularMotion(NamedTuple):
    """Angular velocity (rad/s) and acceleration (rad/s2) of a part of the legs while no
    coordinate accelerates.

    Vectors are in the leg's frame.
    """

    velocity: Vector
    acceleration: Vector

    def pitched(self, rate: Number) -> "_AngularMotion":
        """Return the motion of a part that turns about y at this rate relative to the
        part with this motion."""
        (x, y, z), (ax, ay, az) = self
        return _AngularMotion((x, y + rate, z), (ax - z * rate, ay, az + x * rate))

    def relative_acceleration(self, lever: Vector) -> Vector:
        """Return the acceleration of a point of the part, m/s2, relative to the point
        at the lever's other end."""
        return add(
            cross(self.acceleration, lever),
            cross(self.velocity, cross(self.velocity, lever)),
        )


def _wrench(
    body: Body, motion: _AngularMotion, acceleration: Vector
) -> tuple[Vector, Vector]:
    """Return the force and torque that a body's motion needs, at an acceleration of the
    point that its centre of mass is measured from.

    Force, N, and torque about that point, Nm.
    """
    spin, turning = motion
    force = scaled(body.mass, add(acceleration, motion.relative_acceleration(body.com)))
    own = add(body.inertia.times(turning), cross(spin, body.inertia.times(spin)))
    return force, add(own, cross(body.com, force))
