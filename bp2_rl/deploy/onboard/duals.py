"""Arrays of NumPy with their rates, which follow through every operation: forward differentiation without JAX.

    values, rates = differentiate(lambda t: law.stance(command, t), time)

A law that takes the functions of its arrays from `__array_namespace__()` runs on a `Dual` as it does on an array.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


class Dual:
    """An array and its rate, of one shape."""

    __array_ufunc__ = None  # an array beside it leaves the operation to it

    def __init__(self, value: np.ndarray, rate: np.ndarray):
        self.value, self.rate = value, rate

    @property
    def dtype(self) -> Any:
        """Return the type of the numbers."""
        return self.value.dtype

    def __array_namespace__(self) -> Any:
        """Return the functions that take and return duals."""
        return DualFunctions

    def __getitem__(self, key: Any) -> "Dual":
        """Return a part of both."""
        return Dual(self.value[key], self.rate[key])

    def __neg__(self) -> "Dual":  # noqa: D105
        return Dual(-self.value, -self.rate)

    def __add__(self, other: Any) -> "Dual":  # noqa: D105
        value, rate = _parts(other)
        return Dual(self.value + value, self.rate + rate)

    def __sub__(self, other: Any) -> "Dual":  # noqa: D105
        value, rate = _parts(other)
        return Dual(self.value - value, self.rate - rate)

    def __mul__(self, other: Any) -> "Dual":  # noqa: D105
        value, rate = _parts(other)
        return Dual(self.value * value, self.rate * value + self.value * rate)

    def __truediv__(self, other: Any) -> "Dual":  # noqa: D105
        value, rate = _parts(other)
        share = self.value / value
        return Dual(share, (self.rate - share * rate) / value)

    def __pow__(self, power: float) -> "Dual":  # noqa: D105
        return Dual(self.value**power, power * self.value ** (power - 1) * self.rate)

    def __rsub__(self, other: Any) -> "Dual":  # noqa: D105
        return -self + other

    def __rtruediv__(self, other: Any) -> "Dual":  # noqa: D105
        return Dual(*_parts(other)) / self

    __radd__, __rmul__ = __add__, __mul__

    def __lt__(self, other: Any) -> Any:  # noqa: D105
        return self.value < _parts(other)[0]


class DualFunctions:
    """Functions of NumPy on duals; constants stay arrays, whose rate is zero."""

    asarray = staticmethod(np.asarray)

    @staticmethod
    def sqrt(x: Dual) -> Dual:
        """Square root."""
        root = np.sqrt(x.value)
        return Dual(root, 0.5 * x.rate / root)

    @staticmethod
    def cos(x: Dual) -> Dual:
        """Cosine."""
        return Dual(np.cos(x.value), -np.sin(x.value) * x.rate)

    @staticmethod
    def sin(x: Dual) -> Dual:
        """Sine."""
        return Dual(np.sin(x.value), np.cos(x.value) * x.rate)

    @staticmethod
    def atan2(y: Dual, x: Dual) -> Dual:
        """Return the direction of (x, y), rad, and how it turns."""
        turns = (y.rate * x.value - y.value * x.rate) / (x.value**2 + y.value**2)
        return Dual(np.arctan2(y.value, x.value), turns)

    @staticmethod
    def maximum(x: Dual, least: float) -> Dual:
        """Return the greater of a dual and a constant."""
        return Dual(np.maximum(x.value, least), np.where(x.value > least, x.rate, 0.0))

    @staticmethod
    def clip(x: Dual, least: float, most: float) -> Dual:
        """Return a dual between two constants."""
        inside = (x.value > least) & (x.value < most)
        return Dual(np.clip(x.value, least, most), np.where(inside, x.rate, 0.0))

    @staticmethod
    def where(condition: np.ndarray, x: Dual, y: Dual) -> Dual:
        """Return the entries of x where the condition holds, else those of y."""
        return Dual(np.where(condition, x.value, y.value), np.where(condition, x.rate, y.rate))

    @staticmethod
    def stack(parts: Sequence[Dual], axis: int) -> Dual:
        """Join duals along a new axis."""
        return Dual(*(np.stack(each, axis=axis) for each in zip(*map(_parts, parts), strict=True)))

    @staticmethod
    def concat(parts: Sequence[Dual], axis: int) -> Dual:
        """Join duals along an axis."""
        return Dual(*(np.concatenate(each, axis=axis) for each in zip(*map(_parts, parts), strict=True)))


def differentiate(function: Callable[[Any], tuple[Dual, ...]], time: np.ndarray) -> tuple[Any, Any]:
    """Return the values of a function of time, and their rates."""
    found = function(Dual(time, np.ones_like(time)))
    return tuple(dual.value for dual in found), tuple(dual.rate for dual in found)


def _parts(x: Any) -> tuple[Any, Any]:
    """Return value and rate."""
    return (x.value, x.rate) if isinstance(x, Dual) else (x, 0.0)
