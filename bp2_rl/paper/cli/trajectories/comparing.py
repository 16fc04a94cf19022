"""`bp2 paper trajectories gaits` and `limbs`: variants of BP2 beside each other, over
speed."""

import dataclasses
from collections.abc import Mapping
from typing import Annotated

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import own_folder
from bp2_rl.base.serialization import save_config
from bp2_rl.cli import trajopt
from bp2_rl.cli.trajopt import OUT, Flat, Folder, Robot, Workers
from bp2_rl.optimiser.problem import Problem, Speed
from bp2_rl.paper.cli.report import print_table


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComparisonArguments:
    """The flags of both commands."""

    problem: Annotated[Problem, Flat]
    robot: Robot = "ideal"
    speeds: tuple[Speed, ...]
    """m/s, the slowest first"""
    workers: Workers = 2
    """processes"""
    out: Folder

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)
        if not self.speeds or sorted(set(self.speeds)) != list(self.speeds):
            raise UserError(
                "--speeds: name the slowest first and each once, as each solve starts from the one before"
            )


@dataclasses.dataclass(frozen=True, kw_only=True)
class GaitsArguments(ComparisonArguments):
    """Set five gaits beside each other in the plane: what each costs over speed, and
    how fast each gets.

    Interrupted, it goes on where it stopped when run again. The problem's own speed and
    gait do not count.
    """

    problem: Annotated[Problem, Flat] = Problem(intervals=8, pitch_limit=0.6)
    speeds: tuple[Speed, ...] = (6.0, 10.0, 13.0, 16.0)
    """m/s, the slowest first"""
    out: Folder = OUT / "gaits"


@dataclasses.dataclass(frozen=True, kw_only=True)
class LimbsArguments(ComparisonArguments):
    """Move mass between trunk and legs, and change the trunk's inertia: what each
    costs, and how fast each gets.

    Interrupted, it goes on where it stopped when run again. The problem's own speed
    does not count.
    """

    problem: Annotated[Problem, Flat] = Problem(intervals=8)
    speeds: tuple[Speed, ...] = (6.0, 10.0, 13.0)
    """m/s, the slowest first"""
    out: Folder = OUT / "limbs"


def compare_gaits(arguments: GaitsArguments) -> None:
    """Print what each gait costs and how fast it gets, and leave the numbers."""
    from bp2_rl.paper.trajectories.variants import gait_variants

    _set_beside(arguments, gait_variants(arguments.problem), "gaits")


def compare_limbs(arguments: LimbsArguments) -> None:
    """Print what robots with other legs cost and how fast each gets, and leave the
    numbers."""
    from bp2_rl.paper.trajectories.variants import limb_variants

    _set_beside(arguments, limb_variants(arguments.problem), "limbs")


def _set_beside(
    arguments: ComparisonArguments, variants: Mapping[str, Problem], what: str
) -> None:
    """Print the table, and leave its numbers anew with each variant."""
    from bp2_rl.paper.trajectories.comparison import (
        VariantComparison,
        compare,
        tabulate,
    )

    problem, speeds, rows = arguments.problem, arguments.speeds, []
    numbers = arguments.out / f"{what}.json"  # beside the solutions
    with own_folder(arguments.out), trajopt.progress_bar() as progress:
        compared = compare(
            problem,
            variants,
            speeds,
            arguments.out,
            what=what,
            workers=arguments.workers,
        )
        for some in progress.track(compared, len(variants), description=what):
            rows += some
            save_config(numbers, VariantComparison(problem, speeds, tuple(rows)))
    print_table(tabulate(rows), 130)
    print(f"numbers: {numbers}")
