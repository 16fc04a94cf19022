"""Imports that leave out modules of no use here."""

import contextlib
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
