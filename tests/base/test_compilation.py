"""Compiled programs are kept where they are asked to be, for the commands and for
Python alike."""

import os
import subprocess
import sys

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


def environment(**variables):
    ours = ("BP2_CACHE", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
    return {
        name: value for name, value in os.environ.items() if name not in ours
    } | variables


def said(code, cwd, **variables):
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment(**variables),
        cwd=cwd,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_the_cache_is_in_the_home_unless_the_environment_names_another(tmp_path):
    home, other = tmp_path / "home", tmp_path / "other"
    default = f"{home}/.cache/bp2_rl"
    assert said(KEPT, tmp_path, HOME=str(home)) == [
        f"{default}/programs",
        f"{default}/jax",
    ]
    assert said(KEPT, tmp_path, BP2_CACHE=str(other)) == [
        f"{other}/programs",
        f"{other}/jax",
    ]
    assert said(KEPT, tmp_path, XDG_CACHE_HOME=str(other)) == [
        f"{other}/bp2_rl/programs",
        f"{other}/bp2_rl/jax",
    ]


def test_a_folder_that_jax_was_told_remains_jaxs(tmp_path):
    told = said(
        KEPT,
        tmp_path,
        BP2_CACHE=str(tmp_path / "ours"),
        JAX_COMPILATION_CACHE_DIR="theirs",
    )
    assert told == [f"{tmp_path}/ours/programs", "theirs"]


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
