"""Helpers that tell whether a command refuses a user's mistake, and how."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest


class AcceptedError(Exception):
    """Raised where a command that should refuse its arguments begins to work."""


def begin(*_, **__):
    """Stand in for a command's work: raise `AcceptedError`."""
    raise AcceptedError


def is_told(error: str) -> bool:
    """Return whether standard error tells a mistake: in one line of ours, or, of a flag
    that cannot be read, in tyro's words."""
    one_line = error.startswith("error: ") and error.count("\n") == 1
    return one_line or ("error: " not in error and "Traceback" not in error)


def refused(
    capsys: pytest.CaptureFixture[str],
    main: Callable[[Sequence[str]], int],
    *arguments: object,
) -> str:
    """Require that a command refuses the arguments with exit status 2 and leaves the
    working directory's files as they were; return what it says."""
    before = _files()
    capsys.readouterr()
    assert main([*map(str, arguments)]) == 2
    errors = capsys.readouterr().err
    assert is_told(errors)
    assert _files() == before
    return errors


def _files() -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def python(folder, *words: str) -> tuple[int, str, str]:
    """Run Python in a folder; return its exit status, output and errors."""
    line = [sys.executable, *words]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr
