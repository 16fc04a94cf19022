"""`python eval.py`: run a policy on a benchmark, print a table, leave a report."""

import dataclasses
import datetime
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.assets import asset_path
from bp2_rl.cli import app
from bp2_rl.errors import UserError

DEFAULT_POLICY = "policies/default"


@dataclasses.dataclass(frozen=True)
class EvalConfig:
    """Run a policy from a standing start, measure it, and leave a report with table, plots and film.

    Without a policy: the one that ships with bp2_rl.
    """

    run: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY_OR_RUN")] = None
    """A policy folder or a training run's folder."""
    policy: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """The same, as a flag."""
    benchmark: str = "topspeed"
    """topspeed: ramp to the top speed at 2.4 m/s2 and hold it."""
    backend: str = "mujoco"
    """mujoco: C MuJoCo, the judge. mjx: the simulator of training."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """Speed to command; by default the one at which the top speed on the policy's card was measured."""
    hold: Annotated[float, tyro.conf.arg(metavar="S")] = 20.0
    """How long to hold it."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """The report's folder; by default reports/<benchmark>-<date>-<time>."""
    video: bool = True
    """Film the best seconds, where a GL library exists."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: evaluate(app.parse(EvalConfig, argv, "eval.py")))


def evaluate(config: EvalConfig) -> None:
    """Evaluate as configured. Everything a user can get wrong is looked at before the robot runs."""
    # MuJoCo binds this library when imported and fails if it is not there; only the film needs it, in its own process.
    gl_library = os.environ.pop("MUJOCO_GL", None)
    # Imported here for that reason, and so that --help and a mistyped flag are answered at once.
    from bp2_rl.cli.runtime import prepare_jax  # isort: skip

    import jax
    from rich.console import Console

    from bp2_rl.env.observations import LAYOUT
    from bp2_rl.evaluation import benchmarks, report
    from bp2_rl.learning.policy import load_policy

    if config.backend == "mujoco":
        jax.config.update("jax_platforms", "cpu")  # leaves the accelerator to a training that may be running
    prepare_jax()
    setup = benchmarks.Setup(backend=config.backend, speed=config.speed, hold=config.hold)
    benchmark = benchmarks.BENCHMARKS.get(config.benchmark)
    if benchmark is None:
        raise UserError(f"--benchmark {config.benchmark}: there is {', '.join(benchmarks.BENCHMARKS)}")
    path = choose_policy(config)
    policy = load_policy(path, expected_layout=LAYOUT)
    now = datetime.datetime.now()
    folder = config.out or Path("reports") / f"{config.benchmark}-{now:%Y%m%d-%H%M%S}"
    report.open_folder(folder)

    console = Console()
    console.print(f"{config.benchmark} of {path} in {config.backend}", style="dim")
    evaluation = benchmark(policy, setup)
    report.print_table(evaluation, console)
    no_video = report.write_report(evaluation, folder, video=config.video, gl_library=gl_library)
    if no_video is not None:
        console.print(no_video, soft_wrap=True)
    console.print(f"report: {folder / report.PAGE}", soft_wrap=True)


def choose_policy(config: EvalConfig) -> Path:
    """The policy asked for, or the one that ships."""
    if config.run is not None and config.policy is not None:
        raise UserError(f"two policies given: {config.run} and --policy {config.policy}; name one")
    return config.run or config.policy or asset_path(DEFAULT_POLICY)
