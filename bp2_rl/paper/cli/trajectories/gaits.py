"""`bp2 paper trajectories gaits`: trot, bound, pronk, half-bound and gallop beside each other."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

from bp2_rl.cli import app
from bp2_rl.cli.trajopt.arguments import OUT, Flat, Folder, parse_on_robot
from bp2_rl.optimiser.problem import Problem, Speed
from bp2_rl.paper.cli.trajectories.comparing import ComparisonArguments, set_beside


@dataclasses.dataclass(frozen=True, kw_only=True)
class GaitsArguments(ComparisonArguments):
    """Set five gaits beside each other in the plane: what each costs over speed, and how fast each gets.

    Interrupted, it goes on where it stopped when run again. The problem's own speed and gait do not count.
    """

    problem: Annotated[Problem, Flat] = Problem(intervals=8, pitch_limit=0.6)
    speeds: tuple[Speed, ...] = (6.0, 10.0, 13.0, 16.0)
    """m/s, the slowest first"""
    out: Folder = OUT / "gaits"


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _gaits(parse_on_robot(GaitsArguments, argv, "bp2 paper trajectories gaits")))


def _gaits(arguments: GaitsArguments) -> None:
    from bp2_rl.paper.trajectories.gaits import gait_variants

    set_beside(arguments, gait_variants(arguments.problem), "gaits")
