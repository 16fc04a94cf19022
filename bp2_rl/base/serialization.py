"""Convert configs, which are frozen dataclasses, to JSON and strictly back.

What may stand in a config: float, int, bool, str, `pathlib.Path`, tuples, a float or a
tuple, Literals, nested dataclasses, any of those or None, `dict[str, ...]` and `Any`
(any JSON value). A file that does not fit the dataclass is refused with the path of the
key at fault, never patched up. One of several dataclasses is written with its name
under `type`.
"""

import dataclasses
import datetime
import hashlib
import importlib.metadata
import json
import math
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin

from bp2_rl.base import __version__
from bp2_rl.base.bounds import kinds_of
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import BadFileError, read_json, write_text
from bp2_rl.base.folders import make_folder

Config = TypeVar("Config")
_TYPE = "type"

# JSON has no infinity and no NaN; as strings they stay readable by every JSON tool.
_NON_FINITE = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


class ConfigError(UserError):
    """Raised for a config file or value that does not fit its dataclass."""


def to_json(config: object) -> dict[str, Any]:
    """Return a dataclass as a JSON object; floats stay floats (1 becomes 1.0),
    non-finite numbers become strings.

    Raises:
        ConfigError: a field holds a value of another type than the one declared.
    """
    return _convert(type(config), config, "", reading=False)


def from_json(cls: type[Config], data: object) -> Config:
    """Return the `cls` that the JSON object `data` describes: `from_json(cls,
    to_json(c)) == c`.

    Fields with a default may be absent. An integer is a fine float; nothing else is
    converted.

    Raises:
        ConfigError: an unknown key, a missing one, a wrong type, or a value that the
            dataclass itself refuses.
    """
    return _convert(cls, data, "", reading=True)


def flatten(data: Any, path: str = "") -> dict[str, Any]:
    """Return the values of a nested JSON object by their dotted names."""
    if not isinstance(data, dict):
        return {path: data}
    return {
        name: value
        for key, inner in data.items()
        for name, value in flatten(inner, f"{path}.{key}".strip(".")).items()
    }


def merge(before: Config, changed: Config, after: Config) -> Config:
    """Return `after` with every field that `changed` sets differently from `before`;
    all three have one type."""

    def field(old: Any, mine: Any, new: Any) -> Any:
        nested = dataclasses.is_dataclass(old) and type(old) is type(mine) is type(new)
        return merge(old, mine, new) if nested else new if mine == old else mine

    names = (f.name for f in dataclasses.fields(typing.cast(Any, before)))
    values = {
        name: field(*(getattr(c, name) for c in (before, changed, after)))
        for name in names
    }
    return dataclasses.replace(typing.cast(Any, after), **values)


def config_hash(config: object) -> str:
    """Return a hash of a config, twelve hex digits, the same on every machine and in
    every process."""
    return _sha256(to_json(config))[:12]


