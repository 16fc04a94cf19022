"""`bp2 trajopt limits`: the greatest speed."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

from bp2_rl.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.arguments import Flat, Workers
from bp2_rl.trajopt.problem import Problem


@dataclasses.dataclass(frozen=True)
class Arguments:
    """Find the greatest speed that has a trajectory at all, for BP2 and with one thing about it changed at a time."""

    problem: Annotated[Problem, Flat] = Problem(speed=13.2, intervals=8)
    workers: Workers = 2
    """processes"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _limits(app.parse(Arguments, argv, "bp2 trajopt limits")))


def _limits(arguments: Arguments) -> None:
    """Print the greatest speeds, BP2's own first."""
    from rich.console import Console
    from rich.table import Table

    from bp2_rl.trajopt.limits import CHANGES, NO_SPEED_LIMIT, greatest_speeds

    order = [*CHANGES, NO_SPEED_LIMIT]
    found = {}
    with output.progress() as progress:
        task = progress.add_task("variants", total=len(order))
        for limit in greatest_speeds(arguments.problem, arguments.workers):
            found[limit.variant] = limit.solution
            progress.advance(task)
    table = Table("variant", "greatest speed, m/s", "change", "period, s", "duty")
    base = found[order[0]]
    for name in order:
        if (solution := found[name]) is None:
            table.add_row(name, "not found", "", "", "")
            continue
        change = "" if base is None else f"{solution.problem.speed - base.problem.speed:+.2f}"
        table.add_row(name, f"{solution.problem.speed:.2f}", change, f"{solution.period:.3f}", f"{solution.duty:.3f}")
    Console().print(table)
