"""Contacts of the feet and limits of the joints, and the accelerations that obey them.

MuJoCo's convex cost over accelerations x,

    1/2 x' M x - x' f + sum over rows D/2 min(J x - aref, 0)^2,

is minimised by Newton's method. The cost is quadratic wherever the same rows push, so a
full step ends at the minimum as soon as the rows that push there are known. A robot has
settled when a step leaves them as they were. Most robots settle in one or two steps,
one in a thousand needs more than four, and robots deep in their joint stops need up to
six. No step is searched along its line: what that would guard against has not been met
(`tests/robot/kernel`).

A foot has four rows, the edges of its friction pyramid: normal +- mu x tangent. On flat
ground they lie along the world's axes, elsewhere along the ground's normal and the
tangents that MuJoCo chooses for it.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from bp2_rl.robot.ground import Plane
from bp2_rl.robot.kernel.arrowhead import (
    ArrowheadMatrix,
    Block,
    GeneralizedVector,
    solve,
)
from bp2_rl.robot.kernel.design import Design, Softness
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import RobotPose
from bp2_rl.robot.kernel.vectors import (
    ZERO,
    Number,
    Vector,
    add,
    cross,
    dot,
    over_legs,
    scaled,
)

STEPS_ON_GPU = 4
"""Newton steps of every robot in a fused GPU kernel: Triton crashes on a loop that ends
when robots have settled."""
MOST_STEPS = 10
"""Newton steps, on a CPU after `COMMON_STEPS`, after which a robot counts as
settled."""
COMMON_STEPS, SHARE = 2, 8
"""Newton steps that all robots take together on a CPU; robots that have not settled
then go on in batches of 1/`SHARE` of all."""


class Floor(NamedTuple):
    """Constraint rows of the feet on the floor, arrays (4, N) over legs and robots."""

    lever: Vector  # from the trunk's origin to the point of contact, m, world's axes
    # velocity of that point at unit rate of each coordinate of the leg, world's axes
    joints: tuple[Vector, ...]
    friction: Number  # (N,)
    stiffness: Number  # D, 0 without contact
    # aref of the edges to the left, right, back and front
    references: tuple[Number, ...]
    # front, left and normal of the ground under each foot; None: the world's axes
    axes: tuple[Vector, Vector, Vector] | None = None

    def edges(self, point: Vector) -> tuple[Number, ...]:
        """Return a velocity or acceleration of the contact points along the edges of
        the friction pyramid."""
        x, y, z = point if self.axes is None else (dot(a, point) for a in self.axes)
        x, y = self.friction * x, self.friction * y
        return z + y, z - y, z - x, z + x

    def point(self, at: GeneralizedVector) -> Vector:
        """Return the velocity or acceleration of the contact points, from the robot's
        generalised vector."""
        a = (at.trunk[0], at.trunk[1], at.trunk[2])
        turn = (at.trunk[3], at.trunk[4], at.trunk[5])
        return add(
            a,
            cross(turn, self.lever),
            *(scaled(x, v) for x, v in zip(at.legs, self.joints, strict=True)),
        )

    def force(self, edges: tuple[Number, ...]) -> Vector:
        """Return the contact forces in the world's axes, from forces along the edges of
        the friction pyramid."""
        left, right, back, front = edges
        force = (
            self.friction * (front - back),
            self.friction * (left - right),
            left + right + back + front,
        )
        return force if self.axes is None else _joined(self.axes, force)

    def stiffnesses(self, edges: tuple[Number, ...]) -> tuple[Number, ...]:
        """Return xx, xy, xz, yy, yz and zz of the contacts' stiffness in the world's
        axes, a symmetric matrix, from the stiffness of the edges."""
        left, right, back, front = edges
        mu = self.friction
        xx = mu * mu * (back + front)
        yy = mu * mu * (left + right)
        zz = left + right + back + front
        xz, yz = mu * (front - back), mu * (left - right)
        if self.axes is None:
            return xx, ZERO, xz, yy, yz, zz
        rows = zip(*self.axes, strict=True)
        x, y, z = (
            _joined(
                self.axes,
                (
                    xx * front + xz * up,
                    yy * left + yz * up,
                    xz * front + yz * left + zz * up,
                ),
            )
            for front, left, up in rows
        )
        return *x, y[1], y[2], z[2]


class Stops(NamedTuple):
    """Constraint rows of the joints' limits, (4, N) for abad, hip and knee: each at the
    nearer end of its range."""

    signs: tuple[Number, ...]  # 1 at the lower end
    stiffness: tuple[Number, ...]  # D, 0 within the range
    references: tuple[Number, ...]  # aref


class RowValues(NamedTuple):
    """A value for every constraint row, each (4, N): for the edges of the feet's
    friction pyramids, and for joint limits."""

    edges: tuple[Number, ...]
    stops: tuple[Number, ...]


class Constraints(NamedTuple):
    """All constraint rows: Jacobian J, stiffness D and reference acceleration aref."""

    floor: Floor
    stops: Stops

    def residuals(self, at: GeneralizedVector) -> RowValues:
        """Return J x - aref of every row at accelerations x; a row pushes where it is
        negative."""
        edges = self.floor.edges(self.floor.point(at))
        on_floor = tuple(
            edge - ref for edge, ref in zip(edges, self.floor.references, strict=True)
        )
        stops = zip(self.stops.signs, at.legs[:3], self.stops.references, strict=True)
        return RowValues(on_floor, tuple(sign * x - ref for sign, x, ref in stops))

    def add_forces(
        self, force: GeneralizedVector, rows: RowValues
    ) -> GeneralizedVector:
        """Return the generalised force + J' f, with forces f along the constraint
        rows."""
        on_foot = self.floor.force(rows.edges)
        on_trunk = *on_foot, *cross(self.floor.lever, on_foot)
        legs = [
            own + dot(v, on_foot)
            for own, v in zip(force.legs, self.floor.joints, strict=True)
        ]
        for i, (sign, stop) in enumerate(
            zip(self.stops.signs, rows.stops, strict=True)
        ):
            legs[i] = legs[i] + sign * stop
        return GeneralizedVector(
            [own + over_legs(x) for own, x in zip(force.trunk, on_trunk, strict=True)],
            legs,
        )

    def curvature(self, rows: RowValues) -> ArrowheadMatrix:
        """Return J' diag(D) J for the rows' stiffness D, before the trunk's block is
        summed over the legs."""
        xx, xy, xz, yy, yz, zz = self.floor.stiffnesses(rows.edges)
        rx, ry, rz = self.floor.lever
        # Moments of the forces that a unit of motion along x, y and z meets ...
        along_x = ry * xz - rz * xy, rz * xx - rx * xz, -ry * xx + rx * xy
        along_y = ry * yz - rz * yy, -rx * yz + rz * xy, rx * yy - ry * xy
        along_z = ry * zz - rz * yz, rz * xz - rx * zz, rx * yz - ry * xz
        # ... and a unit of turning: the motion that it makes is (its axis) x lever.
        about_x = [ry * along_z[i] - rz * along_y[i] for i in range(3)]
        about_y = [rz * along_x[i] - rx * along_z[i] for i in range(1, 3)]
        about_z = rx * along_y[2] - ry * along_x[2]
        turn: Block = [
            about_x[:1],
            [about_x[1], about_y[0]],
            [about_x[2], about_y[1], about_z],
        ]
        trunk: Block = [[xx], [xy, yy], [xz, yz, zz]]
        trunk += [[along_x[i], along_y[i], along_z[i], *turn[i]] for i in range(3)]
        met = [
            (
                xx * v[0] + xy * v[1] + xz * v[2],
                yy * v[1] + xy * v[0] + yz * v[2],
                xz * v[0] + yz * v[1] + zz * v[2],
            )
            for v in self.floor.joints
        ]
        coupling = [[*f, *cross(self.floor.lever, f)] for f in met]
        legs = [
            [dot(v, f) for v in self.floor.joints[: i + 1]] for i, f in enumerate(met)
        ]
        for i, stop in enumerate(rows.stops):
            legs[i][i] = legs[i][i] + stop
        return ArrowheadMatrix(trunk, coupling, legs)


class _Problem(NamedTuple):
    """Inertia, force and constraints of the cost that the solver minimises."""

    inertia: ArrowheadMatrix
    force: GeneralizedVector
    constraints: Constraints


class _Iterate(NamedTuple):
    """State of Newton's method after some steps."""

    steps: Array
    x: GeneralizedVector
    right: GeneralizedVector  # of the next step
    pushing: RowValues  # D of the rows that push at x
    # (4, N), 1 for legs of which other rows push than before the last step, else 0
    changed: Array


