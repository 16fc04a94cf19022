"""Arithmetic that NumPy, JAX and CasADi share: types of its numbers, and polynomials.

In the polynomials `s` is the share of an interval that has gone by, from 0 to 1; `left`
and `right` are values at its ends, `middle` the one halfway, `out` and `into` the rates
at the ends, and `h` the interval's length.
"""

from typing import Any, TypeAlias, TypeVar

Number: TypeAlias = Any
"""A float, an array of NumPy or JAX, or an expression of CasADi; no type checker knows
what they have in common."""
Array: TypeAlias = Any
"""An array of NumPy or JAX, whose functions are in `__array_namespace__()`."""
ArrayT = TypeVar("ArrayT", bound=Array)
"""Type variable of functions that return an array of the library whose array they
take."""


def line(s: Number, left: Number, right: Number) -> Number:
    """Interpolate linearly between `left` and `right`, at the share `s` of an
    interval."""
    return left + s * (right - left)


def parabola(s: Number, left: Number, middle: Number, right: Number) -> Number:
    """Interpolate by the parabola through `left`, `middle` and `right`, at the share
    `s` of an interval."""
    return (
        left * (1 - s) * (1 - 2 * s)
        + middle * 4 * s * (1 - s)
        + right * s * (2 * s - 1)
    )


def hermite_and_rate(
    s: Number, h: Number, left: Number, right: Number, out: Number, into: Number
) -> tuple[Number, Number]:
    """Return (value, rate) of Hermite's cubic through two values and their rates, at
    the share `s` of an interval."""
    out, into, r = h * out, h * into, 1.0 - s
    value = (
        left * r**2 * (1.0 + 2.0 * s)
        + right * s**2 * (3.0 - 2.0 * s)
        + out * s * r**2
        - into * s**2 * r
    )
    slope = (
        6.0 * s * r * (right - left)
        + out * r * (1.0 - 3.0 * s)
        - into * s * (2.0 - 3.0 * s)
    )
    return value, slope / h


def hermite_coefficients(
    h: Number, left: Number, right: Number, out: Number, into: Number
) -> tuple[Number, Number, Number, Number]:
    """Return the coefficients of 1, s, s^2 and s^3 of Hermite's cubic through two
    values and their rates."""
    out, into = h * out, h * into
    return (
        left,
        out,
        3.0 * (right - left) - 2.0 * out - into,
        2.0 * (left - right) + out + into,
    )


def cubic_and_slope(
    s: Number, c: tuple[Number, Number, Number, Number]
) -> tuple[Number, Number]:
    """Return a cubic's value and its derivative by s, from the coefficients of 1, s,
    s^2 and s^3."""
    value = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    return value, c[1] + s * (2.0 * c[2] + s * 3.0 * c[3])
