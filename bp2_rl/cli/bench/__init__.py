"""`bp2 bench`: how fast training is on this machine."""

import contextlib
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.cli import app
from bp2_rl.cli.train import (
    answer_early,
    defaults_here,
    read_named,
    unused_left_out,
    use_processors,
)
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.training import Preset, RobotWish, TrainConfig

Size = Annotated[int, Within(1, 2**24)]
OwnPart = Literal[
    "physics", "environment", "resets", "policy", "sgd", "acting", "training"
]
STEP: tuple[OwnPart, ...] = (
    "physics",
    "environment",
    "resets",
    "policy",
    "sgd",
    "training",
)


@dataclasses.dataclass(frozen=True)
class BenchArguments(Bounded, path="--"):
    """Measure how fast training is on this machine, part by part: steps a second,
    memory, compilation.

    The presets set the sizes, as for train.py.

    Examples:
        bp2 bench                               # this machine, its preset
        bp2 bench --preset cpu
    """

    preset: Preset | Literal["auto"] = "auto"
    """auto: gpu where JAX sees an accelerator, else cpu"""
    robot: RobotWish = None
    """which is simulated: built, ideal, go1 or another that ships, or a file [built]"""
    impl: Impl = "jax"
    """the physics, as for train.py"""
    robots: tuple[Size, ...] = ()
    """numbers of robots, all devices together; by default the preset's"""
    devices: tuple[Size, ...] = ()
    """numbers of devices; by default all there are"""
    parts: tuple[OwnPart, ...] = ()
    """what to measure; by default the parts of a train step, with --scaling the train
    step alone"""
    scaling: bool = False
    """measure over robots on one device, and over devices with as many robots each and
    in all; draw a picture"""
    max_robots: Size | None = None
    """with --scaling: the most robots to try; by default 8 times the preset's"""
    peer: Literal["brax", "playground"] | None = None
    """brax: also run stock Brax's acting loop on the same environment and networks, one
    device. playground: also train MuJoCo Playground's Go1 as Playground does, one
    device"""
    startup: bool = False
    """also time fresh processes up to their first policy, with an empty compilation
    cache and with a full one"""
    profile: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """leave jax.profiler's trace of two train steps here"""
    seconds: Annotated[float, Within(0.001, 3600.0)] = 2.0
    """of timed calls, for each part"""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """the report's folder [reports/bench-DATE-TIME]"""
    env: EnvConfig = EnvConfig()
    ppo: PPOConfig = PPOConfig()

    @property
    def main_robots(self) -> int:
        """The number of robots of what is measured once only."""
        return self.robots[0] if self.robots and not self.scaling else self.ppo.num_envs

    @property
    def config(self) -> TrainConfig:
        """The training that is measured."""
        return TrainConfig("imitation", self.env, self.ppo, impl=self.impl)


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, measure, and return the exit status."""
    return app.run(lambda: _bench(list(sys.argv[1:] if argv is None else argv)))


def _bench(argv: list[str]) -> None:
    answer_early(argv, "bp2 bench", _with)
    import_jax(argv)
    from bp2_rl.cli.bench.measuring import bench

    bench(argv)


def import_jax(argv: list[str]) -> None:
    """Import JAX and MuJoCo as a training with this command line does, or as
    Playground, which may want Warp."""
    playground = "--peer playground" in " ".join(argv).replace("=", " ")
    with contextlib.nullcontext() if playground else unused_left_out(read_named(argv)):
        from bp2_rl.cli import runtime  # noqa: F401  # isort: skip  # before all that imports MuJoCo
    # whose MJX may hang where XLA has more than one thread, to which importing MJX
    # keeps it
    if not playground:
        use_processors(read_named(argv))


def parse(argv: list[str]) -> BenchArguments:
    """The arguments, with the defaults of the preset that they name."""
    named = read_named(argv)
    preset, defaults = defaults_here("imitation", named.preset, robot=named.robot)
    arguments = app.parse(BenchArguments, argv, "bp2 bench", default=_with(defaults))
    return dataclasses.replace(arguments, preset=preset)


def _with(defaults: TrainConfig) -> BenchArguments:
    return BenchArguments(impl=defaults.impl, env=defaults.env, ppo=defaults.ppo)
