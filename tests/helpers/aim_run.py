"""`train.py` as a program of its own, on a stand-in for the robot that compiles in
seconds."""

import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

from aim import StandIn

from bp2_rl.base import files
from bp2_rl.cli import train
from bp2_rl.learning import run
from bp2_rl.learning.checkpoint import CHECKPOINTS
from bp2_rl.learning.ppo import PPO

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
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


def command(*arguments, pause=0.0):
    """What starts a process of it; `pause` is for `main`."""
    return [sys.executable, __file__, str(pause), *map(str, arguments)]


def begin(*arguments, pause=0.0, cwd=None, **environment):
    """Start a process of it, with pipes for what it prints."""
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
    """`aim_run.py SECONDS ARGUMENTS`: as `train.py ARGUMENTS`, with start, steps and
    waits of a save slower."""

    def make_learner(config, _=None):
        learner = PPO(StandIn(), config.ppo)
        learner.init = partial(slowly, learner.init, min(pause, 2.0))  # pyright: ignore[reportAttributeAccessIssue]
        learner.train_step = partial(slowly, learner.train_step, pause)  # pyright: ignore[reportAttributeAccessIssue]
        return learner

    pause = float(argv[0])
    run.make_learner = make_learner
    files.sync = partial(sync_slowly, files.sync, min(pause, 0.05))
    return train.main(argv[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
