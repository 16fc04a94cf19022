"""Lines, parabolas and cubics between given points: arithmetic alone, for numbers of NumPy, JAX and CasADi alike.

`s` is the share of an interval that has gone by, from 0 to 1; `left` and `right` are values at its ends, `middle` the
one halfway, `out` and `into` the rates at the ends, and `h` the interval's length.

Hermite's cubic is evaluated in three ways that differ in the last bit. Each stays as it is, because solved trajectories
and trained policies repeat to the last bit only if it does: `hermite` is the optimiser's and the reader's of its
solutions, `hermite_and_rate` a swing foot's in the gait, `hermite_coefficients` the table's that a gait looks up.
"""

from typing import Any

Value = Any  # a number, or an array of NumPy, JAX or CasADi


def line(s: Value, left: Value, right: Value) -> Value:
    """The straight line between two points."""
    return left + s * (right - left)


def parabola(s: Value, left: Value, middle: Value, right: Value) -> Value:
    """Lagrange's polynomial through three points."""
    return left * (1 - s) * (1 - 2 * s) + middle * 4 * s * (1 - s) + right * s * (2 * s - 1)


def hermite(s: Value, h: Value, left: Value, right: Value, out: Value, into: Value) -> Value:
    """Hermite's cubic through two values and their rates."""
    return (
        left * (1 + 2 * s) * (1 - s) ** 2
        + right * s**2 * (3 - 2 * s)
        + h * (out * s * (1 - s) ** 2 - into * s**2 * (1 - s))
    )


def hermite_and_rate(s: Value, h: Value, left: Value, right: Value, out: Value, into: Value) -> tuple[Value, Value]:
    """Return the value and the rate of Hermite's cubic."""
    out, into, r = h * out, h * into, 1.0 - s
    value = left * r**2 * (1.0 + 2.0 * s) + right * s**2 * (3.0 - 2.0 * s) + out * s * r**2 - into * s**2 * r
    slope = 6.0 * s * r * (right - left) + out * r * (1.0 - 3.0 * s) - into * s * (2.0 - 3.0 * s)
    return value, slope / h


def hermite_coefficients(
    h: Value, left: Value, right: Value, out: Value, into: Value
) -> tuple[Value, Value, Value, Value]:
    """Return the coefficients of 1, s, s^2 and s^3 of Hermite's cubic."""
    out, into = h * out, h * into
    return left, out, 3.0 * (right - left) - 2.0 * out - into, 2.0 * (left - right) + out + into


def cubic_and_slope(s: Value, c: tuple[Value, Value, Value, Value]) -> tuple[Value, Value]:
    """A cubic by its coefficients, and its derivative by s."""
    value = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    return value, c[1] + s * (2.0 * c[2] + s * 3.0 * c[3])
