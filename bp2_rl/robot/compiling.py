"""MuJoCo's compiler in a process of its own: an MJCF of a few lines can ask for all
time and memory there is."""

import concurrent.futures
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.base.processes import spawned

LONGEST = 12
"""s that a robot may take to compile: ours take .05."""
MOST = 2 << 30
"""Bytes of memory that it may take."""
LARGEST = 4 << 20
"""Bytes of the largest compiled model: BP2's has 118,348."""
NO_MEMORY = "unknown exception", "allocate memory"
"""How MuJoCo says that there is none left."""


class ReadingError(UserError):
    """An MJCF that cannot be read, or a robot that is no quadruped with legs of abad,
    hip and knee."""


Compiling = Callable[..., tuple[mujoco.MjModel, list[str]]]
"""A module's function that makes a model, and notes on it."""


def compiled_apart(
    compiling: Compiling, *arguments: Any
) -> tuple[mujoco.MjModel, list[str]]:
    """Return the model and the notes that a function makes in a process with little
    time and memory.

    Raises:
        ReadingError: the function's own, or the model takes too much time or memory, or
            crashes MuJoCo.
    """
    with spawned(1, _limit, abandon=True) as pool:
        try:
            model, notes = pool.submit(_compile, compiling, *arguments).result(LONGEST)
        except TimeoutError as error:
            raise ReadingError(
                f"MuJoCo has not compiled it after {LONGEST} s: leave only the robot"
            ) from error
        except (MemoryError, concurrent.futures.BrokenExecutor) as error:
            raise ReadingError(
                f"it crashes MuJoCo or takes over {MOST >> 30} GB: leave only the robot"
            ) from error
    return mujoco.MjModel.from_binary_path("robot.mjb", {"robot.mjb": model}), notes


def _compile(compiling: Compiling, *arguments: Any) -> tuple[bytes, list[str]]:
    """Return the model as the bytes of an MJB file, and the notes."""
    try:
        model, notes = compiling(*arguments)
    except ReadingError as error:
        if any(words in str(error) for words in NO_MEMORY):
            raise MemoryError from error
        raise
    size = mujoco.mj_sizeModel(model)
    if size > LARGEST:
        raise ReadingError(
            f"its compiled model has {size:,} bytes, {LARGEST:,} at most are read: leave only the robot"
        )
    if odd := [
        name
        for name in model.names.decode(errors="replace").split("\0")
        if not name.isprintable()
    ]:
        raise ReadingError(
            f"it holds the name {odd[0]!a}, which no terminal can show: choose another"
        )
    packed = np.empty(size, np.uint8)
    mujoco.mj_saveModel(model, None, packed)
    return packed.tobytes(), notes


def _limit() -> None:
    """Let this process have only `MOST` bytes beside its packages, where the system
    knows how."""
    if sys.platform == "linux":
        import resource

        used = (
            int(Path("/proc/self/statm").read_text().split()[0])
            * resource.getpagesize()
        )
        resource.setrlimit(resource.RLIMIT_AS, (used + MOST, used + MOST))
