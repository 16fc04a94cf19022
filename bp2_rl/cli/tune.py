"""`bp2 tune`: search for better settings with Optuna, judged in C MuJoCo."""

import dataclasses
import importlib.util
import os
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import RunStopped, UserError, not_installed
from bp2_rl.base.files import require_name, write_text
from bp2_rl.cli.dispatch import Command
from bp2_rl.cli.train import answer_early, train_arguments
from bp2_rl.settings import presets
from bp2_rl.settings.jobs import JobsConfig
from bp2_rl.settings.training import LARGEST_SEED, Preset, RobotChoice, Steps
from bp2_rl.tools.tuning.space import parse_dimension

SEARCH = (
    "ppo.learning-rate=1e-4:1e-3:log",
    "ppo.entropy-cost=5e-4:1e-2:log",
    "env.reward.tracking=0.5:3",
)


@dataclasses.dataclass(frozen=True)
class TuneArguments(Bounded, path="--"):
    """Search for settings of the imitation stage with which a policy runs faster,
    judged in C MuJoCo.

    Optuna proposes, and keeps what it knows in DIR/tune.db. Stopped, the search goes on
    where it stands when called again.

    Examples:
        bp2 tune --search ppo.learning-rate=1e-4:1e-3:log env.reward.tracking=0.5:3
    """

    search: tuple[str, ...] = SEARCH
    """FLAG=LOW:HIGH, FLAG=LOW:HIGH:log or FLAG=A,B,C, with flags of train.py"""
    trials: Annotated[int, Within(1, 10**6)] = 20
    """in all, those of earlier calls included"""
    preset: Preset = "gpu"
    """size of the trainings"""
    robot: RobotChoice = "built"
    """which is trained and judged, as for train.py"""
    steps: Steps | None = None
    """control steps of a trial; by default the preset's"""
    seed: Annotated[int, Within(0, LARGEST_SEED)] = 0
    """of every trial, and of the search"""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/tune")
    """the search's folder"""
    judges: Annotated[int, Within(1, 1024)] = max(1, (os.cpu_count() or 2) // 2)
    """processes that judge policies while others train"""
    jobs: JobsConfig = JobsConfig()


def _tune(arguments: TuneArguments) -> None:
    require_name(arguments.out)
    space = tuple(parse_dimension(text) for text in arguments.search)
    if len({one.flag for one in space}) < len(space) or not space:
        raise UserError("--search takes one flag or more, and each once")
    for one in space:
        for value in one.extremes:  # what train.py would refuse is refused here
            words = [
                "--preset",
                arguments.preset,
                "--robot",
                arguments.robot,
                f"--{one.flag}",
                value,
            ]
            answer_early(words, "bp2 train", train_arguments)
    if importlib.util.find_spec("optuna") is None:
        raise not_installed("bp2 tune", "optuna", "tune")
    arguments.jobs.require()

    from bp2_rl.cli import runtime  # isort: skip  # before all that imports MuJoCo
    from bp2_rl.tools.study.places import Resources, visible_gpus
    from bp2_rl.tools.tuning.search import Search, run

    steps = arguments.steps or presets.preset("imitation", arguments.preset).run.steps
    search = Search(space, arguments.preset, arguments.robot, steps, arguments.seed)
    resources = Resources(visible_gpus(), arguments.judges, print, arguments.jobs)
    if arguments.jobs.executor == "here" and not resources.gpus:
        runtime.require_accelerator(arguments.preset)
    ranked = run(search, arguments.out, arguments.trials, resources)
    speeds = [
        "-" if one.top_speed is None else f"{one.top_speed:.2f}" for one in ranked
    ]
    lines = [
        f"| {one.number} | {speed} | {' '.join(one.flags)} |"
        for one, speed in zip(ranked, speeds, strict=True)
    ]
    table = "\n".join(
        ["| trial | top speed [m/s] | flags |", "| ---: | ---: | --- |", *lines, ""]
    )
    write_text(arguments.out / "table.md", table)
    print(table)
    if ranked[0].top_speed is None:
        raise RunStopped(
            f"no trial was trained to its end: see {arguments.out}/trial-*.txt",
            status=1,
        )
    if ranked[0].top_speed == 0.0:
        raise RunStopped(
            "all policies fell in every launch, so no trial is better than another: let --steps be more, "
            "or take a larger --preset",
            status=1,
        )
    print(f"python train.py --preset {arguments.preset} {' '.join(ranked[0].flags)}")


main = Command("bp2 tune", TuneArguments, _tune)
