"""Types of settings and bounds of their numbers, declared where the field is; one walk
over a dataclass checks its values, reads them from JSON and writes them to JSON.

    sweep: Positive = 0.7
    friction: Annotated[float, Within(0.01, 10.0)] = 0.9
    latency: Annotated[Range, Within(0.0, 0.010)] = (0.0, 0.010)

`check_bounds` goes through a dataclass and the ones in it; a dataclass that is
`Bounded` does so when it is made. A value must be of the field's type. A number must be
finite unless its bounds say otherwise, and an integer must fit 64 bits; in a tuple
every entry must be within, and a `Range` must ascend.

`serialization` says what JSON can hold. In JSON types are checked; bounds are checked
when the dataclass is made.
"""

import dataclasses
import json
import math
import typing
from collections.abc import Sequence
from numbers import Integral, Real
from pathlib import Path
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
Way = Literal["check", "read", "write"]
"""What a walk does with a value: check it, read it from JSON, or write it to JSON."""
TYPE = "type"
"""The key in JSON under which one of several dataclasses has its name."""
UNWRITTEN = {"written": False}
"""Metadata of a field that JSON does not hold, and of which nothing is checked."""
# JSON has no infinity and no NaN; as strings they stay readable by every JSON tool.
NON_FINITE = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


def check_bounds(config: object, path: str = "") -> None:
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
    _walk_fields(config, path, "check")


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


# --- The walk over a type -------------------------------------------------------------


def walk(
    annotation: object, value: Any, path: str, way: Way, bounds: Within = ANY
) -> Any:
    """Check a value against its annotation; return it, converted from or to JSON where
    `way` says so.

    Args:
        annotation: the type declared, with its bounds.
        value: a Python value, or one of JSON to be read.
        path: the value's name in messages.
        way: what to do.
        bounds: those declared around the annotation.

    Raises:
        UserError: one line that names the value, its type or bounds, and what it is.
        TypeError: JSON cannot hold values of this type.
    """
    kinds = _kinds_of(annotation, bounds)
    records = [kind for kind, _ in kinds if dataclasses.is_dataclass(kind)]
    if len(records) > 1 and way != "check":
        return _walk_choice(records, value, path, way)
    fitting = [member for member in kinds if _is_of(value, member[0], way)]
    if not fitting:
        names = [
            _in_words(member, way) for member, _ in kinds if member is not NoneType
        ]
        raise UserError(
            f"{path or 'config'} takes {' or '.join(names)}, got {_shown(value)}"
        )
    kind, bounds = fitting[0]
    if dataclasses.is_dataclass(kind):
        return _walk_record(kind, value, f"{path}." if path else "", way)
    if kind in NUMBERS:
        return _walk_number(kind, value, path, way, bounds)
    if get_origin(kind) in (tuple, Sequence):
        entries = _walk_entries(kind, value, path, way, bounds)
        ranges = way == "check" and [
            member for member, _ in kinds if member is not NoneType
        ]
        if ranges == [Range] and not value[0] <= value[1]:
            raise UserError(
                f"{path} must be a range (low, high) with low <= high, got {value}"
            )
        return entries if way == "write" else tuple(entries)
    return value if way == "check" else _walk_plain(kind, value, path, way)


