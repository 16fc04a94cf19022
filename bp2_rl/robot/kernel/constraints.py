"""The floor under the feet and the joints' stops, and the accelerations that obey them.

MuJoCo's convex cost over accelerations x,

    1/2 x' M x - x' f + sum over rows D/2 min(J x - aref, 0)^2,

is minimised by Newton's method. The cost is quadratic wherever the same rows push, so a full step ends at the minimum
as soon as those of the minimum are known, after one to four of them. No step is searched along its line: what that
would guard against has not been met (`tests/robot/kernel`).

A foot has four rows, the edges of its friction pyramid: normal +- mu x tangent, along the world's axes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from bp2_rl.robot.kernel.design import Design, Softness
from bp2_rl.robot.kernel.equations import Accelerations, Arrow, Rows
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Legs, Rotation
from bp2_rl.robot.kernel.vectors import Number, Vector, add, cross, dot, over_legs, scaled

ITERATIONS = 4
"""Of Newton's method."""


class Floor(NamedTuple):
    """The feet's rows, (4, N)."""

    lever: Vector  # from the trunk's origin to the point of contact, m, world's axes
    joints: tuple[Vector, ...]  # velocity of that point at unit rate of each coordinate of the leg, world's axes
    friction: Number  # (N,)
    stiffness: Number  # D, 0 without contact
    references: tuple[Number, ...]  # aref of the edges to the left, right, back and front

    def edges(self, point: Vector) -> tuple[Number, ...]:
        """A velocity or acceleration of the point along the pyramid's edges."""
        x, y, z = point
        x, y = self.friction * x, self.friction * y
        return z + y, z - y, z - x, z + x

    def point(self, at: Accelerations) -> Vector:
        """Return the acceleration of the point of contact."""
        a, turn = (at.trunk[0], at.trunk[1], at.trunk[2]), (at.trunk[3], at.trunk[4], at.trunk[5])
        return add(a, cross(turn, self.lever), *(scaled(x, v) for x, v in zip(at.legs, self.joints, strict=True)))

    def force(self, edges: tuple[Number, ...]) -> Vector:
        """Return the sum, in the world's axes, of forces along the edges of the friction pyramid."""
        left, right, back, front = edges
        return self.friction * (front - back), self.friction * (left - right), left + right + back + front


class Stops(NamedTuple):
    """The rows of abad, hip and knee: of each the nearer end of its range, (4, N)."""

    signs: tuple[Number, ...]  # 1 at the lower end
    stiffness: tuple[Number, ...]  # D, 0 within the range
    references: tuple[Number, ...]  # aref


class OfRows(NamedTuple):
    """Something of every row, each (4, N): of the feet's edges, and of the stops."""

    edges: tuple[Number, ...]
    stops: tuple[Number, ...]


