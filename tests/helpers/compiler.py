"""The C++ of a bundle and of a page, compiled with every warning an error."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bp2_rl.deploy.page.build import CPP, WARNINGS

STRICT = "-std=c++17", *WARNINGS, "-fno-exceptions", f"-I{CPP}"
CLANG = sys.executable, "-m", "ziglang", "c++"


def build(folder, source, *flags):
    """Compile a program; skip the test without a compiler."""
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    return _compile((compiler,), source, folder / Path(source).stem, flags)


def build_with_clang(folder, source, *flags):
    """Compile an object with clang; skip the test without one."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip('needs the package ziglang: pip install -e ".[dev]"')
    return _compile(CLANG, source, folder / "object.o", ("-c", *flags))


def _compile(compiler, source, program, flags):
    command = *compiler, *STRICT, *flags, str(source), "-o", str(program)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program
