"""`bp2 eval`, also `python eval.py`: run a policy on a benchmark, print a table, leave
a report."""

import contextlib
import dataclasses
import datetime
import importlib
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bp2_rl.base.assets import asset_path
from bp2_rl.base.files import require_name
from bp2_rl.cli import app
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.learning.policy import find_policy
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.training import RobotWish
from bp2_rl.simulation.backend import Backend, DrakeContact

DEFAULT_POLICY = "policies/built"
REGISTRY = "bp2_rl.evaluation.benchmarks.registry"
BenchmarkName = Literal[
    "topspeed",
    "sprint",
    "robustness",
    "manoeuvres",
    "disturbances",
    "convergence",
    "losses",
    "sensitivity",
    "all",
]


@dataclasses.dataclass(frozen=True)
class EvalConfig:
    """Run a policy from a standing start, measure it, and leave a report with table,
    plots and film.

    Without a policy: built, which ships with bp2_rl, as gentle, fastest and ideal do.

    Examples:
        python eval.py --no-video                 # the policy that ships
        python eval.py runs/RUN --benchmark sprint
    """

    run: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY_OR_RUN")
    ] = None
    """A policy that ships, by its name, or the folder of a policy or of a run."""
    benchmark: Annotated[BenchmarkName, tyro.conf.arg(metavar="NAME")] = "topspeed"
    """topspeed: ramp to the top speed and hold it. sprint: 100 m from a standing start.
    robustness: many randomised robots at 10.74 m/s. manoeuvres: braking, launches,
    turns, slow motion, standing, pushes, bad ground.
    disturbances: harder pushes, at all phases of a stride, and rougher ground.
    convergence: topspeed under finer physics. losses: what each loss costs, alone and
    together. sensitivity: topspeed and sprint on robots other than the one assumed.
    all: one after the other. `bp2 paper eval` has the deep ones: endurance, mechanism,
    efficiency, stability."""
    robot: RobotWish = None
    """built: BP2 with losses and solid legs; ideal: without; by default built, or the
    policy's own robot where that is neither"""
    backend: Backend = "mujoco"
    """mujoco: C MuJoCo. mjx: MJX, the reference engine of training. drake: Drake's
    dynamics and contact, a second opinion."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """Speed to command; by default the one at which the card's result was measured
    (robustness: 10.74)."""
    acceleration: Annotated[float | None, tyro.conf.arg(metavar="M/S2")] = None
    """How fast the command rises; by default 2.4, in a sprint what the card says, else
    3."""
    hold: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """How long to hold the speed; by default 20 (robustness: 15, sensitivity: 5). Not
    of sprint."""
    robots: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How many robots are drawn; by default 200. Of robustness."""
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """What the robots, the rough ground of manoeuvres and the sensors' noise are drawn
    from; by default 0."""
    sensor_noise: bool = False
    """Let the sensors be as noisy as in training. Of topspeed and sprint."""
    operator: HeadingHold = HeadingHold()
    drake: DrakeContact = DrakeContact()
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """The report's folder; by default reports/<benchmark>-<date>-<time>."""
    video: bool = True
    """Film the best seconds, where a GL library exists."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    words, prog = (
        list(sys.argv[1:] if argv is None else argv),
        "python eval.py" if argv is None else "bp2 eval",
    )
    again = f"{prog} {shlex.join(words)}".strip()
    return app.run(lambda: evaluate(app.parse(EvalConfig, words, prog), again=again))


def evaluate(
    config: EvalConfig,
    setup_type: type[Setup] = Setup,
    registry: str = REGISTRY,
    again: str | None = None,
) -> None:
    """Evaluate as configured. Everything a user can get wrong is looked at before the
    robot runs.

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
    # MuJoCo binds this library when imported and fails if it is not there; only the
    # film needs it, in its own process.
    gl_library = os.environ.pop("MUJOCO_GL", None)
    # Imported here for that reason, and so that --help and a mistyped flag are answered
    # at once.
    from bp2_rl.cli.runtime import find_backend  # isort: skip

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
    if config.backend != "mjx":
        compute_here()  # and leave the accelerator to a training that may be running
    find_backend()
    benchmarks = importlib.import_module(registry).BENCHMARKS
    chosen = choose(config.benchmark, setup, benchmarks)
    policy = load_policy(path, layout_of=layout_of)
    if config.robot is not None:
        find_robot(config.robot)
    schedules = {
        name: benchmarks[name].schedule(policy, setup) for name, setup in chosen.items()
    }
    now = datetime.datetime.now()
    out = config.out or Path("reports") / f"{config.benchmark}-{now:%Y%m%d-%H%M%S}"
    folders = {name: out / name if config.benchmark == ALL else out for name in chosen}
    folder.open_folder(out, config.benchmark)

    console, evaluations = Console(), []
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
                gl_library=gl_library,
                command=again,
            )
            if no_video is not None:
                console.print(no_video, soft_wrap=True, markup=False)
            evaluations.append(evaluation)
            if config.benchmark == ALL:
                folder.write_overview(evaluations, out)
    if config.benchmark == ALL:
        terminal.print_overview(evaluations, console)
    console.print(f"report: {out / page.PAGE}", soft_wrap=True, markup=False)