class Constraints(NamedTuple):
    """All rows."""

    floor: Floor
    stops: Stops

    def gaps(self, at: Accelerations) -> OfRows:
        """J x - aref."""
        edges = self.floor.edges(self.floor.point(at))
        on_floor = tuple(edge - ref for edge, ref in zip(edges, self.floor.references, strict=True))
        stops = zip(self.stops.signs, at.legs[:3], self.stops.references, strict=True)
        return OfRows(on_floor, tuple(sign * x - ref for sign, x, ref in stops))

    def added(self, force: Accelerations, rows: OfRows) -> Accelerations:
        """force + J' f of the rows' forces f."""
        on_foot = self.floor.force(rows.edges)
        on_trunk = *on_foot, *cross(self.floor.lever, on_foot)
        legs = [own + dot(v, on_foot) for own, v in zip(force.legs, self.floor.joints, strict=True)]
        for i, (sign, stop) in enumerate(zip(self.stops.signs, rows.stops, strict=True)):
            legs[i] = legs[i] + sign * stop
        return Accelerations([own + over_legs(x) for own, x in zip(force.trunk, on_trunk, strict=True)], legs)

    def curvature(self, rows: OfRows) -> Arrow:
        """J' diag(D) J of the rows' stiffness D, before the trunk's is summed over the legs."""
        left, right, back, front = rows.edges
        mu = self.floor.friction
        # The stiffness of a contact, a symmetric matrix without xy.
        xx, yy, zz = mu * mu * (back + front), mu * mu * (left + right), left + right + back + front
        xz, yz = mu * (front - back), mu * (left - right)
        rx, ry, rz = self.floor.lever
        # Moments of the forces that a unit of motion along x, y and z meets ...
        along_x = ry * xz, rz * xx - rx * xz, -ry * xx
        along_y = ry * yz - rz * yy, -rx * yz, rx * yy
        along_z = ry * zz - rz * yz, rz * xz - rx * zz, rx * yz - ry * xz
        # ... and a unit of turning: the motion that it makes is (its axis) x lever.
        about_x = [ry * along_z[i] - rz * along_y[i] for i in range(3)]
        about_y = [rz * along_x[i] - rx * along_z[i] for i in range(1, 3)]
        about_z = rx * along_y[2] - ry * along_x[2]
        turn: Rows = [about_x[:1], [about_x[1], about_y[0]], [about_x[2], about_y[1], about_z]]
        trunk: Rows = [[xx], [0.0, yy], [xz, yz, zz]]
        trunk += [[along_x[i], along_y[i], along_z[i], *turn[i]] for i in range(3)]
        met = [
            (xx * v[0] + xz * v[2], yy * v[1] + yz * v[2], xz * v[0] + yz * v[1] + zz * v[2]) for v in self.floor.joints
        ]
        coupling = [[*f, *cross(self.floor.lever, f)] for f in met]
        legs = [[dot(v, f) for v in self.floor.joints[: i + 1]] for i, f in enumerate(met)]
        for i, stop in enumerate(rows.stops):
            legs[i][i] = legs[i][i] + stop
        return Arrow(trunk, coupling, legs)


def solve_constraints(
    barriers: FusionBarriers, inertia: Arrow, force: Accelerations, constraints: Constraints, start: Accelerations
) -> tuple[Accelerations, Accelerations]:
    """The accelerations, and the force that acts in all: the constraints' own added.

    `start` is a first guess of the accelerations, say those of the millisecond before.
    """

    def iterate(_: Array | int, x: Accelerations) -> Accelerations:
        right, stiff = barriers(_pulled, constraints, force, x)
        return solve(barriers, inertia, right, barriers(Constraints.curvature, constraints, stiff))

    x: Accelerations = jax.lax.fori_loop(0, ITERATIONS, iterate, start)
    return x, barriers(_pushed, constraints, force, x)


def solve(barriers: FusionBarriers, matrix: Arrow, right: Accelerations, more: Arrow | None = None) -> Accelerations:
    """x of (matrix + more) x = right, positive definite: Cholesky with the legs first, the trunk last.

    The trunk's part of `more` is yet to be summed over the legs.
    """
    if more is None:
        trunk, coupling, legs = None, matrix.coupling, matrix.legs
    else:
        trunk, coupling, legs = more.trunk, _sum(matrix.coupling, more.coupling), _sum(matrix.legs, more.legs)
    factor = barriers(_cholesky, legs)
    border = barriers(_border, factor, coupling, right.legs)
    schur, rest = barriers(_schur, matrix.trunk, trunk, border, right.trunk)
    x = barriers(_solve_dense, schur, rest)
    return Accelerations(x, barriers(_solve_legs, factor, border, x))


