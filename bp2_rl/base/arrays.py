"""What functions may ask of numbers that are NumPy's, JAX's or CasADi's, without
importing any of these."""

from typing import Any, Protocol, TypeVar, runtime_checkable


@runtime_checkable
class Number(Protocol):
    """A float, an array of NumPy or JAX, or an expression of CasADi: all that one can
    calculate with."""

    def __add__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __radd__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __sub__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __rsub__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __mul__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __rmul__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __truediv__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __rtruediv__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __pow__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __neg__(self) -> Any: ...  # noqa: D105
    def __gt__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __ge__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __lt__(self, other: Any, /) -> Any: ...  # noqa: D105
    def __le__(self, other: Any, /) -> Any: ...  # noqa: D105


@runtime_checkable
class Array(Number, Protocol):
    """An array of NumPy or JAX: a number with a shape, whose functions are in
    `__array_namespace__()`."""

    @property
    def shape(self) -> tuple[int, ...]: ...  # noqa: D102
    @property
    def dtype(self) -> Any: ...  # noqa: D102
    @property
    def ndim(self) -> int: ...  # noqa: D102
    def __array_namespace__(self) -> Any: ...  # noqa: D105
    def __array__(self) -> Any: ...  # noqa: D105
    def __getitem__(self, key: Any, /) -> Any: ...  # noqa: D105
    def sum(self, axis: Any = ...) -> Any: ...  # noqa: D102
    def reshape(self, *shape: Any) -> Any: ...  # noqa: D102


ArrayT = TypeVar("ArrayT", bound=Array)
"""The one kind of array that a function takes and returns."""
