"""MJX, imported without what it prints on import of the optional package Warp that is missing."""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

__all__ = ["mjx"]