def _sha256(data: Mapping[str, object]) -> str:
    """Return the SHA-256 of a JSON object, however it is laid out in a file."""
    return hashlib.sha256(
        json.dumps(data, sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()


def save_config(path: Path, config: object) -> None:
    """Write `config` to `path` as readable JSON; the file is either the old one or the
    whole new one."""
    write_text(path, json.dumps(to_json(config), indent=2, allow_nan=False) + "\n")


def load_config(cls: type[Config], path: Path) -> Config:
    """Read a config of the dataclass `cls` from the JSON file that `save_config` wrote.

    Raises:
        ConfigError: the file is missing, is not JSON, or does not describe a `cls`.
    """
    try:
        return from_json(cls, read_json(path))
    except BadFileError as error:
        raise ConfigError(str(error)) from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def save_sealed(path: Path, card: object, checksum: str) -> None:
    """Write a dataclass as `save_config` does, and a checksum of its values under the
    key `checksum`."""
    data = to_json(card)
    write_text(
        path,
        json.dumps(data | {checksum: _sha256(data)}, indent=2, allow_nan=False) + "\n",
    )


def load_sealed(cls: type[Config], path: Path, checksum: str, version: int) -> Config:
    """Read the `cls` that `save_sealed` wrote to `path`, and verify its checksum if it
    has one.

    Args:
        cls: a dataclass with the fields `format_version` and `versions`.
        path: of the file.
        checksum: the name of the entry that is the checksum of the others.
        version: the one format that is read.

    Raises:
        BadFileError: the file is missing or is not JSON.
        ConfigError: the file is not ours, of another format, edited, or does not
            describe a `cls`.
    """
    data = read_json(path)
    found = data.get("format_version") if isinstance(data, dict) else None
    if type(found) is not int:
        raise ConfigError(f"{path} is not of bp2_rl: it has no format_version")
    versions = data.get("versions")
    author = (
        versions.get("bp2_rl", "unknown") if isinstance(versions, dict) else "unknown"
    )
    if found != version:
        mend = "update bp2_rl" if found > version else "use the bp2_rl that wrote it"
        raise ConfigError(
            f"{path} has format {found}, of bp2_rl {author}; this one reads format {version}: {mend}"
        )
    rest = {key: value for key, value in data.items() if key != checksum}
    try:
        if checksum in data and data[checksum] != _sha256(rest):
            raise ConfigError(
                f"damaged or edited: {checksum} is the checksum of something else"
            )
        return from_json(cls, rest)
    except ConfigError as error:
        raise ConfigError(f"{path} (written by bp2_rl {author}): {error}") from error


def claim_folder(folder: Path, card: str, settings: Any, what: str) -> None:
    """Create a folder for work with these settings; raise `UserError` if it holds work
    with other settings.

    Args:
        folder: of the work.
        card: the file in it that holds the settings.
        settings: a config.
        what: the work, with its article, for the message.

    Raises:
        UserError: the folder cannot be made or written, or belongs to other settings.
    """
    make_folder(folder)
    path = folder / card
    if not path.exists():
        save_config(path, settings)
        return
    old = load_config(type(settings), path)
    changed = [
        f.name
        for f in dataclasses.fields(old)
        if getattr(old, f.name) != getattr(settings, f.name)
    ]
    if changed:
        raise UserError(
            f"{folder} holds {what} with another {' and '.join(changed)} (see {path}): "
            "choose another folder, or remove it"
        )


def utc_now() -> str:
    """Return the present time in UTC, to the second, as text in ISO 8601."""
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def package_versions() -> dict[str, str]:
    """Return the versions of all packages that a result depends on.

    bp2_rl itself need not be installed.
    """
    others = "jax jaxlib mujoco mujoco-mjx brax flax optax numpy"
    found = {name: importlib.metadata.version(name) for name in others.split()}
    return {"bp2_rl": __version__} | found


# --- The walk over a type, in both directions -----------------------------------------
def _convert(annotation: object, value: Any, path: str, *, reading: bool) -> Any:
    """Return a value declared as `annotation` as JSON, or, if `reading`, the JSON as a
    Python value."""
    kinds = kinds_of(annotation)
    if value is None and NoneType in kinds:
        return None
    kinds = [kind for kind in kinds if kind is not NoneType]
    if len(kinds) > 1 and all(map(dataclasses.is_dataclass, kinds)):
        return _convert_choice(kinds, annotation, value, path, reading=reading)
    if len(kinds) == 2 and kinds[0] is float and get_origin(kinds[1]) is tuple:
        kinds = [kinds[isinstance(value, list | tuple)]]
    if len(kinds) != 1:
        raise TypeError(
            f"{path}: a config cannot hold fields of type {annotation}; of unions, only X | None"
        )
    [kind] = kinds
    if dataclasses.is_dataclass(kind):
        convert = _read_dataclass if reading else _write_dataclass
        return convert(kind, value, path)
    if kind is float:
        return _convert_float(value, path, reading=reading)
    if kind is Path:
        _require(isinstance(value, str if reading else Path), kind, value, path)
        path_of = Path(str(value))
        return path_of if reading else path_of.as_posix()
    if get_origin(kind) is tuple:
        lists = (list, tuple) if reading else tuple
        _require(isinstance(value, lists), kind, value, path)
        items = [_convert(*item, reading=reading) for item in _items(kind, value, path)]
        return tuple(items) if reading else items
    if get_origin(kind) is dict:
        _require(isinstance(value, Mapping), kind, value, path)
        inner, entries = get_args(kind)[1], typing.cast(Mapping[str, Any], value)
        return {
            key: _convert(inner, entry, _join(path, key), reading=reading)
            for key, entry in entries.items()
        }
    return _plain(kind, value, path)


def _convert_choice(
    kinds: Sequence[Any], annotation: object, value: Any, path: str, *, reading: bool
) -> Any:
    """Convert one of several dataclasses, which JSON tells apart by their names."""
    choices = {kind.__name__: kind for kind in kinds}
    for name, kind in choices.items():
        if any(field.name == _TYPE for field in dataclasses.fields(kind)):
            raise TypeError(
                f"a config cannot hold {name} in a union: its field {_TYPE!r} is what tells members apart"
            )
    if not reading:
        name = type(value).__name__
        _require(name in choices, annotation, value, path)
        return {_TYPE: name, **_write_dataclass(choices[name], value, path)}
    _require(isinstance(value, dict), annotation, value, path)
    name = value.get(_TYPE)
    if name not in choices:
        raise ConfigError(
            f"{_join(path, _TYPE)}: expected one of {', '.join(choices)}, got {name!r}"
        )
    rest = {key: entry for key, entry in value.items() if key != _TYPE}
    return _read_dataclass(choices[name], rest, path)


def _convert_float(value: Any, path: str, *, reading: bool) -> float | str:
    """Convert a number; JSON has those that are not finite as strings."""
    if reading and isinstance(value, str) and value in _NON_FINITE:
        return _NON_FINITE[value]
    fits = isinstance(value, int | float) and not isinstance(value, bool)
    _require(fits, float, value, path)
    try:
        number = float(value)
    except OverflowError as error:  # an integer of hundreds of digits
        raise _mismatch(float, value, path) from error
    return number if reading or math.isfinite(number) else str(number)


def _write_dataclass(cls: Any, value: Any, path: str) -> dict[str, Any]:
    _require(type(value) is cls, cls, value, path)
    hints = _hints(cls)
    return {
        field.name: _convert(
            hints[field.name],
            getattr(value, field.name),
            _join(path, field.name),
            reading=False,
        )
        for field in dataclasses.fields(cls)
        if field.init
    }


def _read_dataclass(cls: Any, data: Any, path: str) -> Any:
    _require(isinstance(data, dict), cls, data, path)
    fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
    for key in data:
        if key not in fields:
            raise ConfigError(
                f"{_join(path, key)}: unknown key; {cls.__name__} has {', '.join(fields) or 'none'}"
            )
    for name, field in fields.items():
        defaults = (field.default, field.default_factory)
        if name not in data and defaults == 2 * (dataclasses.MISSING,):
            raise ConfigError(
                f"{_join(path, name)}: missing, and {cls.__name__} has no default for it"
            )
    hints = _hints(cls)
    values = {
        name: _convert(hints[name], entry, _join(path, name), reading=True)
        for name, entry in data.items()
    }
    try:
        return cls(**values)
    # the dataclass's own checks, in __post_init__
    except (ValueError, ArithmeticError) as error:
        raise ConfigError(f"{path}: {error}" if path else str(error)) from error


def _plain(annotation: Any, value: Any, path: str) -> Any:
    """Check and return a value that is the same in Python and in JSON."""
    if get_origin(annotation) is Literal:
        _require(
            any(
                value == choice and type(value) is type(choice)
                for choice in get_args(annotation)
            ),
            annotation,
            value,
            path,
        )
        return value
    if annotation is Any:
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{path}: not a JSON value ({error})") from error
        return value
    if annotation in (int, bool, str):
        _require(type(value) is annotation, annotation, value, path)
        return value
    raise TypeError(f"{path}: a config cannot hold fields of type {annotation}")


def _items(annotation: Any, values: Any, path: str) -> list[tuple[Any, Any, str]]:
    """Return a tuple's entries, each as (annotation, value, path); `tuple[X, ...]`
    takes any number."""
    items = get_args(annotation)
    if len(items) == 2 and items[1] is Ellipsis:
        items = items[:1] * len(values)
    if len(items) != len(values):
        raise ConfigError(f"{path}: expected {len(items)} entries, got {len(values)}")
    return [
        (item, value, f"{path}[{i}]")
        for i, (item, value) in enumerate(zip(items, values, strict=True))
    ]


def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _require(fits: bool, annotation: object, value: object, path: str) -> None:
    if not fits:
        raise _mismatch(annotation, value, path)


def _mismatch(annotation: object, value: object, path: str) -> ConfigError:
    shown = repr(value)
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    return ConfigError(f"{path or 'config'}: expected {_name(annotation)}, got {shown}")


def _name(annotation: Any) -> str:
    """Describe a type in words for an error message."""
    [annotation, *_] = kinds_of(annotation)
    if get_origin(annotation) is Literal:
        return " or ".join(repr(choice) for choice in get_args(annotation))
    plain = {
        float: "a number",
        int: "an integer",
        bool: "true or false",
        str: "a string",
        Path: "a path",
    }
    if annotation in plain:
        return plain[annotation]
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        return f"an object ({annotation.__name__})"
    kinds: dict[Any, str] = {tuple: "a list", dict: "an object"}
    return kinds.get(get_origin(annotation), str(annotation))


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