def _kinds_of(annotation: object, bounds: Within = ANY) -> list[tuple[Any, Within]]:
    """Return the types that an annotation allows, one by one, None's too, each with the
    bounds of its numbers."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        declared = [remark for remark in inner[1:] if isinstance(remark, Within)]
        return _kinds_of(
            inner[0], declared[0] if declared and bounds is ANY else bounds
        )
    if origin in (Union, UnionType):
        return [kind for member in inner for kind in _kinds_of(member, bounds)]
    return [(annotation, bounds)]


def _is_of(value: Any, kind: Any, way: Way) -> bool:
    """Return whether a value is of a type; its entries are not looked at.

    It always is of a type that cannot be looked into, such as a function's.
    """
    plain = get_origin(kind) or kind
    if plain is Literal:
        return any(
            value == choice and type(value) is type(choice) for choice in get_args(kind)
        )
    if kind in NUMBERS:
        if way == "read" and kind is float and isinstance(value, str):
            return value in NON_FINITE
        return isinstance(value, NUMBERS[kind]) and not isinstance(value, bool)
    if way == "write" and dataclasses.is_dataclass(kind):
        return type(value) is kind  # a subclass has fields that would be lost
    if way == "read":
        in_json: dict[Any, Any] = {tuple: (list, tuple), Path: str}
        plain = dict if dataclasses.is_dataclass(kind) else in_json.get(plain, plain)
    unknown = kind is Any or not isinstance(plain, type | tuple)
    return unknown or isinstance(value, plain)


def _walk_number(
    kind: type[float], value: Any, path: str, way: Way, bounds: Within
) -> float | str:
    """Check a number against its bounds, or convert it; JSON has those that are not
    finite as strings."""
    if way == "check":
        number = int(value) if isinstance(value, Integral) else float(value)
        if number in bounds:
            return number
        endless = not (
            _is_finite(number)
            or math.isfinite(bounds.most)
            or bounds.infinite
            or bounds == ANY
        )
        raise UserError(
            f"{path} must be {bounds}{' and finite' if endless else ''}, got {_show(number)}"
        )
    if isinstance(value, str):
        return NON_FINITE[value]
    try:
        number = kind(value)
    except OverflowError as error:
        raise UserError(f"{path} takes a number, got {_shown(value)}") from error
    endless = kind is float and not math.isfinite(number)
    return str(number) if endless and way == "write" else number


def _walk_entries(
    kind: object, values: Sequence[object], path: str, way: Way, bounds: Within
) -> list[Any]:
    """Check or convert the entries of a tuple; `tuple[X, ...]` has any number."""
    kinds = get_args(kind)
    if get_origin(kind) is Sequence or ... in kinds:
        kinds = kinds[:1] * len(values)
    if len(kinds) != len(values):
        raise UserError(f"{path} takes {len(kinds)} entries, got {len(values)}")
    return [
        # a flag's values have no names of their own
        walk(inner, value, path if way == "check" else f"{path}[{i}]", way, bounds)
        for i, (inner, value) in enumerate(zip(kinds, values, strict=True))
    ]


def _walk_plain(kind: Any, value: Any, path: str, way: Way) -> Any:
    """Convert an object, a path, or a value that is the same in Python and in JSON."""
    if get_origin(kind) is dict:
        inner = get_args(kind)[1]
        return {
            key: walk(inner, entry, f"{path}.{key}" if path else key, way)
            for key, entry in value.items()
        }
    if kind is Path:
        return Path(value) if way == "read" else value.as_posix()
    if kind is Any:
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise UserError(f"{path}: not a JSON value ({error})") from error
    elif kind not in (bool, str, NoneType) and get_origin(kind) is not Literal:
        raise TypeError(f"{path}: a config cannot hold fields of type {kind}")
    return value


def _walk_choice(kinds: Sequence[Any], value: Any, path: str, way: Way) -> Any:
    """Convert one of several dataclasses, which JSON tells apart by their names."""
    choices = {kind.__name__: kind for kind in kinds}
    for name, kind in choices.items():
        if any(field.name == TYPE for field in dataclasses.fields(kind)):
            raise TypeError(
                f"a config cannot hold {name} in a union: its field {TYPE!r} is what tells members apart"
            )
    if way == "write":
        name = type(value).__name__
        data = value
    else:
        given = value if isinstance(value, dict) else {}
        name = given.get(TYPE)
        data = {key: entry for key, entry in given.items() if key != TYPE}
    if name not in choices:
        raise UserError(
            f"{path}.{TYPE} takes {' or '.join(choices)}, got {_shown(name)}"
        )
    walked = walk(choices[name], data, path, way)
    return {TYPE: name, **walked} if way == "write" else walked


def _walk_record(cls: Any, value: Any, prefix: str, way: Way) -> Any:
    """Check a dataclass, write it, or make it of an object of JSON."""
    if way != "read":
        return _walk_fields(value, prefix, way)
    fields = {
        field.name: field for field in dataclasses.fields(cls) if _is_walked(field)
    }
    for key in value:
        if key not in fields:
            raise UserError(
                f"{prefix}{key}: unknown key; {cls.__name__} has {', '.join(fields) or 'none'}"
            )
    for name, field in fields.items():
        defaults = (field.default, field.default_factory)
        if name not in value and defaults == 2 * (dataclasses.MISSING,):
            raise UserError(
                f"{prefix}{name}: missing, and {cls.__name__} has no default for it"
            )
    hints = typing.get_type_hints(cls, include_extras=True)
    values = {
        name: walk(hints[name], entry, f"{prefix}{name}", way)
        for name, entry in value.items()
    }
    try:
        return cls(**values)
    # the dataclass's own checks, in __post_init__
    except (ValueError, ArithmeticError) as error:
        path = prefix.removesuffix(".")
        raise UserError(f"{path}: {error}" if path else str(error)) from error


def _walk_fields(config: Any, prefix: str, way: Way) -> dict[str, Any]:
    """Walk the fields that a dataclass is made with; return their values by name."""
    hints = typing.get_type_hints(type(config), include_extras=True)
    names = [field.name for field in dataclasses.fields(config) if _is_walked(field)]
    shown_names = {
        name: name.replace("_", "-") if prefix.startswith("--") else name
        for name in names
    }
    return {
        name: walk(hints[name], getattr(config, name), prefix + shown_names[name], way)
        for name in names
    }


def _is_walked(field: "dataclasses.Field[object]") -> bool:
    """Return whether a walk goes through a field of a dataclass."""
    return field.init and not UNWRITTEN.items() <= field.metadata.items()


def _in_words(kind: Any, way: Way) -> str:
    """Name a value of this kind, after "takes"."""
    plain, inner = get_origin(kind) or kind, get_args(kind)
    if plain is Literal:
        return " or ".join(map(repr, inner))
    if plain in (tuple, Sequence) and inner:
        entry, _ = _kinds_of(inner[0])[0]
        return f"a {plain.__name__.lower()} of entries, each {_in_words(entry, way)}"
    words = {
        float: "a number",
        int: "a whole number",
        bool: "True or False",
        str: "a text",
        dict: "an object",
        Path: "a path",
    }
    if plain in words:
        return words[plain]
    name = getattr(kind, "__name__", str(kind))
    if way == "read":
        return f"an object ({name})"
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _shown(value: object) -> str:
    """Return a value for a message, which may be an integer of hundreds of digits."""
    return _show(value) if type(value) is int else shown(value)


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
