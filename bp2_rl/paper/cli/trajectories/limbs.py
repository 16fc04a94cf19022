"""`bp2 paper trajectories limbs`: robots with other legs beside BP2."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

from bp2_rl.cli import app
from bp2_rl.cli.trajopt.arguments import OUT, Flat, Folder, parse_on_robot
from bp2_rl.optimiser.problem import Problem, Speed
from bp2_rl.paper.cli.trajectories.comparing import ComparisonArguments, set_beside


@dataclasses.dataclass(frozen=True, kw_only=True)
class LimbsArguments(ComparisonArguments):
    """Move mass between trunk and legs, and change the trunk's inertia: what each costs, and how fast each gets.

    Interrupted, it goes on where it stopped when run again. The problem's own speed does not count.
    """

    problem: Annotated[Problem, Flat] = Problem(intervals=8)
    speeds: tuple[Speed, ...] = (6.0, 10.0, 13.0)
    """m/s, the slowest first"""
    out: Folder = OUT / "limbs"


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _limbs(parse_on_robot(LimbsArguments, argv, "bp2 paper trajectories limbs")))


def _limbs(arguments: LimbsArguments) -> None:
    from bp2_rl.paper.trajectories.limbs import limb_variants

    set_beside(arguments, limb_variants(arguments.problem), "limbs")
