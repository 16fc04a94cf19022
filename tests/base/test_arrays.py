"""Interpolating polynomials against SciPy's, for every array library that brings the
numbers."""

import casadi as ca
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, lagrange

from bp2_rl.base import arrays

H, LEFT, RIGHT, OUT, INTO = 0.3, 1.2, -0.7, 4.0, -9.0
S = np.linspace(0.0, 1.0, 11)
CUBIC = CubicHermiteSpline([0.0, H], [LEFT, RIGHT], [OUT, INTO])
ENDS = (H, LEFT, RIGHT, OUT, INTO)


def test_both_forms_of_hermites_cubic_are_scipys():
    expected = CUBIC(H * S)
    value, rate = arrays.hermite_and_rate(S, *ENDS)
    np.testing.assert_allclose(value, expected, atol=1e-14)
    np.testing.assert_allclose(rate, CUBIC(H * S, 1), atol=1e-13)
    value, slope = arrays.cubic_and_slope(S, arrays.hermite_coefficients(*ENDS))
    np.testing.assert_allclose(value, expected, atol=1e-14)
    np.testing.assert_allclose(slope / H, CUBIC(H * S, 1), atol=1e-13)


def test_the_parabola_is_lagranges_and_the_line_straight():
    expected = lagrange([0.0, 0.5, 1.0], [LEFT, 3.0, RIGHT])(S)
    np.testing.assert_allclose(
        arrays.parabola(S, LEFT, 3.0, RIGHT), expected, atol=1e-14
    )
    np.testing.assert_allclose(
        arrays.line(S, LEFT, RIGHT),
        np.interp(S, [0.0, 1.0], [LEFT, RIGHT]),
        atol=1e-15,
    )


@pytest.mark.parametrize("numbers", [jnp.asarray, ca.DM])
def test_other_array_libraries_get_the_same(numbers):
    s = numbers(S)
    tolerance = 1e-5 if numbers is jnp.asarray else 1e-14  # JAX's single precision
    for ours, theirs in (
        (
            arrays.hermite_and_rate(s, *ENDS)[0],
            arrays.hermite_and_rate(S, *ENDS)[0],
        ),
        (
            arrays.parabola(s, LEFT, 3.0, RIGHT),
            arrays.parabola(S, LEFT, 3.0, RIGHT),
        ),
        (
            arrays.hermite_and_rate(s, *ENDS)[1],
            arrays.hermite_and_rate(S, *ENDS)[1],
        ),
    ):
        np.testing.assert_allclose(np.asarray(ours).ravel(), theirs, atol=tolerance)