def _pulled(constraints: Constraints, force: Accelerations, x: Accelerations) -> tuple[Accelerations, OfRows]:
    """Newton's right-hand side, f + J' D aref over the rows that push at x; and those rows' D."""
    floor, stops = constraints
    on_floor, on_stops = constraints.gaps(x)
    pushing = OfRows(
        tuple(jnp.where(gap < 0.0, floor.stiffness, 0.0) for gap in on_floor),
        tuple(jnp.where(gap < 0.0, d, 0.0) for gap, d in zip(on_stops, stops.stiffness, strict=True)),
    )
    pull = OfRows(
        tuple(d * ref for d, ref in zip(pushing.edges, floor.references, strict=True)),
        tuple(d * ref for d, ref in zip(pushing.stops, stops.references, strict=True)),
    )
    return constraints.added(force, pull), pushing


def _pushed(constraints: Constraints, force: Accelerations, x: Accelerations) -> Accelerations:
    """f + J' times the rows' forces at x."""
    floor, stops = constraints
    on_floor, on_stops = constraints.gaps(x)
    push = OfRows(
        tuple(-floor.stiffness * jnp.minimum(gap, 0.0) for gap in on_floor),
        tuple(-d * jnp.minimum(gap, 0.0) for gap, d in zip(on_stops, stops.stiffness, strict=True)),
    )
    return constraints.added(force, push)


def constraints_of(
    design: Design,
    legs: Legs,
    rotation: Rotation,
    friction: Number,
    height: Number,
    coordinates: list[Number],
    velocity: Accelerations,
) -> tuple[Constraints, Array]:
    """All rows, and the heights of the feet's centres, m.

    Of a state given by the height of the trunk's origin, the legs' coordinates, and velocities in MuJoCo's coordinates.
    """
    floor, heights = _on_the_floor(design, legs, rotation, height, friction, velocity.in_world(rotation))
    return Constraints(floor, _at_the_stops(design, coordinates[:3], velocity.legs[:3])), heights


def _on_the_floor(
    design: Design,
    legs: Legs,
    rotation: Rotation,
    height: Number,
    friction: Number,
    velocities: Accelerations,
) -> tuple[Floor, Array]:
    """The feet's rows, and the heights of their centres, m; `height` is that of the trunk's origin."""
    anchor = rotation.to_world(design.anchor)
    turned = rotation.to_world(legs.to_trunk((0.0, 1.0, 0.0))), rotation.to_world(legs.to_trunk((0.0, 0.0, 1.0)))
    x_axis, (y_axis, z_axis) = (rotation.x[0], rotation.y[0], rotation.z[0]), turned
    foot = add(anchor, scaled(legs.foot[0], x_axis), scaled(legs.foot[1], y_axis), scaled(legs.foot[2], z_axis))
    centre = jnp.add(height, foot[2])
    depth = centre - design.foot_radius
    lever = foot[0], foot[1], foot[2] - (design.foot_radius + 0.5 * depth)
    reach = add(lever, scaled(-1.0, anchor))
    cos, sin = legs.shank
    knee_x, knee_z = legs.knee
    hip = cross(y_axis, reach)
    joints = (
        cross(x_axis, reach),
        hip,
        add(hip, scaled(knee_x, z_axis), scaled(-knee_z, x_axis)),
        add(scaled(sin, x_axis), scaled(cos, z_axis)),
    )
    weight = design.foot_weight * (1.0 + friction * friction) * 2.0 * friction * friction
    pull, rub, stiffness = _row(design.floor_softness, depth, weight)
    floor = Floor(lever, joints, friction, stiffness, ())
    edges = floor.edges(floor.point(velocities))
    return floor._replace(references=tuple(-rub * edge - pull for edge in edges)), centre


def _at_the_stops(design: Design, angles: list[Number], rates: list[Number]) -> Stops:
    """The rows of joints at these angles (rad) and rates (rad/s): abad, hip and knee."""
    rows: list[tuple[Number, Number, Number]] = []
    for angle, rate, (low, high), weight in zip(angles, rates, design.ranges, design.range_weights, strict=True):
        above, below = angle - low, high - angle
        sign = jnp.where(above < below, 1.0, -1.0)
        pull, rub, stiffness = _row(design.range_softness, jnp.minimum(above, below), weight)
        rows.append((sign, stiffness, -rub * sign * rate - pull))
    signs, stiffness, references = zip(*rows, strict=True)
    return Stops(signs, stiffness, references)


