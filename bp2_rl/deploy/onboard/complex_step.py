"""Rates of functions of NumPy's arrays without JAX: a value's imaginary part carries
its rate through every operation.

    values, rates = differentiate(lambda t: law.stance(command, t), (time,),
    (np.ones_like(time),))

Squire and Trapp, "Using complex variables to estimate derivatives of real functions"
(SIAM Review 40, 1998): the rates are exact to rounding, as no numbers that are alike
are subtracted. Comparisons are by the real part.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

STEP = 1e-50  # s; its square is nothing beside 1


def _atan2(y: Any, x: Any) -> Any:
    """Return the direction of (x, y), rad, and how it turns: arctan2 alone takes no
    complex numbers."""
    a, b = x.real, y.real
    return np.arctan2(b, a) + (y * a - x * b) / (a * a + b * b)


FUNCTIONS = SimpleNamespace(**vars(np) | {"atan2": _atan2})


class _ComplexStep(np.ndarray):
    """An array with its rate."""

    @property
    def __array_priority__(self) -> float:
        """Let an array of this class stay what it is where others are joined to it."""
        return 1.0

    def __array_namespace__(self, *, api_version: str | None = None) -> Any:
        del api_version
        return FUNCTIONS


def differentiate(
    function: Callable[..., tuple[Any, ...]],
    values: tuple[np.ndarray, ...],
    rates: tuple[np.ndarray, ...],
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Return the values of a function of arrays that have these rates, and the values'
    rates, as `jax.jvp` does.

    The function takes its own functions from the `__array_namespace__()` of its
    arguments.
    """
    steps = (
        (value + 1j * STEP * rate).view(_ComplexStep)
        for value, rate in zip(values, rates, strict=True)
    )
    found: list[Any] = [np.asarray(result) for result in function(*steps)]
    return tuple(result.real for result in found), tuple(
        result.imag / STEP for result in found
    )
