"""The controller in C++ answers as the one in Python, tick by tick and fault by fault."""

import re
import shutil
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bp2_rl.deploy import bundle as package

CPP, HERE = Path(package.__file__).parent / "cpp", Path(__file__).parent
STRICT = "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fno-exceptions", f"-I{CPP}"
DT = 0.005
CLOSE = 1e-5  # rad and rad/s: the network's float32, which sums in another order
PARTS = slice(0, 12), slice(12, 24), slice(24, 27), slice(27, 30)
TICK = np.dtype(
    [
        ("told", "f8"),
        ("now", "f8"),
        ("values", "f8", 30),
        ("stamp", "f8"),
        ("command", "f8", 3),
    ]
)
ANSWER = np.dtype(
    [
        ("targets", "f8", (2, 12)),
        ("cpu", "f8"),
        ("allocated", "f8"),
        ("share", "f8"),
        ("fault", "S16"),
        ("joint", "S16"),
    ]
)
MEASURED, COMMANDED, RESET = 1, 2, 4


def build(folder, source, *flags):
    """Compile a program of the C++ controller; skip the test without a compiler."""
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    program = folder / Path(source).stem
    command = compiler, *STRICT, *flags, str(source), "-o", str(program)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return build(tmp_path_factory.mktemp("drive"), HERE / "drive.cpp", "-O3")


def answers(program, folder, ticks, convention="bundle"):
    """Return what the C++ controller of a bundle answers to ticks."""
    command = program, folder / "cpp" / "controller.bin", convention
    done = subprocess.run(
        command, input=ticks.tobytes(), capture_output=True, check=True
    )
    assert done.stderr == b""
    return np.frombuffer(done.stdout, ANSWER)


class Recorder:
    """Steps the Python controller, and records what it is told and what it answers."""

    def __init__(self, controller):
        self.controller, self.ticks, self.expected = controller, [], []

    def reset(self):
        self.controller.reset()
        self._flag = RESET

    def step(self, values, stamp, command, now):
        told = (
            self._flag
            | MEASURED * (values is not None)
            | COMMANDED * (command is not None)
        )
        given = None if values is None else (*(values[part] for part in PARTS), stamp)
        nothing = np.zeros(30) if values is None else values
        asked = np.zeros(3) if command is None else command
        self.ticks.append((told, now, nothing, stamp, asked))
        targets, self._flag = self.controller.step(given, command, now), 0
        self.expected.append((np.stack(targets), self.controller.fault))
        return targets

    def compare(self, program, folder, convention="bundle"):
        """Require the same targets, and the same faults at the same ticks; return the
        faults' names."""
        ticks = np.array(self.ticks, TICK)
        found = answers(program, folder, ticks, convention)
        targets, faults = zip(*self.expected, strict=True)
        assert len(found) == len(ticks)
        np.testing.assert_allclose(
            found["targets"], np.stack(targets), rtol=0.0, atol=CLOSE
        )
        for answer, fault in zip(found, faults, strict=True):
            name, joint = answer["fault"].decode(), answer["joint"].decode()
            assert fault.partition(":")[0] == name
            assert fault.startswith(f"{name}: {joint}" if name else "")
        assert not found["allocated"].any()
        return {fault.partition(":")[0] for fault in faults}
