"""Settings of JAX that must be made before its backend starts."""

import os
import subprocess
import sys

WATCHED = """
import os, sys
from bp2_rl.cli import train
import jax.numpy as jnp
from jax._src import xla_bridge  # JAX has no public way to ask
from bp2_rl.learning import cluster, run
cluster.join = lambda config: print(xla_bridge.backends_are_initialized(), os.environ.get("XLA_FLAGS"))
run.start = lambda *_, **__: print(jnp.ones(2).sum())
sys.exit(train.main(["--preset", "smoke", *sys.argv[1:]]))
"""


def launch(*arguments):
    environment = {
        **os.environ,
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
    }
    command = [sys.executable, "-c", WATCHED, *arguments]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout


def test_deterministic_reaches_xla_before_it_starts_and_leaves_other_flags_alone():
    ours = "False --xla_force_host_platform_device_count=2"
    # XLA knows the flag
    assert f"{ours} --xla_gpu_deterministic_ops=true\n" in launch("--deterministic")


def test_a_platform_that_is_not_there_is_one_line_and_status_2(tmp_path):
    program = """
from bp2_rl.cli.__main__ import main
print([main([command, "--preset", "smoke"]) for command in ("train", "bench")])
"""
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "JAX_PLATFORMS": "nowhere"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert ended.stdout == "[2, 2]\n", ended.stderr
    for line in (lines := ended.stderr.splitlines()):
        assert line.startswith("error: JAX finds no device of JAX_PLATFORMS=nowhere: ")
    assert len(lines) == 2
    assert list(tmp_path.iterdir()) == []
