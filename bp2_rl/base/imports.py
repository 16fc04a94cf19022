"""Imports that leave out modules, and a GL library, of no use here."""

import contextlib
import os
import sys
from collections.abc import Generator
from typing import Any


@contextlib.contextmanager
def left_out(*names: str) -> Generator[None]:
    """Let nothing import these modules meanwhile, as if they were not installed; those
    imported before stay."""
    unwanted = [name for name in names if name not in sys.modules]
    # None is Python's way to say that a module cannot be imported
    nothing: dict[str, Any] = dict.fromkeys(unwanted)
    sys.modules.update(nothing)
    try:
        yield
    finally:
        for name in unwanted:
            del sys.modules[name]


@contextlib.contextmanager
def without_gl_library() -> Generator[None]:
    """Hide the GL library that MUJOCO_GL names while MuJoCo is imported, here or in a
    process that begins meanwhile.

    MuJoCo binds it when imported, and fails if it is not there; only films need one, in
    a process of their own.
    """
    library = os.environ.pop("MUJOCO_GL", None)
    try:
        yield
    finally:
        if library is not None:
            os.environ["MUJOCO_GL"] = library
