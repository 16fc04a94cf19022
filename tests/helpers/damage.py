"""Files as accidents and strangers leave them."""

import json
import random
from collections.abc import Iterator
from typing import Any

STRANGE: tuple[Any, ...] = (
    None, True, -1, 0, 10**400, -(10**30), 2**63, 1e308, -1e-320, float("nan"), float("inf"), "", "nan", "\ud800",
    "a\0b", "x" * 5000, [], {}, [None], {"type": 3}, [[[[]]]], {"": {"": {}}},
)  # fmt: skip


def strange_json(data: Any, count: int, seed: int = 0) -> Iterator[str]:
    """JSON texts like that of `data`, each with one value replaced, removed or renamed; and deeply nested ones."""
    rng = random.Random(seed)
    places = list(_places(data))
    for _ in range(count):
        copy = json.loads(json.dumps(data))
        *path, last = rng.choice(places)
        holder = copy
        for key in path:
            holder = holder[key]
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
        *path, last = rng.choice(places)
        copy = json.loads(json.dumps(data))
        holder = copy
        for key in path:
            holder = holder[key]
        holder[last] = "here"
        yield json.dumps(copy).replace('"here"', "[" * depth + "]" * depth)


def flipped_bits(content: bytes, count: int, seed: int = 0) -> Iterator[bytes]:
    """The content with one bit flipped, many times."""
    rng = random.Random(seed)
    for _ in range(count):
        flipped = bytearray(content)
        flipped[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        yield bytes(flipped)


def _places(data: Any, path: tuple = ()) -> Iterator[tuple]:
    """The keys that lead to each value in a JSON value."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in inner:
        yield (*path, key)
        yield from _places(value, (*path, key))
