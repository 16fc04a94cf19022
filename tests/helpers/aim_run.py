"""`train.py` as a program of its own, on a stand-in for the robot that compiles in seconds."""

import sys
import time
from functools import partial

from aim import StandIn

from bp2_rl.cli import train as command
from bp2_rl.learning import checkpoint, train
from bp2_rl.learning.ppo import PPO

SMALL = [
    "--preset", "smoke", "--ppo.num-envs", "16", "--ppo.unroll-length", "4", "--ppo.num-minibatches", "2",
    "--ppo.policy-layers", "16", "--ppo.value-layers", "16",
]  # fmt: skip


def slowly(function, seconds, *args):
    time.sleep(seconds)
    return function(*args)


def main(argv: list[str]) -> int:
    """`aim_run.py SECONDS ARGUMENTS`: as `train.py ARGUMENTS`, with every step and each of 4 waits of a save slower."""

    def make_learner(config):
        learner = PPO(StandIn(), config.ppo)
        learner.train_step = partial(slowly, learner.train_step, pause)  # pyright: ignore[reportAttributeAccessIssue]
        return learner

    pause = float(argv[0])
    train.make_learner = make_learner
    checkpoint._sync = partial(slowly, checkpoint._sync, min(pause, 0.05))
    return command.main(argv[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
