"""Compiled programs, kept on disk for the next process."""

import contextlib
import os
from pathlib import Path

import jax


def keep_compiled() -> Path | None:
    """Let JAX keep compiled programs on disk; return the folder of traced programs,
    None where it cannot be written.

    Both lie in $BP2_CACHE, else in the folder bp2_rl of $XDG_CACHE_HOME or ~/.cache.
    Where JAX has been told a folder before, by $JAX_COMPILATION_CACHE_DIR for one, JAX
    keeps its programs there.
    """
    # Without a home or a disk that can be written, only the time of the next
    # compilation is lost.
    with contextlib.suppress(OSError, RuntimeError):
        default = (
            Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bp2_rl"
        )
        cache = Path(os.environ.get("BP2_CACHE") or default)
        (cache / "jax").mkdir(parents=True, exist_ok=True)
        if jax.config.values["jax_compilation_cache_dir"] is None:
            jax.config.update("jax_compilation_cache_dir", str(cache / "jax"))
        return cache / "programs"
    return None
