"""Vectors as tuples of three numbers, each an array over robots, or over legs and
robots."""

import dataclasses
from typing import TYPE_CHECKING, Any, TypeVar, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array

T = TypeVar("T")


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Zero:
    """A number that is known to be 0 when the program is traced: what is multiplied by
    it is not computed.

    XLA cannot leave out a product with a float that is 0, because the other factor
    might be infinite.
    """

    __array_ufunc__ = None  # NumPy's arrays leave the operation to this class

    def __add__(self, other: T) -> T:
        """0 + other."""
        return other

    __radd__ = __rsub__ = __add__

    def __sub__(self, other: Any) -> Any:
        """0 - other."""
        return -other

    def __mul__(self, other: Any) -> "Zero":
        """0 other."""
        return self

    __rmul__ = __mul__

    def __neg__(self) -> "Zero":
        """-0."""
        return self


if TYPE_CHECKING:
    Number = Array | float  # to a type checker a `Zero` is a number like any other
else:
    Number = Array | float | Zero
"""A number, (N,) over robots, (4, N) over legs and robots, or (4, 1) where it is the
same for all robots."""
Vector = tuple[Number, Number, Number]
ZERO: Number = cast(Any, Zero())
NOWHERE: Vector = (ZERO, ZERO, ZERO)


def add(*vectors: Vector) -> Vector:
    """Return the sum of vectors."""
    x, y, z = vectors[0]
    for more in vectors[1:]:
        x, y, z = x + more[0], y + more[1], z + more[2]
    return x, y, z


def scaled(factor: Number, v: Vector) -> Vector:
    """Return a vector v times a factor."""
    return factor * v[0], factor * v[1], factor * v[2]


def dot(a: Vector, b: Vector) -> Number:
    """Return the dot product a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def about_x(v: Vector, cos: Number, sin: Number) -> Vector:
    """Return the vector turned about x by an angle with this cosine and sine."""
    return v[0], cos * v[1] - sin * v[2], sin * v[1] + cos * v[2]


def about_y(v: Vector, cos: Number, sin: Number) -> Vector:
    """Return the vector turned about y by an angle with this cosine and sine."""
    return cos * v[0] + sin * v[2], v[1], cos * v[2] - sin * v[0]


def over_legs(x: Number) -> Number:
    """Return the sum of a number over the legs: (4, N) -> (N,)."""
    return x if isinstance(x, Zero) else jnp.sum(x, axis=0)


def cos_sin(angle: Number) -> tuple[Array, Array]:
    """Return cosine and sine of an angle, to two units in the last place of float32
    below 100 rad.

    XLA's own are libm's, one number after the other: as slow as a third of the whole
    step. These are Cephes's polynomials about the nearest multiple of pi/2, which is
    taken off in three parts (Cody and Waite).
    """
    quarter = jnp.floor(angle * (2.0 / jnp.pi) + 0.5)
    x = (
        (angle - quarter * 1.5703125) - quarter * 4.837512969970703e-4
    ) - quarter * 7.549789948768648e-8
    square = x * x
    sine = x + x * square * (
        -1.6666654611e-1 + square * (8.3321608736e-3 - square * 1.9515295891e-4)
    )
    tail = 4.166664568298827e-2 + square * (
        -1.388731625493765e-3 + square * 2.443315711809948e-5
    )
    cosine = 1.0 - 0.5 * square + square * square * tail
    turns = quarter - 4.0 * jnp.floor(0.25 * quarter)  # 0, 1, 2 or 3
    odd = (turns == 1.0) | (turns == 3.0)
    cos, sin = jnp.where(odd, sine, cosine), jnp.where(odd, cosine, sine)
    return jnp.where((turns == 1.0) | (turns == 2.0), -cos, cos), jnp.where(
        turns >= 2.0, -sin, sin
    )
