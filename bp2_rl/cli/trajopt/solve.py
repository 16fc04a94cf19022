"""`bp2 trajopt solve`: one speed."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.cli import app
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.arguments import OUT, Flat, Folder, Robot, parse_on_robot
from bp2_rl.optimiser.problem import Problem, Starts
from bp2_rl.optimiser.solution import save_solution, speed_name


@dataclasses.dataclass(frozen=True)
class SolveArguments:
    """Find the best trajectory at one speed, verify it, and keep it with its picture."""

    problem: Annotated[Problem, Flat] = Problem()
    robot: Robot = "ideal"
    starts: Starts = 3
    """guesses to start from; the cheapest solution is kept"""
    refine: Annotated[int, Within(0, 500)] = 32
    """intervals a segment on which that one is solved again; 0 for not"""
    out: Folder = OUT / "solve"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)
        if self.refine == 1:
            raise UserError("refine must be 0 or at least 2 intervals, got 1")


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _solve(parse_on_robot(SolveArguments, argv, "bp2 trajopt solve")))


def _solve(arguments: SolveArguments) -> None:
    """Leave a solution, named after its speed, in the output folder."""
    from bp2_rl.base.plotting import save_figure
    from bp2_rl.optimiser.collocation import refine, solve_best
    from bp2_rl.optimiser.figure import trajectory_figure
    from bp2_rl.optimiser.verify import verify

    solving = f"solving at {arguments.problem.speed:g} m/s from {arguments.starts} starts"
    with output.own_folder(arguments.out), output.spinner(solving):
        found = solve_best(arguments.problem, arguments.starts)
        if arguments.refine:
            found = refine(found, arguments.refine)
        found = dataclasses.replace(found, checks=verify(found))
        path = arguments.out / speed_name(found.problem.speed)
        save_solution(path, found)
        save_figure(trajectory_figure(found), path.with_name(path.name + ".png"))
    output.describe([found])
    output.judge([found])
    print(f"solution and picture: {path}.*")
