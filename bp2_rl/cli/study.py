"""`bp2 study`: compare recipes over seeds, each saved policy judged in C MuJoCo."""

import dataclasses
import os
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import RunStopped, UserError
from bp2_rl.base.files import require_name, write_text
from bp2_rl.base.serialization import save_config
from bp2_rl.cli.app import Command, listed
from bp2_rl.settings.jobs import JobsConfig
from bp2_rl.settings.training import LARGEST_SEED, Preset, RobotChoice, Steps
from bp2_rl.tools.study.plan import VARIANTS, Plan, default_steps, label

SCREEN = """usage: {prog} [FLAGS]

{what}

flags:
  --variants NAME ...   variants of the list below, or task files FILE.py [all]
  --seeds INT ...       random seeds, one training each [0 1 2]
  --preset {gpu,cpu,first,smoke}
                        size of the trainings [gpu]
  --robot NAME|FILE     the robot, as for train.py [built]
  --steps INT INT       control steps of the imitation and of the relaxed stage
  --out DIR             the study's folder [runs/study]
  --judges INT          processes that judge policies during the trainings
  --jobs.executor {here,slurm,local}
                        here: this machine; slurm: a Slurm job for each
                        training; local: jobs on this machine, to test them [here]
  --no-train            only summarise the finished trainings

variants:
{variants}

all flags, with --jobs.*: {prog} --help-all

examples:
  bp2 study --variants ours kinematic --seeds 0 1 2
  bp2 study --variants ours my_task.py   # compare a task with the recipe""".replace(
    "{variants}",
    listed({name: variant.meaning for name, variant in VARIANTS.items()}),
)
"""What `--help` prints."""


@dataclasses.dataclass(frozen=True)
class StudyArguments(Bounded, path="--"):
    """Train variants of the recipe with several seeds, judge every saved policy in C
    MuJoCo, and compare the variants.

    Each GPU runs one training at a time; a cluster runs each training as a job. The
    same command continues an interrupted study. The table grows as trainings end.
    """

    variants: tuple[str, ...] = tuple(VARIANTS)
    """variants of the recipe (listed by --help), or task files FILE.py"""
    seeds: tuple[Annotated[int, Within(0, LARGEST_SEED)], ...] = (0, 1, 2)
    preset: Preset = "gpu"
    """size of the trainings"""
    robot: RobotChoice = "built"
    """the robot, as for train.py"""
    steps: tuple[Steps, Steps] | None = None
    """control steps of the imitation and of the relaxed stage; by default the
    preset's"""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/study")
    """the study's folder"""
    judges: Annotated[int, Within(1, 1024)] = max(1, (os.cpu_count() or 2) // 2)
    """processes that judge policies during the trainings"""
    jobs: JobsConfig = JobsConfig()
    train: bool = True
    """--no-train: only summarise the finished trainings"""


def _study(arguments: StudyArguments) -> None:
    require_name(arguments.out)
    arguments.jobs.require()
    steps = arguments.steps or default_steps(arguments.preset)
    plan = Plan(
        arguments.variants, arguments.seeds, arguments.preset, steps, arguments.robot
    )

    from bp2_rl.cli import runtime  # isort: skip  # before all that imports MuJoCo
    from bp2_rl.base.plotting import save_figure
    from bp2_rl.tools.study.outcome import (
        Outcome,
        draw_learning_curves,
        outcome_of,
        outcome_table,
    )
    from bp2_rl.tools.study.running import Resources, run_study, visible_gpus

    def tabulate() -> list[Outcome]:
        outcomes = [
            outcome
            for variant in plan.variants
            if (outcome := outcome_of(arguments.out, variant, plan.seeds))
        ]
        for outcome in outcomes:
            save_config(arguments.out / f"{label(outcome.variant)}.json", outcome)
        if outcomes:
            write_text(arguments.out / "table.md", outcome_table(outcomes))
        return outcomes

    missing = []
    if arguments.train:
        gpus = visible_gpus()
        if arguments.jobs.executor == "here" and not gpus:
            runtime.require_accelerator(arguments.preset)
        where = f"{len(gpus)} GPU{'s' * (len(gpus) != 1)}" if gpus else "the processors"
        if arguments.jobs.executor != "here":
            where = (
                f"{arguments.jobs.executor}, at most {arguments.jobs.most} at a time"
            )
        print(f"{sum(map(len, plan.chains))} trainings on {where}")
        resources = Resources(gpus, arguments.judges, print, arguments.jobs)
        missing = run_study(
            plan, arguments.out, resources, measured=lambda _: tabulate()
        )
    outcomes = tabulate()
    if outcomes:
        save_figure(
            draw_learning_curves(arguments.out, plan.variants, plan.seeds),
            arguments.out / "learning_curves.png",
        )
        print(outcome_table(outcomes))
        if fallen := [
            outcome.variant for outcome in outcomes if not any(outcome.top_speeds)
        ]:
            print(
                f"all last policies of {', '.join(fallen)} fell in every launch: 0.00 is no speed, and no comparison"
            )
        print(f"figure: {arguments.out / 'learning_curves.png'}")
    elif not arguments.train:
        raise UserError(
            f"{arguments.out} holds no judged run of {', '.join(plan.variants)}"
        )
    if missing:
        names = ", ".join(training.name for training in missing)
        raise RunStopped(f"not trained: {names}; call again to go on", status=1)


main = Command("bp2 study", StudyArguments, _study, screen=SCREEN)
