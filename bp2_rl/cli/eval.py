"""`bp2 eval`, also `python eval.py`: run a policy on a benchmark, print a table, leave
a report."""

import contextlib
import dataclasses
import importlib
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import require_one_of
from bp2_rl.base.files import require_name
from bp2_rl.cli import app
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.learning.policy import find_policy
from bp2_rl.settings.training import TaskFlag

BENCHMARKS = {
    "topspeed": "ramp to the top speed and hold it",
    "sprint": "100 m from a standing start",
    "robustness": "many randomised robots at 10.74 m/s",
    "manoeuvres": "braking, launches, turns, slow motion, standing, pushes, bad ground",
    "disturbances": "harder pushes, at all phases of a stride, and rougher ground",
    "convergence": "topspeed under finer physics",
    "losses": "what each loss costs, alone and together",
    "sensitivity": "topspeed and sprint on robots other than the one assumed",
    "posterior": "topspeed and sprint on robots that explain the paper's numbers",
    "all": "one after the other, but for posterior",
}
"""The benchmarks of the registry, which is slow to import, in words for the help."""
SCREEN = """usage: {prog} [POLICY_OR_RUN] [FLAGS]

{what}

what is run:
  POLICY_OR_RUN         a policy that ships, by its name, or the folder of a policy
                        or of a run
  --benchmark NAME      what is measured, of the list below [topspeed]
  --robot NAME|FILE     built: BP2 with losses and solid legs; ideal: without; real:
                        one that BP2 may be [the policy's; built for ideal]
  --task FILE[:NAME]    the task that the policy was trained with, where the task
                        adds to what the policy sees
  --backend {mujoco,drake}
                        mujoco: C MuJoCo; drake: a second opinion [mujoco]

how:
  --terrain KIND:SIZE   rough:0.05, waves:0.05 or stairs:0.1 (m), slope:0.1 (rad)
                        [flat]
  --speed M/S           speed to command [as the card's result was measured]
  --acceleration M/S2   how fast the command rises
  --hold S              how long to hold the speed
  --robots N            how many are drawn; of robustness [200], posterior [32]
  --seed N              what robots, rough ground and noise are drawn from [0]
  --sensor-noise        let the sensors be as noisy as in training

what is left:
  --out DIR             the report's folder [reports/BENCHMARK-DATE-TIME]
  --no-video            do not film the best seconds

benchmarks:
{benchmarks}

all flags, with the operator's: {prog} --help-all

examples:
  python eval.py --no-video                 # the policy that ships
  python eval.py runs/RUN --benchmark sprint""".replace(
    "{benchmarks}", app.listed(BENCHMARKS)
)
"""What `--help` prints."""
DEFAULT_POLICY = "policies/built"
REGISTRY = "bp2_rl.evaluation.benchmarks.registry"


@dataclasses.dataclass(frozen=True)
class Target:
    """The policy to evaluate and the benchmark: the first flags in the help."""

    run: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY_OR_RUN")
    ] = None
    """A policy that ships, by its name, or the folder of a policy or of a run."""
    benchmark: Annotated[
        str,
        tyro.conf.arg(
            metavar="NAME",
            help=" ".join(f"{name}: {what}." for name, what in BENCHMARKS.items())
            + " `bp2 paper eval` has the deep ones.",
        ),
    ] = "topspeed"
    task: TaskFlag = None
    """The task that the policy was trained with, where the task adds to what the policy
    sees; its code is run."""


@dataclasses.dataclass(frozen=True)
class EvalConfig(BenchmarkOptions, Target):
    """Run a policy from a standing start, measure it, and leave a report with table,
    plots and film.

    Without a policy: built, which ships with bp2_rl, as gentle, fastest, ideal and rough
    do.
    """

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """The report's folder; by default reports/<benchmark>-<date>-<time>."""
    video: bool = True
    """Film the best seconds, where a GL library exists."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `bp2 eval`; return its exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    prog = "python eval.py" if argv is None else "bp2 eval"

    def command() -> None:
        config = app.parse(EvalConfig, words, prog, screen=SCREEN)
        require_one_of("--benchmark", config.benchmark, BENCHMARKS)
        evaluate(config, again=f"{prog} {shlex.join(words)}".strip())

    return app.run(command)


def evaluate(
    config: EvalConfig,
    setup_type: type[BenchmarkOptions] = BenchmarkOptions,
    registry: str = REGISTRY,
    again: str | None = None,
) -> None:
    """Run a policy on a benchmark, print a table and write a report; check all inputs
    before the simulation.

    Args:
        config: the command line.
        setup_type: the flags that the benchmarks know; `config` has a field for each of
            them.
        registry: the module whose `BENCHMARKS` are meant, imported once the flags are
            right.
        again: the command that repeats this evaluation, for the reports.
    """
    setup = setup_type(
        **{
            field.name: getattr(config, field.name)
            for field in dataclasses.fields(setup_type)
        }
    )
    path = config.run or asset_path(DEFAULT_POLICY)
    find_policy(path)
    if config.out is not None:
        require_name(config.out)
    print(
        f"{path}: loading it and the simulator; compiling takes a minute at the first start",
        flush=True,
    )
    # Imported here so that --help and a mistyped flag are answered at once.
    from bp2_rl.cli.runtime import find_backend  # isort: skip  # before all that imports MuJoCo

    from rich.console import Console

    from bp2_rl.env.observations import layout_of
    from bp2_rl.evaluation.benchmarks.registry import ALL, choose
    from bp2_rl.evaluation.report import folder, page, terminal
    from bp2_rl.learning.policy import load_policy
    from bp2_rl.robot.named import find_robot
    from bp2_rl.simulation.parallel import compute_here, keep_workers

    if config.backend == "drake":
        # says how to install it where it is missing
        importlib.import_module("bp2_rl.simulation.drake")
    compute_here()  # and leave the accelerator to a training that may be running
    find_backend()
    benchmarks = importlib.import_module(registry).BENCHMARKS
    chosen = choose(config.benchmark, setup, benchmarks)
    policy = load_policy(path, layout_of=layout_of, task=config.task)
    if config.robot is not None:
        find_robot(config.robot)
    schedules = {
        name: benchmarks[name].schedule(policy, setup) for name, setup in chosen.items()
    }
    out = config.out or app.dated_folder(config.benchmark)
    folders = {name: out / name if config.benchmark == ALL else out for name in chosen}
    folder.open_folder(out, config.benchmark)

    console = Console()
    evaluations = []
    with keep_workers() if config.benchmark == ALL else contextlib.nullcontext():
        for name, setup in chosen.items():
            folder.open_folder(folders[name], name)
            console.print(
                f"{name} of {path} in {setup.backend}", style="dim", markup=False
            )
            evaluation = benchmarks[name].run(policy, schedules[name], setup)
            terminal.print_table(evaluation, console)
            if config.video and evaluation.trajectory is not None:
                console.print(
                    "filming the best seconds; without a GPU that takes a minute or two",
                    style="dim",
                )
            no_video = folder.write_report(
                evaluation,
                folders[name],
                video=config.video,
                gl_library=os.environ.get("MUJOCO_GL"),
                command=again,
            )
            if no_video is not None:
                console.print(no_video, soft_wrap=True, markup=False)
            evaluations.append(evaluation)
            if config.benchmark == ALL:
                folder.write_overview(evaluations, out)
    if config.benchmark == ALL:
        for one in evaluations:
            console.print(f"{one.benchmark}:", terminal.verdict_of(one))
    console.print(f"report: {out / page.PAGE}", soft_wrap=True, markup=False)
