"""`bp2 paper trajectories sweep`: many speeds, from cold starts."""

import dataclasses
from typing import Annotated

import numpy as np

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import own_folder
from bp2_rl.cli import trajopt
from bp2_rl.cli.trajopt import OUT, Flat, Folder, Robot, Workers
from bp2_rl.optimiser.problem import MOST_SPEEDS, Problem, Speed, SpeedStep, Starts


@dataclasses.dataclass(frozen=True)
class SweepArguments:
    """Solve at many speeds, each from several cold starts: how reliably, how fast, how
    many optima.

    Interrupted, it goes on where it stopped when run again.
    """

    problem: Annotated[Problem, Flat] = Problem()
    robot: Robot = "ideal"
    slowest: Speed = 1.0
    """m/s"""
    fastest: Speed = 13.2
    """m/s"""
    step: SpeedStep = 1.0
    """m/s"""
    starts: Starts = 3
    """cold starts at each speed"""
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "sweep"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)
        if self.slowest > self.fastest:
            raise UserError(
                f"a sweep goes from --slowest ({self.slowest}) up to --fastest ({self.fastest})"
            )
        if (self.fastest - self.slowest) / self.step > MOST_SPEEDS:
            raise UserError(
                f"step ({self.step}) makes more than {MOST_SPEEDS} speeds: choose a longer one"
            )

    @property
    def speeds(self) -> list[float]:
        """All speeds, ascending, m/s; the last step may be shorter."""
        speeds = (
            np.arange(self.slowest, self.fastest + 1e-9, self.step).round(9).tolist()
        )
        return speeds + ([self.fastest] if self.fastest > speeds[-1] + 1e-9 else [])


def run_sweep(arguments: SweepArguments) -> None:
    """Leave the solutions in the output folder and print how the solves went."""
    from bp2_rl.paper.trajectories.sweep import best_of, sweep

    with own_folder(arguments.out), trajopt.progress_bar() as progress:
        tried = sweep(
            arguments.problem,
            arguments.speeds,
            arguments.starts,
            arguments.out,
            arguments.workers,
        )
        total = len(arguments.speeds) * arguments.starts
        attempts = list(progress.track(tried, total, description="cold starts"))
    solved = [attempt for attempt in attempts if attempt.solved]
    if solved:
        trajopt.print_solutions(best_of(arguments.out))
        seconds = [attempt.seconds for attempt in solved]
        print(
            f"seconds a solve: median {np.median(seconds):.1f}, longest {max(seconds):.1f}"
        )
        print(
            f"largest constraint violation: {max(attempt.violation for attempt in solved):.1e}"
        )
    for attempt in attempts:
        if not attempt.solved:
            print(f"start {attempt.start}: {attempt.why}")
    print(
        f"converged: {len(solved)} of {len(attempts)} cold starts ({len(solved) / len(attempts):.1%})"
    )
