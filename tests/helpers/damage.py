"""Files damaged as accidents and strangers damage them."""

import io
import json
import os
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

STRANGE: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**400,
    -(10**30),
    2**63,
    1e308,
    -1e-320,
    float("nan"),
    float("inf"),
    "",
    "nan",
    "\ud800",
    "a\0b",
    "x" * 5000,
    [],
    {},
    [None],
    {"type": 3},
    [[[[]]]],
    {"": {"": {}}},
)


def strange_json(data: Any, count: int, seed: int = 0) -> Iterator[str]:
    """Yield JSON texts like `data`, each with one value replaced, removed or renamed;
    and deeply nested texts."""
    rng = random.Random(seed)
    places = list(_places(data))
    for _ in range(count):
        copy, holder, last = _at(data, rng.choice(places))
        action = rng.random()
        if action < 0.8:
            holder[last] = rng.choice(STRANGE)
        elif action < 0.9:
            del holder[last]
        elif isinstance(holder, dict):
            holder[f"{last}x"] = holder.pop(last)
        else:
            holder.append(holder[last])
        yield json.dumps(copy)
    for depth in (45, 60, 900, 100_000):
        copy, holder, last = _at(data, rng.choice(places))
        holder[last] = "here"
        yield json.dumps(copy).replace('"here"', "[" * depth + "]" * depth)


def _at(data: Any, place: tuple) -> tuple[Any, Any, Any]:
    """Return a copy of a JSON value, the list or object in it that holds a place, and
    the place's last key."""
    holder = copy = json.loads(json.dumps(data))
    for key in place[:-1]:
        holder = holder[key]
    return copy, holder, place[-1]


def flipped_bits(content: bytes, count: int, seed: int = 0) -> Iterator[bytes]:
    """Yield `count` copies of the content, each with one bit flipped."""
    rng = random.Random(seed)
    for _ in range(count):
        flipped = bytearray(content)
        flipped[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        yield bytes(flipped)


def strange_arrays(content: bytes, rng: random.Random) -> bytes:
    """Return an .npz file like this one, with one array replaced, exchanged for
    another, renamed or removed."""
    with np.load(io.BytesIO(content)) as file:
        arrays: dict[str, Any] = dict(file)
    name, other = rng.sample(list(arrays), 2)
    array = arrays.pop(name)
    place = rng.randrange(array.size)
    changed = np.array(array)
    action = rng.randrange(12)
    if action < 4:
        changed.flat[place] = (
            np.nan,
            -np.inf,
            1e300,
            changed.flat[place] * 10.0 ** rng.uniform(-3.0, 6.0),
        )[action]
    elif action < 8:
        changed = (
            np.full_like(array, np.nan),
            0.0 * array,
            -array,
            array * 10.0 ** rng.uniform(-2.0, 4.0),
        )[action - 4]
    elif action < 10:
        changed = (
            array[..., :-1],
            array.astype((np.int64, np.complex128, object)[place % 3]),
        )[action - 8]
    elif action == 10:
        changed, arrays[other] = arrays.get(other, array), array
    if action != 11:
        arrays[name] = changed
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def damaged_bundles(
    folder: Path, count: int, seed: int = 0
) -> Iterator[tuple[str, bool]]:
    """Damage one file of a bundle in its place, `count` times, and mend it after each;
    yield what was damaged and whether to seal the bundle again."""
    rng = random.Random(seed)
    contents = {
        path: path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix not in (".py", ".pyc", "")
    }
    settings, reference = folder / "deploy.json", folder / "reference.npz"
    manifest = folder / "manifest.json"
    texts = {
        path: strange_json(json.loads(contents[path]), count, seed)
        for path in (settings, manifest)
    }
    for i in range(count):
        kind = rng.choice(
            (
                "settings",
                "settings",
                "settings",
                "arrays",
                "arrays",
                "weights",
                "bits",
                "cut",
                "place",
            )
        )
        path = {
            "settings": settings,
            "arrays": reference,
            "weights": folder / "policy.onnx",
        }.get(kind)
        path = path or rng.choice(
            [path for path in contents if kind != "place" or path.suffix != ".xml"]
        )
        content = contents[path]
        if kind == "settings":
            path = manifest if rng.random() < 0.1 else settings
            path.write_text(next(texts[path]))
        elif kind == "arrays":
            path.write_bytes(strange_arrays(content, rng))
        elif kind == "weights":
            at = rng.randrange(len(content) // 2, len(content) - 4)
            number = np.float32(
                rng.choice((np.nan, np.inf, 1e38, 1e6, 10.0, 0.1, -1.0))
            )
            path.write_bytes(content[:at] + number.tobytes() + content[at + 4 :])
        elif kind == "bits":
            path.write_bytes(next(flipped_bits(content, 1, rng.randrange(2**32))))
        elif kind == "cut":
            path.write_bytes(content[: rng.randrange(len(content))])
        else:
            path.unlink()
            if (
                link := rng.choice(("/dev/zero", "/dev/null", "nowhere", "."))
            ) != "nowhere":
                os.symlink(link, path)
        yield f"{i}: {kind} of {path.name}", i % 2 == 1
        path.unlink(missing_ok=True)
        for mended in {path, manifest}:
            mended.write_bytes(contents[mended])


def _places(data: Any, path: tuple = ()) -> Iterator[tuple]:
    """Yield the path of keys to each value in a JSON value."""
    inner = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    for key, value in inner:
        yield (*path, key)
        yield from _places(value, (*path, key))
