"""The settings of a training, as its run's config.json holds them; `presets` has the
values of each preset."""

import dataclasses
import re
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bp2_rl.base.bounds import Bounded, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.base.serialization import load_config
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.ppo import PPOConfig

Stage = Literal["imitation", "relaxed"]
Preset = Literal["smoke", "first", "cpu", "gpu"]

Weights = Literal["ours", "paper"]
RobotChoice = Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
"""A robot by its name or by the path of its robot file: `robot.named`."""
RobotFlag = Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")]
"""A `RobotChoice`, or None for a command's own default."""
TaskFlag = Annotated[str | None, tyro.conf.arg(metavar="FILE[:NAME]")]
"""A task by its file, FILE.py or FILE.py:NAME, or by package.module:NAME."""
Steps = Annotated[int, Within(1, 10**15)]
CONFIG = "config.json"
"""Name of the file in a run's folder that holds its settings."""
LARGEST_SEED = 2**32 - 1
"""Largest seed of a run: JAX takes the 32 lower bits."""


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Length of a run, its random seed, and how often it saves, logs and judges."""

    steps: Steps = 100_000_000  # control steps, summed over all robots
    seed: Annotated[int, Within(0, LARGEST_SEED)] = 0
    # saves during the run, evenly spread, the last one at its end
    checkpoints: Annotated[int, Within(1, 10**6)] = 10
    # lines of metrics.jsonl during the run
    logs: Annotated[int, Within(1, 10**9)] = 200
    judged: Annotated[int, Within(0, 10**6)] = 0
    """number of policies that the judge runs in C MuJoCo during the training, evenly
    spread: those of all saves, and more if processors are free; 0: no judge"""
    until: Annotated[
        float | None,
        Within(0.1, 100.0),
        tyro.conf.arg(prefix_name=False, metavar="M/S"),
    ] = None
    """stop when a policy reaches this speed from a stand in C MuJoCo and holds it for
    5 s"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "run.")
        if self.until is not None and not self.judged:
            raise UserError("--until needs a judge: let --run.judged be 1 or more")


@dataclasses.dataclass(frozen=True)
class Parent:
    """The run whose networks a training started from."""

    run: str  # name of its folder
    config_hash: str
    control_steps: int  # of those networks, including the parent's own parents


@dataclasses.dataclass(frozen=True)
class TrainConfig(Bounded):
    """All settings of a training run, as the run's config.json holds them."""

    stage: Stage = "imitation"
    env: EnvConfig = EnvConfig()
    ppo: PPOConfig = PPOConfig()
    run: RunConfig = RunConfig()
    impl: Impl = "jax"
    parent: Parent | None = None

    def __post_init__(self) -> None:
        """Refuse an `until` above the fastest command, which no policy reaches."""
        super().__post_init__()
        fastest = self.env.commands.max_forward
        if self.run.until is not None and self.run.until > fastest:
            raise UserError(
                f"--until {self.run.until:g} cannot be reached: the fastest command of this training is {fastest:g} "
                "m/s (--env.commands.max-forward)"
            )


def load_run_config(run_dir: Path | str) -> TrainConfig:
    """Return the settings of the run in a folder; raise `UserError` if there is no
    run."""
    require_name(run_dir)
    if not Path(run_dir).exists():
        raise UserError(f"no training run at {run_dir}: there is no such folder")
    if not (Path(run_dir) / CONFIG).is_file():
        raise UserError(f"{run_dir} is not a training run: it has no {CONFIG}")
    return load_config(TrainConfig, Path(run_dir) / CONFIG)


@dataclasses.dataclass(frozen=True)
class ClusterConfig:
    """How the processes of a training on several machines find each other; by default a
    training is one process."""

    coordinator: str | None = None
    """HOST:PORT of process 0, the same for all processes; auto: from Slurm or Open
    MPI"""
    processes: Annotated[int, Within(1, 2**16)] | None = None
    """number of processes; not with auto"""
    process: Annotated[int, Within(0)] | None = None
    """number of this process, counted from 0; not with auto"""
    patience: Annotated[float, Within(0.0, 1e6, open_below=True)] = 300.0
    """seconds to wait for the other processes at the start"""

    def __post_init__(self) -> None:
        """Raise `UserError` for settings with which processes cannot connect."""
        check_bounds(self, "--cluster.")
        numbers = (self.processes, self.process)
        if self.coordinator in (None, "auto"):
            if numbers != (None, None):
                raise UserError(
                    "--cluster.processes and --cluster.process go with --cluster.coordinator HOST:PORT"
                )
        elif not re.fullmatch(r".+:\d+", self.coordinator):
            raise UserError(
                f"--cluster.coordinator must be HOST:PORT or auto, got {self.coordinator}"
            )
        elif self.processes is None or self.process is None:
            raise UserError(
                "--cluster.coordinator HOST:PORT needs --cluster.processes and --cluster.process"
            )
        elif self.process >= self.processes:
            raise UserError(
                f"--cluster.process must be 0 to {self.processes - 1}, got {self.process}"
            )
