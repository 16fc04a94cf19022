"""Compare variants over speed: the shared part of `bp2 paper trajectories gaits` and `limbs`."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import save_config
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.arguments import Flat, Folder, Robot, Workers
from bp2_rl.optimiser.problem import Problem, Speed

if TYPE_CHECKING:
    from bp2_rl.paper.trajectories.comparison import ComparedVariant


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComparisonArguments:
    """The flags of both."""

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
            raise UserError("--speeds: name the slowest first and each once, as each solve starts from the one before")


def set_beside(arguments: ComparisonArguments, variants: Sequence["ComparedVariant"], what: str) -> None:
    """Print the table, and leave its numbers anew with each variant."""
    from rich.console import Console

    from bp2_rl.paper.trajectories.comparison import Numbers, compare, tabulate

    problem, speeds, rows = arguments.problem, arguments.speeds, []
    numbers = arguments.out / f"{what}.json"  # beside the solutions
    with output.own_folder(arguments.out), output.progress() as progress:
        task = progress.add_task(what, total=len(variants))
        for some in compare(problem, variants, speeds, arguments.out, what=what, workers=arguments.workers):
            rows += some
            save_config(numbers, Numbers(problem, speeds, tuple(rows)))
            progress.advance(task)
    # A number that is cut off is worse than a line that is folded.
    Console(width=max(Console().width, 130)).print(tabulate(rows))
    print(f"numbers: {numbers}")
