"""`train.py` as a program of its own, on a stand-in for the robot that compiles in
seconds."""

import dataclasses
import json
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from aim import StandIn

from bp2_rl.base import files
from bp2_rl.cli import train
from bp2_rl.learning import run
from bp2_rl.learning.checkpoint import CHECKPOINTS
from bp2_rl.learning.ppo import PPO
from bp2_rl.settings.presets import preset
from bp2_rl.settings.training import Stage, TrainConfig

HELPERS = Path(__file__).parent
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{HELPERS.parents[1]}:{HELPERS}"}
PROGRAM = """
import sys
sys.modules["warp"] = None  # MJX imports it for 2 s, and no training here uses it
import aim_run
sys.exit(aim_run.main(sys.argv[1:]))
"""
SMALL = [
    "--preset",
    "smoke",
    "--ppo.num-envs",
    "16",
    "--ppo.unroll-length",
    "4",
    "--ppo.num-minibatches",
    "2",
    "--ppo.policy-layers",
    "16",
    "--ppo.value-layers",
    "16",
]
CLOCKS = ("wall_time", "steps_per_second")
"""Metrics that differ between two equal runs."""


def small(stage: Stage = "imitation", **run: Any) -> TrainConfig:
    """Settings of a run with the sizes of `SMALL`; `run` are fields of `RunConfig`."""
    config = preset(stage, "smoke")
    ppo = dataclasses.replace(
        config.ppo,
        num_envs=16,
        unroll_length=4,
        num_minibatches=2,
        policy_layers=(16,),
        value_layers=(16,),
    )
    return dataclasses.replace(
        config, ppo=ppo, run=dataclasses.replace(config.run, **run)
    )


def metrics(run: Path) -> list[dict[str, Any]]:
    """Return the lines of a run's metrics.jsonl as dictionaries, without the clocks."""
    lines = (run / "metrics.jsonl").read_text().splitlines()
    return [
        {name: value for name, value in json.loads(line).items() if name not in CLOCKS}
        for line in lines
    ]


def command(*arguments, pause=0.0):
    """Return the command line that starts this program; `pause` is for `main`."""
    return [sys.executable, "-c", PROGRAM, str(pause), *map(str, arguments)]


def begin(*arguments, pause=0.0, cwd=None, **environment):
    """Start this program in a process of its own, with pipes for what it prints."""
    return subprocess.Popen(
        command(*arguments, pause=pause),
        cwd=cwd,
        env={**ENVIRONMENT, "COLUMNS": "200", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def slowly(function, seconds, *args):
    time.sleep(seconds)
    return function(*args)


def sync_slowly(sync, seconds, path):
    if CHECKPOINTS in path.parts:
        time.sleep(seconds)
    sync(path)


def main(argv: list[str]) -> int:
    """Run as `train.py` with the arguments after the first, the seconds by which start,
    steps and waits of a save are slower."""

    def make_learner(config, _=None):
        learner = PPO(StandIn(), config.ppo)
        learner.init = partial(slowly, learner.init, min(pause, 2.0))  # pyright: ignore[reportAttributeAccessIssue]
        learner.train_step = partial(slowly, learner.train_step, pause)  # pyright: ignore[reportAttributeAccessIssue]
        return learner

    pause = float(argv[0])
    run.make_learner = make_learner
    files.sync = partial(sync_slowly, files.sync, min(pause, 0.05))
    return train.main(argv[1:])