def solve_constraints(
    barriers: FusionBarriers,
    inertia: ArrowheadMatrix,
    force: GeneralizedVector,
    constraints: Constraints,
    guess: GeneralizedVector,
) -> GeneralizedVector:
    """Return the accelerations that obey the constraints, by Newton's method from a
    guess, such as the last step's."""
    problem = _Problem(inertia, force, constraints)
    if barriers.always is None:

        def iterate(_: Array | int, x: GeneralizedVector) -> GeneralizedVector:
            right, pushing = barriers(_newton_right_side, constraints, force, x)
            return solve(
                barriers,
                inertia,
                right,
                barriers(Constraints.curvature, constraints, pushing),
            )

        return jax.lax.fori_loop(0, STEPS_ON_GPU, iterate, guess)
    return _settle_the_rest(
        barriers, problem, *_newton(barriers, COMMON_STEPS, problem, guess)
    )


def _newton(
    barriers: FusionBarriers, most: int, problem: _Problem, guess: GeneralizedVector
) -> tuple[GeneralizedVector, Array]:
    """Take Newton steps until all robots have settled, at most `most`; return the
    accelerations and `changed`."""
    inertia, force, constraints = problem

    def unsettled(at: _Iterate) -> Array:
        return (at.steps < most) & (jnp.max(at.changed) > 0.0)

    def step(at: _Iterate) -> _Iterate:
        x = solve(
            barriers,
            inertia,
            at.right,
            barriers(Constraints.curvature, constraints, at.pushing),
        )
        right, pushing = barriers(_newton_right_side, constraints, force, x)
        return _Iterate(
            at.steps + 1, x, right, pushing, barriers(_changed, at.pushing, pushing)
        )

    right, pushing = barriers(_newton_right_side, constraints, force, guess)
    first = _Iterate(
        jnp.int32(0), guess, right, pushing, jnp.ones_like(constraints.floor.stiffness)
    )
    last = jax.lax.while_loop(unsettled, step, first)
    return last.x, last.changed


