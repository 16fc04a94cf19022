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
    "robustness": "200 randomised robots at 10.74 m/s",
    "manoeuvres": "braking, launches, turns, slow motion, standing, pushes, bad ground",
    "disturbances": "harder pushes, at all phases of a stride, and rougher ground",
    "convergence": "topspeed with smaller physics steps and more solver iterations",
    "losses": "the speed that each loss of the robot costs, alone and together",
    "sensitivity": "topspeed and sprint with one assumed property changed at a time",
    "posterior": "topspeed and sprint on robots that agree with the paper's results",
    "all": "all of them, except posterior",
}
"""The benchmarks of the registry, which is slow to import, in words for the help."""
SCREEN = """usage: {prog} [POLICY_OR_RUN] [FLAGS]

{what}

policy and benchmark:
  POLICY_OR_RUN         name of a shipped policy (built, gentle, fastest, ideal,
                        rough), or folder of a policy or a training run [built]
  --benchmark NAME      a benchmark of the list below [topspeed]
  --robot NAME|FILE     built: BP2 with losses and solid legs; ideal: without
                        both; real: a plausible BP2; go1, ...; or a robot
                        file [the policy's own; built for one trained on ideal]
  --task FILE[:NAME]    the policy's task, if the task adds observations
  --backend {mujoco,drake}
                        simulator: C MuJoCo, or Drake for comparison [mujoco]

conditions:
  --terrain KIND:SIZE   rough:0.05, waves:0.05 or stairs:0.1 (m), slope:0.1 (rad)
                        [flat]
  --speed M/S           commanded speed [as in the result on the policy's card]
  --acceleration M/S2   rate at which the commanded speed rises
  --hold S              time at the commanded speed
  --robots N            random robots; robustness [200], posterior [32]
  --seed N              random seed of robots, rough ground and noise [0]
  --sensor-noise        add the sensor noise of training

output:
  --out DIR             the report's folder [reports/BENCHMARK-DATE-TIME]
  --no-video            no film of the best seconds

benchmarks:
{benchmarks}

all flags, with --operator.* (steering): {prog} --help-all

examples:
  python eval.py --no-video                 # the shipped policy built
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
    """Name of a shipped policy (built, gentle, fastest, ideal, rough), or folder of a
    policy or a training run [built]."""
    benchmark: Annotated[
        str,
        tyro.conf.arg(
            metavar="NAME",
            help=" ".join(f"{name}: {what}." for name, what in BENCHMARKS.items())
            + " `bp2 paper eval` has more.",
        ),
    ] = "topspeed"
    task: TaskFlag = None
    """The policy's task, if the task adds observations; its code is run."""


@dataclasses.dataclass(frozen=True)
class EvalConfig(BenchmarkOptions, Target):
    """Run a policy from a standing start, measure it, and write a report with a table,
    plots and a film."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """The report's folder; by default reports/<benchmark>-<date>-<time>."""
    video: bool = True
    """Film the best seconds, if a GL library is installed."""


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
    from bp2_rl.evaluation.benchmarks.conditions import robot_of
    from bp2_rl.evaluation.benchmarks.registry import ALL, choose
    from bp2_rl.evaluation.report import folder, page, terminal
    from bp2_rl.learning.policy import load_policy
    from bp2_rl.simulation.parallel import compute_here, keep_workers

    if config.backend == "drake":
        # says how to install it where it is missing
        importlib.import_module("bp2_rl.simulation.drake")
    compute_here()  # and leave the accelerator to a training that may be running
    find_backend()
    benchmarks = importlib.import_module(registry).BENCHMARKS
    chosen = choose(config.benchmark, setup, benchmarks)
    policy = load_policy(path, layout_of=layout_of, task=config.task)
    robot_of(policy, setup)  # raises for another kind of robot, before any folder
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
        for evaluation in evaluations:
            console.print(f"{evaluation.benchmark}:", terminal.verdict_of(evaluation))
    console.print(f"report: {out / page.PAGE}", soft_wrap=True, markup=False)
