"""`bp2 paper trajectories schemes`: what a discretisation costs."""

import dataclasses

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.cli import trajopt
from bp2_rl.optimiser.problem import Intervals, Problem, Speed
from bp2_rl.paper.cli.report import print_table


@dataclasses.dataclass(frozen=True)
class SchemesArguments:
    """Compare discretisation schemes over meshes: what each leaves of energy, how far
    off a re-simulation is."""

    speed: Speed = 10.0
    """m/s"""
    meshes: tuple[Intervals, ...] = (8, 16, 32)
    """intervals a segment"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)
        if not self.meshes or sorted(set(self.meshes)) != list(self.meshes):
            raise UserError(
                "--meshes: give the coarsest first, as each solve starts from the one before"
            )


def run_schemes(arguments: SchemesArguments) -> None:
    """Print the table."""
    from bp2_rl.optimiser.collocation import solve
    from bp2_rl.paper.trajectories.schemes import (
        SCHEMES,
        compare_schemes,
        tabulate_schemes,
    )

    rows = []
    try:
        with trajopt.progress_bar() as progress:
            solved = compare_schemes(
                solve, Problem(speed=arguments.speed), arguments.meshes
            )
            for row in progress.track(
                solved, len(SCHEMES) * len(arguments.meshes), description="solves"
            ):
                rows.append(row)
    finally:  # also what there is when a scheme fails on one of the meshes
        print_table(tabulate_schemes(rows), 110)
