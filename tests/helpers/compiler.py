"""The C++ of a bundle and of a page, compiled with every warning an error."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from bp2_rl.deploy.page.build import CPP, WARNINGS

STRICT = "-std=c++17", *WARNINGS, "-fno-exceptions", f"-I{CPP}"


def build(folder, source, *flags):
    """Compile a program; skip the test without a compiler."""
    compiler = shutil.which(os.environ.get("CXX", "c++"))
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    program = folder / Path(source).stem
    command = compiler, *STRICT, *flags, str(source), "-o", str(program)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program