def _row(softness: Softness, distance: Number, weight: Number) -> tuple[Number, float, Number]:
    """(K I r, B, D) of MuJoCo's constraint at this distance; D is 0 where it is positive."""
    x = jnp.abs(distance) / softness.width
    curve = jnp.where(x < 0.5, 2.0 * x * x, 1.0 - 2.0 * (1.0 - x) * (1.0 - x))
    impedance = softness.least + jnp.where(x > 1.0, 1.0, curve) * (softness.most - softness.least)
    stiffness = impedance / (weight * (1.0 - impedance))
    return softness.stiffness * impedance * distance, softness.damping, jnp.where(distance < 0.0, stiffness, 0.0)


# --- Linear algebra over lists of rows --------------------------------------------------------------------------------


def _sum(these: Rows, those: Rows) -> Rows:
    return [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(these, those, strict=True)]


def _border(factor: Rows, coupling: Rows, right: list[Number]) -> Rows:
    """L^-1 times the coupling, and times the legs' right-hand side in the last column."""
    return _forward(factor, [[*row, x] for row, x in zip(coupling, right, strict=True)])


def _schur(own: Rows, more: Rows | None, border: Rows, right: list[Number]) -> tuple[Rows, list[Number]]:
    """The trunk's matrix and right-hand side when the legs are eliminated."""
    less = [[sum(leg[i] * leg[j] for leg in border) for j in range(i + 1)] for i in range(6)]
    if more is not None:
        less = [[a - b for a, b in zip(*rows, strict=True)] for rows in zip(less, more, strict=True)]
    matrix = [[a - over_legs(b) for a, b in zip(*rows, strict=True)] for rows in zip(own, less, strict=True)]
    return matrix, [x - over_legs(sum(leg[i] * leg[6] for leg in border)) for i, x in enumerate(right)]


def _solve_dense(matrix: Rows, right: list[Number]) -> list[Number]:
    factor = _cholesky(matrix)
    return _backward(factor, [x for (x,) in _forward(factor, [[x] for x in right])])


def _solve_legs(factor: Rows, border: Rows, trunk: list[Number]) -> list[Number]:
    rest = [row[6] - sum(a * x for a, x in zip(row[:6], trunk, strict=True)) for row in border]
    return _backward(factor, rest)


def _cholesky(matrix: Rows) -> Rows:
    """The lower factor; its diagonal holds the reciprocals."""
    factor: Rows = []
    for i, entries in enumerate(matrix):
        row: list[Number] = []
        for j in range(i):
            rest = entries[j]
            for k in range(j):
                rest = rest - row[k] * factor[j][k]
            row.append(rest * factor[j][j])
        rest = entries[i]
        for entry in row:
            rest = rest - entry * entry
        row.append(jax.lax.rsqrt(rest))
        factor.append(row)
    return factor


def _forward(factor: Rows, right: Rows) -> Rows:
    """Y of L Y = right, for several right-hand sides."""
    out: Rows = []
    for i, entries in enumerate(right):
        row = list(entries)
        for k in range(i):
            row = [rest - factor[i][k] * y for rest, y in zip(row, out[k], strict=True)]
        out.append([rest * factor[i][i] for rest in row])
    return out


def _backward(factor: Rows, right: list[Number]) -> list[Number]:
    """x of L' x = right."""
    size = len(right)
    out: list[Number] = [0.0] * size
    for i in reversed(range(size)):
        rest = right[i]
        for k in range(i + 1, size):
            rest = rest - factor[k][i] * out[k]
        out[i] = rest * factor[i][i]
    return out
