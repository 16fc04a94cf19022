"""Train a slow trot, in one to two minutes on two idle processors.

    python examples/slow_trot.py

This does in Python what `python train.py --stage imitation --preset first` does: it
makes settings, trains a run, and reads its metrics.
"""

import dataclasses
from pathlib import Path

import bp2_rl as bp2
from bp2_rl.learning.writers import read_metrics
from bp2_rl.settings.training import TrainConfig


def settings() -> TrainConfig:
    """Return the preset `first`, with commands of at most 1.5 m/s instead of 2."""
    config = bp2.preset("imitation", "first")
    slow = dataclasses.replace(config.env.commands, max_forward=1.5)
    return dataclasses.replace(
        config, env=dataclasses.replace(config.env, commands=slow)
    )


def train(config: TrainConfig, folder: Path) -> list[dict[str, float]]:
    """Train a run in a new folder; return the records of its metrics, without the
    judge's."""
    # A run is a folder: settings, metrics, checkpoints, and a policy at every save.
    # `bp2.resume` continues a killed run.
    bp2.train(config, folder)
    return [line for line in read_metrics(folder) if "reward" in line]


def main() -> None:
    """Train, and print the reward and its largest terms at the beginning and the
    end."""
    folder = Path("runs/slow_trot")
    lines = train(settings(), folder)
    for line in (lines[0], lines[-1]):
        terms = {
            name: line[f"reward/{name}"]
            for name in ("joint_position", "joint_velocity", "tracking")
        }
        said = ", ".join(f"{name} {value:.3f}" for name, value in terms.items())
        print(
            f"train step {line['step']}: reward {line['reward']:.3f}, of it {said}; falls {line['falls']:.1%}"
        )
    print(f"watch it: python examples/watch.py {folder}")


if __name__ == "__main__":
    main()
