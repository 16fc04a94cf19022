"""`bp2 bench`: how fast training is on this machine."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.cli import app
from bp2_rl.cli.train import EarlyFlags, find_preset, read_early_flags, start_jax
from bp2_rl.settings import presets
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.training import ClusterConfig, Preset, RobotFlag, TrainConfig

PROG = "bp2 bench"
Size = Annotated[int, Within(1, 2**24)]
Part = Literal["physics", "environment", "resets", "policy", "sgd", "training"]
"""`tools.throughput.PartName`, which can be imported only once JAX is set up."""
SCREEN = """usage: {prog} [FLAGS]

{what}

flags:
  --preset {gpu,cpu,first,smoke,auto}
                        auto: gpu if JAX finds an accelerator, else cpu [auto]
  --robot NAME|FILE     built, ideal, go1, ... or a robot file [built]
  --impl {kernel,jax,warp}
                        the physics, as for train.py
  --robots INT ...      numbers of robots, summed over devices [the preset's]
  --devices INT ...     numbers of devices [all]
  --parts NAME ...      physics, environment, resets, policy, sgd, training [all]
  --seconds FLOAT       duration of the timing of each part, s [2]
  --out DIR             the report's folder [reports/bench-DATE-TIME]

all flags, with --env.* and --ppo.*: {prog} --help-all

examples:
  bp2 bench                               # the preset for this machine
  bp2 bench --preset cpu"""
"""What `--help` prints."""


@dataclasses.dataclass(frozen=True)
class BenchArguments(Bounded, path="--"):
    """Measure the speed of training on this machine, part by part: steps per second,
    memory, compilation time."""

    preset: Preset | Literal["auto"] = "auto"
    """auto: gpu if JAX finds an accelerator, else cpu"""
    robot: RobotFlag = None
    """built, ideal, go1, ... or a robot file [built]"""
    impl: Impl = "jax"
    """the physics, as for train.py"""
    robots: tuple[Size, ...] = ()
    """numbers of robots, summed over devices [the preset's]"""
    devices: tuple[Size, ...] = ()
    """numbers of devices [all]"""
    parts: tuple[Part, ...] = get_args(Part)
    """what to measure"""
    seconds: Annotated[float, Within(0.001, 3600.0)] = 2.0
    """duration of the timing of each part, s"""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """the report's folder [reports/bench-DATE-TIME]"""
    env: EnvConfig = EnvConfig()
    ppo: PPOConfig = PPOConfig()

    @property
    def config(self) -> TrainConfig:
        """Settings of the training that is timed."""
        return TrainConfig("imitation", self.env, self.ppo, impl=self.impl)


def main(words: Sequence[str]) -> int:
    """Parse the flags, time the training, and return the exit status."""
    return app.run(lambda: _bench(words))


def _bench(words: Sequence[str]) -> None:
    flags = read_early_flags(words, PROG, SCREEN, BenchArguments)
    defaults_known = app.HELP_ALL in words or flags.known_without_jax
    arguments = read_arguments(words, flags) if defaults_known else None
    # the flags of a cluster are refused below
    start_jax(dataclasses.replace(flags, cluster=ClusterConfig()))
    from bp2_rl.cli.runtime import require_accelerator
    from bp2_rl.tools.bench import run_bench

    arguments = arguments or read_arguments(words, flags)
    require_accelerator(arguments.preset)
    run_bench(
        arguments.config,
        choose_sizes(arguments),
        arguments.parts,
        arguments.seconds,
        arguments.out or app.dated_folder("bench"),
    )


def read_arguments(words: Sequence[str], flags: EarlyFlags) -> BenchArguments:
    """Return all arguments of the command line; defaults come from its preset and
    robot."""
    preset = find_preset(flags)
    defaults = presets.preset("imitation", preset, robot=flags.robot or "built")
    default = BenchArguments(impl=defaults.impl, env=defaults.env, ppo=defaults.ppo)
    arguments = app.parse(BenchArguments, words, PROG, default)
    return dataclasses.replace(arguments, preset=preset)


def choose_sizes(arguments: BenchArguments) -> tuple[tuple[int, int], ...]:
    """Return each combination of robots and devices that is timed, once.

    Raises:
        UserError: there are fewer devices than asked for.
    """
    import jax

    available = jax.device_count()
    if max(arguments.devices, default=1) > available:
        raise UserError(f"--devices {max(arguments.devices)}: JAX sees {available}")
    sizes = {
        (robots, devices): None
        for robots in arguments.robots or (arguments.ppo.num_envs,)
        for devices in arguments.devices or (available,)
    }
    return tuple(sizes)