def _changed(before: RowValues, after: RowValues) -> Array:
    """Return 1 for legs on which other constraint rows push than before, else 0, (4,
    N)."""
    rows = zip(
        (*before.edges, *before.stops), (*after.edges, *after.stops), strict=True
    )
    return jnp.where(
        functools.reduce(jnp.logical_or, (a != b for a, b in rows)), 1.0, 0.0
    )


def _settle_the_rest(
    barriers: FusionBarriers, problem: _Problem, x: GeneralizedVector, changed: Array
) -> GeneralizedVector:
    """Take further Newton steps with the robots that have not settled, in smaller
    batches; return all accelerations."""
    robots = changed.shape[-1]

    def pick(
        which: Array, batch: tuple[_Problem, GeneralizedVector]
    ) -> tuple[_Problem, GeneralizedVector]:
        return jax.tree.map(
            lambda a: a.at[..., which].get(mode="clip") if a.shape[-1] == robots else a,
            batch,
        )

    def settle_some(
        state: tuple[GeneralizedVector, Array],
    ) -> tuple[GeneralizedVector, Array]:
        x, left = state
        # no robot has the last number
        (which,) = jnp.nonzero(left, size=-(-robots // SHARE), fill_value=robots)
        settled, _ = _newton(barriers, MOST_STEPS, *barriers(pick, which, (problem, x)))
        x = jax.tree.map(
            lambda all_, some: all_.at[..., which].set(some, mode="drop"), x, settled
        )
        return x, left.at[which].set(False, mode="drop")

    return jax.lax.while_loop(
        lambda state: jnp.any(state[1]),
        settle_some,
        (x, jnp.any(changed > 0.0, axis=0)),
    )[0]


def _newton_right_side(
    constraints: Constraints, force: GeneralizedVector, x: GeneralizedVector
) -> tuple[GeneralizedVector, RowValues]:
    """Return the right-hand side of a Newton step, f + J' D aref over the rows that
    push at x, and D of these rows."""
    floor, stops = constraints
    on_floor, on_stops = constraints.residuals(x)
    pushing = RowValues(
        tuple(jnp.where(residual < 0.0, floor.stiffness, 0.0) for residual in on_floor),
        tuple(
            jnp.where(residual < 0.0, d, 0.0)
            for residual, d in zip(on_stops, stops.stiffness, strict=True)
        ),
    )
    pull = RowValues(
        tuple(d * ref for d, ref in zip(pushing.edges, floor.references, strict=True)),
        tuple(d * ref for d, ref in zip(pushing.stops, stops.references, strict=True)),
    )
    return constraints.add_forces(force, pull), pushing


def find_constraints(
    design: Design,
    pose: RobotPose,
    friction: Number,
    height: Number,
    coordinates: list[Number],
    velocity: GeneralizedVector,
    ground: Plane | None = None,
) -> tuple[Constraints, Array]:
    """Return all constraint rows in a state, and the distances of the feet's centres
    from the ground, m.

    The state is the pose, the height of the trunk's origin, the legs' coordinates, and
    velocities in MuJoCo's coordinates; `ground` is the plane that each foot meets, None
    for the flat floor.
    """
    floor, heights = _floor_rows(
        design, pose, height, friction, velocity.in_world(pose.rotation), ground
    )
    return Constraints(
        floor, _stop_rows(design, coordinates[:3], velocity.legs[:3])
    ), heights


def _floor_rows(
    design: Design,
    pose: RobotPose,
    height: Number,
    friction: Number,
    velocities: GeneralizedVector,
    ground: Plane | None,
) -> tuple[Floor, Array]:
    """Return the feet's constraint rows and the distances of their centres from the
    ground, m; `height` is the trunk origin's, m."""
    rotation, legs = pose
    anchor = rotation.to_world(design.anchor)
    x_axis = rotation.x[0], rotation.y[0], rotation.z[0]
    y_axis, z_axis = (
        rotation.to_world(legs.to_trunk(axis))
        for axis in ((ZERO, 1.0, ZERO), (ZERO, ZERO, 1.0))
    )

    in_world = functools.partial(_joined, (x_axis, y_axis, z_axis))
    foot = add(anchor, in_world(legs.foot))
    centre = jnp.add(height, foot[2])
    axes = None if ground is None else contact_axes(ground)
    if ground is not None and axes is not None:
        centre = (centre - ground.height) * axes[2][2]
    depth = centre - design.foot_radius
    sunk = design.foot_radius + 0.5 * depth
    x, y, z = (ZERO, ZERO, sunk) if axes is None else scaled(sunk, axes[2])
    lever = foot[0] - x, foot[1] - y, foot[2] - z
    reach = add(lever, scaled(-1.0, anchor))
    turned = cross(y_axis, reach)
    pitches = (
        add(turned, scaled(x, z_axis), scaled(-z, x_axis))
        for x, _, z in (legs.hip, legs.knee)
    )
    slides = (in_world(legs.compressed) for _ in legs.bodies[3:])
    joints = (cross(x_axis, reach), *pitches, *slides)
    weight = (
        design.foot_weight * (1.0 + friction * friction) * 2.0 * friction * friction
    )
    spring, damping, stiffness = _reference_and_stiffness(
        design.floor_softness, depth, weight
    )
    floor = Floor(lever, joints, friction, stiffness, (), axes)
    edges = floor.edges(floor.point(velocities))
    return floor._replace(
        references=tuple(-damping * edge - spring for edge in edges)
    ), centre


def _joined(axes: tuple[Vector, Vector, Vector], v: Vector) -> Vector:
    """Return the vector with these parts along three axes, in the axes' own frame."""
    return add(*(scaled(part, axis) for part, axis in zip(v, axes, strict=True)))


def contact_axes(ground: Plane) -> tuple[Vector, Vector, Vector]:
    """Return front, left and normal of a contact with the ground, unit vectors in the
    world's axes.

    The tangents are those of MuJoCo (`mju_makeFrame`): left is as near to y as it can
    be, or to z where the normal is nearer to y than 60 deg.
    """
    size = 1.0 / jnp.sqrt(1.0 + ground.slope_x**2 + ground.slope_y**2)
    normal = -size * ground.slope_x, -size * ground.slope_y, size
    steep = jnp.abs(normal[1]) >= 0.5
    start = ZERO, jnp.where(steep, 0.0, 1.0), jnp.where(steep, 1.0, 0.0)
    across = add(start, scaled(-dot(start, normal), normal))
    left = scaled(1.0 / jnp.sqrt(dot(across, across)), across)
    return cross(left, normal), left, normal


def _stop_rows(design: Design, angles: list[Number], rates: list[Number]) -> Stops:
    """Return the constraint rows of the limits of abad, hip and knee at these angles
    (rad) and rates (rad/s)."""
    rows: list[tuple[Number, Number, Number]] = []
    for angle, rate, (low, high), weight in zip(
        angles, rates, design.ranges, design.range_weights, strict=True
    ):
        above, below = angle - low, high - angle
        sign = jnp.where(above < below, 1.0, -1.0)
        spring, damping, stiffness = _reference_and_stiffness(
            design.range_softness, jnp.minimum(above, below), weight
        )
        rows.append((sign, stiffness, -damping * sign * rate - spring))
    signs, stiffness, references = zip(*rows, strict=True)
    return Stops(signs, stiffness, references)


def _reference_and_stiffness(
    softness: Softness, distance: Number, weight: Number
) -> tuple[Number, Number, Number]:
    """Return (K I r, B, D) of MuJoCo's constraint at the distance r; D is 0 where r is
    positive."""
    x = jnp.abs(distance) / softness.width
    curve = jnp.where(x < 0.5, 2.0 * x * x, 1.0 - 2.0 * (1.0 - x) * (1.0 - x))
    impedance = softness.least + jnp.where(x > 1.0, 1.0, curve) * (
        softness.most - softness.least
    )
    stiffness = impedance / (weight * (1.0 - impedance))
    return (
        softness.stiffness * impedance * distance,
        softness.damping,
        jnp.where(distance < 0.0, stiffness, 0.0),
    )
