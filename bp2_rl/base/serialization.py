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
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from bp2_rl.base import __version__
from bp2_rl.base.bounds import Way, walk
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import BadFileError, read_json, write_text
from bp2_rl.base.folders import make_folder

Config = TypeVar("Config")


class ConfigError(UserError):
    """Raised for a config file or value that does not fit its dataclass."""


def to_json(config: object) -> dict[str, Any]:
    """Return a dataclass as a JSON object; floats stay floats (1 becomes 1.0),
    non-finite numbers become strings.

    Raises:
        ConfigError: a field holds a value of another type than the one declared.
    """
    return _walk_config(type(config), config, "write")


def from_json(cls: type[Config], data: object) -> Config:
    """Return the `cls` that the JSON object `data` describes: `from_json(cls,
    to_json(c)) == c`.

    Fields with a default may be absent. An integer is a fine float; nothing else is
    converted.

    Raises:
        ConfigError: an unknown key, a missing one, a wrong type, or a value that the
            dataclass itself refuses.
    """
    return _walk_config(cls, data, "read")


def _walk_config(cls: type, config: object, way: Way) -> Any:
    try:
        return walk(cls, config, "", way)
    except UserError as error:
        raise ConfigError(str(error)) from error


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
        remedy = "update bp2_rl" if found > version else "use the bp2_rl that wrote it"
        raise ConfigError(
            f"{path} has format {found}, of bp2_rl {author}; this one reads format {version}: {remedy}"
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
    names = "jax jaxlib mujoco mujoco-mjx brax flax optax numpy"
    versions = {name: importlib.metadata.version(name) for name in names.split()}
    return {"bp2_rl": __version__} | versions
