"""`bp2 paper trajectories limits`: the greatest speed."""

import dataclasses
from typing import Annotated

from bp2_rl.base.bounds import Bounded
from bp2_rl.base.folders import own_folder
from bp2_rl.base.serialization import save_config
from bp2_rl.cli import trajopt
from bp2_rl.cli.trajopt import OUT, Flat, Folder, Robot, Workers
from bp2_rl.optimiser.problem import Problem

SPEEDS = "speeds.json"  # what is left in the folder


@dataclasses.dataclass(frozen=True)
class LimitsArguments(Bounded):
    """Find the greatest speed that has a trajectory at all, for BP2 and with one thing
    about it changed at a time."""

    problem: Annotated[Problem, Flat] = Problem(speed=13.2, intervals=8)
    robot: Robot = "ideal"
    losses: bool = False
    """instead, for the robot without its losses, with each alone, with all, and with
    all but each; needs a robot that loses something, such as --robot built"""
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "limits"
    """folder of the file of speeds"""


def find_limits(arguments: LimitsArguments) -> None:
    """Print the greatest speeds, and leave them in a file."""
    from rich.console import Console
    from rich.table import Table

    from bp2_rl.paper.trajectories import limits
    from bp2_rl.paper.trajectories.variants import hardware_variants, loss_variants

    if arguments.losses:
        variants = loss_variants(arguments.problem)
        search = limits.greatest_speeds_by_loss(variants, arguments.workers)
    else:
        variants = hardware_variants(arguments.problem)
        search = limits.greatest_speeds(variants, arguments.workers)
    with own_folder(arguments.out):
        with trajopt.progress_bar() as progress:
            searched = progress.track(search, len(variants), description="variants")
            found = {one.variant: one for one in searched}
        solutions = {name: found[name].solution for name in variants}
        speeds = {
            name: solution and solution.problem.speed
            for name, solution in solutions.items()
        }
        save_config(
            arguments.out / SPEEDS, limits.GreatestSpeeds(arguments.problem, speeds)
        )
    table = Table("variant", "greatest speed, m/s", "change", "period, s", "duty")
    for name, solution in solutions.items():
        if solution is None:
            table.add_row(name, "not found", "", "", "")
            continue
        base = speeds[found[name].base]
        change = "" if base is None else f"{solution.problem.speed - base:+.2f}"
        table.add_row(
            name,
            f"{solution.problem.speed:.2f}",
            change,
            f"{solution.period:.3f}",
            f"{solution.duty:.3f}",
        )
    Console().print(table)
    print(f"speeds: {arguments.out / SPEEDS}")
