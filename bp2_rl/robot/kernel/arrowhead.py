"""Arrowhead matrices, in which each leg is coupled to the trunk alone, and the solution
of equations with them.

A block is a list of rows, a row a list of numbers: each entry is an array over robots,
or over legs and robots.
"""

from typing import NamedTuple

import jax

from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Rotation
from bp2_rl.robot.kernel.vectors import Number, over_legs

Block = list[list[Number]]


class GeneralizedVector(NamedTuple):
    """A generalised velocity, acceleration or force."""

    trunk: list[Number]  # six of (N,)
    legs: list[Number]  # of abad, hip, knee and spring, (4, N) each

    def in_world(self, rotation: Rotation) -> "GeneralizedVector":
        """Return the vector with the trunk's rotation in the world's axes, from
        MuJoCo's, the trunk's own axes."""
        x, y, z, *turn = self.trunk
        return GeneralizedVector(
            [x, y, z, *rotation.to_world((turn[0], turn[1], turn[2]))], self.legs
        )

    def in_mujoco(self, rotation: Rotation) -> "GeneralizedVector":
        """Return the vector with the trunk's rotation in MuJoCo's, the trunk's own
        axes, from the world's axes."""
        x, y, z, *turn = self.trunk
        return GeneralizedVector(
            [x, y, z, *rotation.to_trunk((turn[0], turn[1], turn[2]))], self.legs
        )


class ArrowheadMatrix(NamedTuple):
    """A symmetric matrix, as the lower halves of its blocks, in which legs are coupled
    to the trunk but not to each other."""

    trunk: Block  # 6 x 6, (N,)
    coupling: Block  # leg's coordinate x the trunk's six, (4, N)
    legs: Block  # 4 x 4, (4, N)


def solve(
    barriers: FusionBarriers,
    matrix: ArrowheadMatrix,
    right: GeneralizedVector,
    more: ArrowheadMatrix | None = None,
) -> GeneralizedVector:
    """Solve (matrix + more) x = right, which is positive definite, by Cholesky, legs
    first; return x.

    The trunk's part of `more` is yet to be summed over the legs.
    """
    if more is None:
        trunk, coupling, legs = None, matrix.coupling, matrix.legs
    else:
        trunk = more.trunk
        coupling = _sum(matrix.coupling, more.coupling)
        legs = _sum(matrix.legs, more.legs)
    factor = barriers(_cholesky, legs)
    border = barriers(_border, factor, coupling, right.legs)
    schur, rest = barriers(_schur, matrix.trunk, trunk, border, right.trunk)
    x = barriers(_solve_dense, schur, rest)
    return GeneralizedVector(x, barriers(_solve_legs, factor, border, x))


def _sum(these: Block, those: Block) -> Block:
    return [
        [a + b for a, b in zip(*rows, strict=True)]
        for rows in zip(these, those, strict=True)
    ]


def _border(factor: Block, coupling: Block, right: list[Number]) -> Block:
    """Return L^-1 times the coupling and, in the last column, times the legs'
    right-hand side, for the legs' factor L."""
    return _forward(factor, [[*row, x] for row, x in zip(coupling, right, strict=True)])


def _schur(
    own: Block, more: Block | None, border: Block, right: list[Number]
) -> tuple[Block, list[Number]]:
    """Return the trunk's matrix and right-hand side after the legs are eliminated."""
    less = [
        [sum(leg[i] * leg[j] for leg in border) for j in range(i + 1)] for i in range(6)
    ]
    if more is not None:
        less = [
            [a - b for a, b in zip(*rows, strict=True)]
            for rows in zip(less, more, strict=True)
        ]
    matrix = [
        [a - over_legs(b) for a, b in zip(*rows, strict=True)]
        for rows in zip(own, less, strict=True)
    ]
    return matrix, [
        x - over_legs(sum(leg[i] * leg[6] for leg in border))
        for i, x in enumerate(right)
    ]


def _solve_dense(matrix: Block, right: list[Number]) -> list[Number]:
    factor = _cholesky(matrix)
    return _backward(factor, [x for (x,) in _forward(factor, [[x] for x in right])])


def _solve_legs(factor: Block, border: Block, trunk: list[Number]) -> list[Number]:
    rest = [
        row[6] - sum(a * x for a, x in zip(row[:6], trunk, strict=True))
        for row in border
    ]
    return _backward(factor, rest)


def _cholesky(matrix: Block) -> Block:
    """Return the lower Cholesky factor of a block, with the reciprocals of its
    diagonal."""
    factor: Block = []
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


def _forward(factor: Block, right: Block) -> Block:
    """Solve L Y = right for several right-hand sides, and return Y."""
    out: Block = []
    for i, entries in enumerate(right):
        row = list(entries)
        for k in range(i):
            row = [rest - factor[i][k] * y for rest, y in zip(row, out[k], strict=True)]
        out.append([rest * factor[i][i] for rest in row])
    return out


def _backward(factor: Block, right: list[Number]) -> list[Number]:
    """Solve L' x = right, and return x."""
    size = len(right)
    out: list[Number] = [0.0] * size
    for i in reversed(range(size)):
        rest = right[i]
        for k in range(i + 1, size):
            rest = rest - factor[k][i] * out[k]
        out[i] = rest * factor[i][i]
    return out
