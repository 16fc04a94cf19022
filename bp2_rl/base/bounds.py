"""Types of settings and bounds of their numbers, declared where the field is and
checked in one place.

    sweep: Positive = 0.7
    friction: Annotated[float, Within(0.01, 10.0)] = 0.9
    latency: Annotated[Range, Within(0.0, 0.010)] = (0.0, 0.010)

`check_bounds` goes through a dataclass and the ones in it; a dataclass that is
`Bounded` does so when it is made. A value must be of the field's type. A number must be
finite unless its bounds say otherwise, and an integer must fit 64 bits; in a tuple
every entry must be within, and a `Range` must ascend.
"""

import dataclasses
import math
import typing
from collections.abc import Sequence
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin

from bp2_rl.base.errors import UserError, shown


@dataclasses.dataclass(frozen=True)
class Within:
    """Bounds of a number: from `least` to `most`."""

    least: float = -math.inf
    most: float = math.inf
    open_below: bool = False  # `least` itself is too little
    open_above: bool = False  # `most` itself is too much
    infinite: bool = False  # plus infinity is allowed, and means that there is no limit

    def __contains__(self, number: float) -> bool:
        """Return whether a number keeps to the bounds; NaN never does."""
        if not _is_finite(number):
            return self.infinite and number == math.inf
        above = number > self.least if self.open_below else number >= self.least
        below = number < self.most if self.open_above else number <= self.most
        return above and below

    def __repr__(self) -> str:
        """Return the bounds in words, in angle brackets, for signatures."""
        return f"<{self}>"

    def __str__(self) -> str:
        """Return the bounds in words that continue "must be", such as "from 0 to 1"."""
        lower, upper = math.isfinite(self.least), math.isfinite(self.most)
        if lower and upper and not (self.open_below or self.open_above):
            return f"from {_show(self.least)} to {_show(self.most)}{' or inf' if self.infinite else ''}"
        ends = []
        if lower and self.open_below:
            ends.append("positive" if self.least == 0 else f"above {_show(self.least)}")
        elif lower:
            ends.append(f"at least {_show(self.least)}")
        if upper:
            ends.append(
                f"{'below' if self.open_above else 'at most'} {_show(self.most)}"
            )
        return " and ".join(ends) or "a finite number"


ANY = Within()
POSITIVE = Within(0.0, open_below=True)
Positive = Annotated[float, POSITIVE]
Share = Annotated[float, Within(0.0, 1.0)]
Count = Annotated[int, Within(1)]
NUMBERS: dict[Any, Any] = {float: Real, int: Integral}
"""Python's abstract type for each type of number, so that NumPy's numbers count,
too."""
Range = tuple[float, float]
"""An interval (low, high), in which a setting lies or from which it is drawn."""


def check_bounds(config: Any, path: str = "") -> None:
    """Raise `UserError` if a field of a dataclass, or of a dataclass in it, has a wrong
    type or is out of bounds.

    Args:
        config: an instance.
        path: what its fields' names are preceded by in messages, `control.`; empty for
            none. If that begins as a flag does, `--operator.`, they are written as
            flags.

    Raises:
        UserError: one line that names the first such field, its type or bounds, and its
            value.
    """
    hints = typing.get_type_hints(type(config), include_extras=True)
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{path}{field.name}"
        name = name.replace("_", "-") if path.startswith("--") else name
        annotation = hints[field.name]
        kinds = [kind for kind in kinds_of(annotation) if kind is not NoneType]
        if not _fits(value, annotation):
            raise UserError(
                f"{name} takes {' or '.join(map(_in_words, kinds))}, got {shown(value)}"
            )
        entries = value if isinstance(value, tuple) else (value,)
        for each in entries:
            if dataclasses.is_dataclass(each):
                check_bounds(each, f"{name}.")
        numbers = [
            int(each) if isinstance(each, Integral) else float(each)  # NumPy's, too
            for each in entries
            if not isinstance(each, bool) and isinstance(each, Real)
        ]
        bounds = _bounds(annotation)
        for number in numbers:
            if number not in bounds:
                endless = not (
                    _is_finite(number)
                    or math.isfinite(bounds.most)
                    or bounds.infinite
                    or bounds == ANY
                )
                raise UserError(
                    f"{name} must be {bounds}{' and finite' if endless else ''}, got {_show(number)}"
                )
        if numbers and kinds == [Range] and not value[0] <= value[1]:
            raise UserError(
                f"{name} must be a range (low, high) with low <= high, got {value}"
            )


class Bounded:
    """Base class of dataclasses that check types and bounds of their fields when made;
    one with further checks has a `__post_init__` of its own."""

    _path: ClassVar[str] = ""

    def __init_subclass__(cls, path: str | None = None) -> None:
        """Set the prefix `path` of a subclass's field names in error messages; without
        `path` it is inherited."""
        if path is not None:
            cls._path = path

    def __post_init__(self) -> None:
        """Raise `UserError` if a field has a wrong type or is out of bounds."""
        check_bounds(self, self._path)


def _bounds(annotation: object) -> Within:
    """Return the bounds that a type annotation declares, also inside `X | None` or a
    tuple."""
    if get_origin(annotation) is Annotated:
        inner, *remarks = get_args(annotation)
        found = [remark for remark in remarks if isinstance(remark, Within)]
        return found[0] if found else _bounds(inner)
    for member in get_args(annotation):
        found = _bounds(member)
        if found is not ANY:
            return found
    return ANY


def _fits(value: Any, annotation: object) -> bool:
    """Return whether a value has the type that an annotation declares.

    It always is of a type that cannot be looked into, such as a function's.
    """
    kinds = kinds_of(annotation)
    if len(kinds) > 1:
        return any(_fits(value, kind) for kind in kinds)
    [annotation] = kinds
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return value in inner
    if origin in (tuple, Sequence):
        if not isinstance(value, origin):
            return False
        kinds = (
            inner if origin is tuple and ... not in inner else inner[:1] * len(value)
        )
        return len(value) == len(kinds) and all(map(_fits, value, kinds))
    if annotation in NUMBERS:
        return isinstance(value, NUMBERS[annotation]) and not isinstance(value, bool)
    return (
        annotation is Any
        or not isinstance(annotation, type)
        or isinstance(value, annotation)
    )


def kinds_of(annotation: object) -> list[Any]:
    """Return the alternatives of a type annotation, None's included, without the extras
    of `Annotated`."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return kinds_of(inner[0])
    if origin in (Union, UnionType):
        return [kind for member in inner for kind in kinds_of(member)]
    return [annotation]


def _in_words(kind: Any) -> str:
    """Describe a type in words that continue "takes", such as "a whole number"."""
    inner = [each for each in get_args(kind) if each is not ...]
    if get_origin(kind) is Literal:
        return " or ".join(map(str, inner))
    if inner:
        return f"a {get_origin(kind).__name__.lower()} of entries, each {_in_words(kinds_of(inner[0])[0])}"
    words = {
        float: "a number",
        int: "a whole number",
        bool: "True or False",
        str: "a text",
    }
    return (
        words.get(kind)
        or f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
    )


def _is_finite(number: float) -> bool:
    """Return whether a float is finite, or an integer has at most 64 bits."""
    return (
        -(2**63) <= number < 2**63 if isinstance(number, int) else math.isfinite(number)
    )


def _show(number: float) -> str:
    """Return a number as text for an error message; a huge integer is not written
    out."""
    if isinstance(number, int):
        return str(number) if abs(number) < 10**30 else "a huge integer"
    return f"{number:g}"
