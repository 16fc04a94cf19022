"""Compiled code is kept in the folder that is asked for, and workers end with the
process that started them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bp2_rl.base.processes import PARENT

# --- Compiled programs are kept where they are asked to be ----------------------------
KEPT = """
import jax, bp2_rl
from bp2_rl.base.processes import keep_compiled
print(keep_compiled(), jax.config.values["jax_compilation_cache_dir"])
"""
LATE = """
import jax.numpy as jnp
jnp.ones(3).sum()  # compiled before there is a cache
from bp2_rl.base.processes import keep_compiled
keep_compiled()
jnp.ones(5).prod()
"""
TRAINED = """
import jax, bp2_rl as bp2
from bp2_rl.learning import run
run.start = run.resume = lambda *_, programs, **__: print(programs, jax.config.values["jax_compilation_cache_dir"])
bp2.train(bp2.preset("imitation", "smoke"), "run")
"""
RUN = """
import jax, bp2_rl as bp2
bp2.rollout(bp2.load_policy("built"), bp2.Ramp(1.0, hold=0.1))
print(jax.config.values["jax_compilation_cache_dir"])
"""


CACHES = {"BP2_CACHE", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME"}


def said(code, cwd, **variables):
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={name: os.environ[name] for name in os.environ.keys() - CACHES} | variables,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


@pytest.mark.parametrize(
    ("variables", "programs", "compiled"),
    [
        ({"HOME": "home"}, "home/.cache/bp2_rl/programs", "home/.cache/bp2_rl/jax"),
        ({"BP2_CACHE": "a"}, "a/programs", "a/jax"),
        ({"XDG_CACHE_HOME": "a"}, "a/bp2_rl/programs", "a/bp2_rl/jax"),
        (
            {"BP2_CACHE": "a", "JAX_COMPILATION_CACHE_DIR": "theirs"},
            "a/programs",
            "theirs",
        ),
    ],
)
def test_the_cache_is_in_the_home_unless_the_environment_names_another(
    tmp_path, variables, programs, compiled
):
    places = {name: f"{tmp_path}/{place}" for name, place in variables.items()}
    assert said(KEPT, tmp_path, **places) == [
        f"{tmp_path}/{programs}",
        f"{tmp_path}/{compiled}",
    ]


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path):
    (tmp_path / "file").write_text("")
    assert said(KEPT, tmp_path, BP2_CACHE=str(tmp_path / "file")) == ["None", "None"]


def test_what_was_compiled_before_keeps_nothing_from_being_kept(tmp_path):
    said(
        LATE,
        tmp_path,
        BP2_CACHE=str(tmp_path),
        JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0",
    )
    assert list((tmp_path / "jax").glob("*prod*-cache"))


def test_trainings_and_runs_in_python_use_the_cache_of_the_commands(tmp_path):
    assert said(TRAINED, tmp_path, BP2_CACHE=str(tmp_path)) == [
        f"{tmp_path}/programs",
        f"{tmp_path}/jax",
    ]
    assert said(RUN, tmp_path, BP2_CACHE=str(tmp_path)) == [f"{tmp_path}/jax"]


# --- Workers ----------------------------------------------------------------------------
WORK = """
import ctypes, os

def work(_):
    print(os.getpid(), flush=True)
    ctypes.PyDLL(None).sleep(600)  # a solver that never lets Python run
"""
POOL = """
from bp2_rl.base.processes import spawned
from work import work

with spawned(2) as pool:  # without `if __name__ == "__main__"`: workers do not run the script again
    list(pool.map(work, range(2)))
"""
INTERRUPTED = """
import time
from bp2_rl.base.processes import spawned
from bp2_rl.cli import app

def command():
    with spawned(2) as pool:
        list(pool.map(abs, range(2)))
        print("began", flush=True)
        list(pool.map(time.sleep, [60.0] * 8))

raise SystemExit(app.run(command))
"""
CHILD = """
import os, signal, sys, time
from bp2_rl.base.processes import end_with_caller

def save(*_):
    time.sleep(0.5)
    open("saved", "w").close()
    sys.exit()

signal.signal(signal.SIGTERM, save)
end_with_caller()
print(os.getpid(), "BP2_PARENT" in os.environ, flush=True)
time.sleep(600)
"""
ROOT = Path(__file__).parents[2]


def begin(*command, environment=None, **how):
    return subprocess.Popen(
        [sys.executable, *map(str, command)],
        env={**os.environ, "PYTHONPATH": str(ROOT), **(environment or {})},
        stdout=subprocess.PIPE,
        text=True,
        **how,
    )


def is_running(process):
    try:
        return (
            Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
            != "Z"
        )
    except OSError:
        return False


def wait_until(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_workers_end_with_a_killed_parent_even_in_the_midst_of_a_solver(tmp_path):
    script = tmp_path / "pool.py"
    script.write_text(POOL)
    (tmp_path / "work.py").write_text(WORK)
    with begin(script) as parent:
        assert parent.stdout is not None
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        assert all(map(is_running, workers))
        parent.kill()
        wait_until(lambda: not any(map(is_running, workers)))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
@pytest.mark.parametrize(
    ("number", "line"),
    [(15, "stopped by SIGTERM\n"), (2, "interrupted\n"), (1, "stopped by SIGHUP\n")],
)
def test_a_signal_to_the_whole_group_ends_it_at_once_in_one_line(number, line):
    """A terminal, `timeout` and schedulers send it to the workers as well."""
    heeded = "import signal; signal.signal(2, signal.default_int_handler); signal.signal(1, signal.SIG_DFL)"
    code = heeded + INTERRUPTED  # both may be ignored here
    with begin("-c", code, start_new_session=True, stderr=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "began\n"
        os.killpg(parent.pid, number)
        _, said = parent.communicate(timeout=30)
    assert (parent.returncode, said) == (128 + number, line)


def test_a_command_is_asked_to_end_when_its_parent_is_killed(tmp_path):
    """And passes nothing of that on to its own children."""
    script, parent_script = tmp_path / "child.py", tmp_path / "parent.py"
    script.write_text(CHILD)
    parent_script.write_text(
        f"import os, subprocess, sys\n"
        f"subprocess.run([sys.executable, {str(script)!r}], env=os.environ | {{{PARENT!r}: str(os.getpid())}}, "
        f"cwd={str(tmp_path)!r})\n"
    )
    with begin(parent_script) as parent:
        assert parent.stdout is not None
        child, passed_on = parent.stdout.readline().split()
        assert passed_on == "False"
        parent.kill()
        wait_until((tmp_path / "saved").exists)
        wait_until(lambda: not is_running(int(child)))


def test_a_command_whose_parent_has_ended_already_ends_at_once(tmp_path):
    with begin("-c", CHILD, cwd=tmp_path, environment={PARENT: "1"}) as orphan:
        output, _ = orphan.communicate(timeout=30)
    assert (tmp_path / "saved").exists()
    assert output == ""
    assert orphan.returncode == 0
