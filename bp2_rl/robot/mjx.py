"""MJX, imported without what it prints where the optional package Warp is missing, and
kept from hanging on CPUs."""

import contextlib
import io

from bp2_rl.base.processes import use_one_xla_thread

with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

use_one_xla_thread()

__all__ = ["mjx"]
