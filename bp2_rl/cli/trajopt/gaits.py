"""`bp2 trajopt gaits`: trot, bound and pronk beside each other."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

from bp2_rl.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.arguments import OUT, Flat, Folder, Robot, parse_on_robot
from bp2_rl.config import save_config
from bp2_rl.errors import UserError
from bp2_rl.trajopt.problem import Problem, Speed

NUMBERS = "gaits.json"  # what is left in the folder, beside the solutions


@dataclasses.dataclass(frozen=True)
class Arguments:
    """Set trot, bound and pronk beside each other in the plane: what each costs over speed, and how fast each gets.

    Interrupted, it goes on where it stopped when run again. The problem's own speed and gait do not count.
    """

    problem: Annotated[Problem, Flat] = Problem(intervals=8, pitch_limit=0.6)
    robot: Robot = "ideal"
    speeds: tuple[Speed, ...] = (6.0, 10.0, 13.0, 16.0)
    """m/s, the slowest first"""
    out: Folder = OUT / "gaits"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)
        if not self.speeds or sorted(set(self.speeds)) != list(self.speeds):
            raise UserError("--speeds: name the slowest first and each once, as each solve starts from the one before")


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _gaits(parse_on_robot(Arguments, argv, "bp2 trajopt gaits")))


def _gaits(arguments: Arguments) -> None:
    """Print the table, and leave its numbers anew with each row."""
    from rich.console import Console

    from bp2_rl.trajopt.gaits import GAITS, GaitNumbers, compare_gaits, tabulate_gaits

    rows = []
    with output.own_folder(arguments.out), output.progress() as progress:
        task = progress.add_task("gaits", total=len(GAITS) * (len(arguments.speeds) + 1))
        for row in compare_gaits(arguments.problem, arguments.speeds, arguments.out):
            rows.append(row)
            save_config(arguments.out / NUMBERS, GaitNumbers(arguments.problem, arguments.speeds, tuple(rows)))
            progress.advance(task)
    # A number that is cut off is worse than a line that is folded.
    Console(width=max(Console().width, 130)).print(tabulate_gaits(rows))
    print(f"numbers: {arguments.out / NUMBERS}")
