"""Write the file from which the controller in C++ reads its texts and numbers.

The file is little-endian: `BP2C`, version (uint32), bytes of the network's records
(uint64), the records, the network's first, and the CRC-32 of the preceding bytes
(uint64). A record has the length of its name and a kind (uint32 each; 0 text, 4
float32, 8 float64), a count (uint64), the least and greatest number that the controller
accepts (float64 each), and the name and the content, both padded with zeros to 8 bytes.
Names are the dotted names of `deploy.json` (`control.stand`), `arrays.NAME` for arrays
of `reference.npz`, `network.NAME`, and `constants.NAME` for constants of the laws.
"""

import dataclasses
import math
import struct
import typing
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from bp2_rl.base.bounds import Within
from bp2_rl.base.files import read_npz, write_bytes
from bp2_rl.reference.stepping import TROT
from bp2_rl.reference.trot_law import FLEXION
from bp2_rl.robot.anatomy import COSINE_MARGIN, SHORTEST_SQUARED
from bp2_rl.robot.conventions import GRAVITY, MIRRORED
from bp2_rl.robot.operator import EASE, CommandLaw

from .contents import (
    CPP,
    NUMBERS,
    REFERENCE,
    Settings,
    WatchdogLimits,
    loading,
    read_bundle,
)
from .motion import LARGEST, LEAST_LEFT, specs_of
from .watchdog import HUGE

BINARY = f"{CPP}/controller.bin"
HEAD = struct.Struct("<4sIQ")  # signature, version, bytes of the network's records
RECORD = struct.Struct("<IIQdd")  # length of the name, kind, count, least, most
SIGNATURE, VERSION = b"BP2C", 1
CONSTANTS = {
    "trot": TROT,
    "mirrored": MIRRORED,
    "flexion": FLEXION,
    "gravity": GRAVITY,
    "shortest_squared": SHORTEST_SQUARED,
    "cosine_margin": COSINE_MARGIN,
    "least_left": LEAST_LEFT,
    "ease": EASE,
    "huge": HUGE,
}
"""Numbers of the laws that `deploy.json` does not hold."""


def record(name: str, value: object, bounds: tuple[float, float]) -> bytes:
    """Return the record of a text, a list of texts, or numbers with their bounds.

    None is infinity. Numbers are float64, unless they are an array of float32.
    """
    texts = [value] if isinstance(value, str) else value
    if isinstance(texts, list) and isinstance(texts[0], str):
        data = "\n".join(texts).encode()
        kind, count, bounds = 0, len(data), (0.0, 0.0)
    else:
        array = np.asarray(math.inf if value is None else value)
        kind, count = (4 if array.dtype == np.float32 else 8), array.size
        data = array.astype(f"<f{kind}").tobytes()
    head = RECORD.pack(len(name), kind, count, *bounds)
    return head + _padded(name.encode()) + _padded(data)


def pack(settings: Settings, arrays: Mapping[str, np.ndarray], network: bytes) -> bytes:
    """Return the content of the controller's file.

    Args:
        settings: the content of `deploy.json`.
        arrays: those of `reference.npz`.
        network: the network's records.
    """
    seen = [{"name": name, "size": size} for name, size in settings["observation"]]
    parts = {name: value for name, value in settings.items() if name != "robots"}
    parts |= {"observation": seen, "arrays": arrays, "constants": CONSTANTS}
    bounds = {name: limits[:2] for name, limits in NUMBERS.items()}
    bounds |= _declared("watchdog", WatchdogLimits) | _declared("control", CommandLaw)
    bounds["constants.huge"] = (1.0, HUGE)
    return assemble(parts, network, bounds)


def assemble(
    parts: Mapping[str, object],
    network: bytes = b"",
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> bytes:
    """Return the content of a file of this format.

    Args:
        parts: texts and numbers by name, in objects and lists of objects.
        network: the network's records.
        bounds: of the numbers, by dotted name; others are within `LARGEST`. None:
            numbers have no bounds.
    """
    content = HEAD.pack(SIGNATURE, VERSION, len(network)) + network
    default = (-math.inf, math.inf) if bounds is None else (-LARGEST, LARGEST)
    for name, value in _flat(parts, ""):
        content += record(name, value, (bounds or {}).get(name, default))
    return content + struct.pack("<Q", zlib.crc32(content))


def repack(folder: Path) -> None:
    """Write a bundle's file for C++ anew, from its edited `deploy.json`; the network is
    the one in the file.

    Raises:
        BundleError: a file cannot be read or written.
    """
    settings, files = read_bundle(folder)
    if BINARY in files:
        with loading(folder):
            arrays = read_npz(folder / REFERENCE, specs_of(settings["reference"]))
            _, _, size = HEAD.unpack_from(files[BINARY])
            network = files[BINARY][HEAD.size : HEAD.size + size]
            write_bytes(folder / BINARY, pack(settings, arrays, network))


def _flat(value: object, name: str) -> Iterator[tuple[str, object]]:
    """Yield the dotted names and the values in `value`, where a list of objects counts
    as an object of lists."""
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        value = {key: [entry[key] for entry in value] for key in value[0]}
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else key)
    else:
        yield name, value


def _declared(path: str, kind: type) -> dict[str, tuple[float, float]]:
    """Return the bounds that a dataclass declares for its fields, by dotted name."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return {
        f"{path}.{field.name}": (
            within.least,
            math.inf if within.infinite else within.most,
        )
        for field in dataclasses.fields(kind)
        for within in hints[field.name].__metadata__
        if isinstance(within, Within)
    }


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 8)
