"""`bp2 paper trajectories figures`: the paper's figures, and whose inertia it is that
balances whose."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import make_folder
from bp2_rl.base.serialization import save_config
from bp2_rl.cli.trajopt import OUT, Folder, load_solutions
from bp2_rl.optimiser.problem import Speed
from bp2_rl.paper.cli.report import print_table

NUMBERS = "coupling.json"  # what is left in the folder, beside the figures


@dataclasses.dataclass(frozen=True)
class FiguresArguments(Bounded):
    """Draw the paper's figures of a family of trajectories: force decomposition, one
    stride, the family over speed; and where its coupled inertial torques come from."""

    path: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP_OR_LIBRARY")
    ] = None
    """a folder of solutions or a library; by default the library that ships"""
    speed: Speed = 10.0
    """of the stride that is drawn, m/s"""
    out: Folder = OUT / "figures"


def draw_figures(arguments: FiguresArguments) -> None:
    """Draw them and print what the decomposition says."""
    solutions = load_solutions(arguments.path)
    shown = min(
        solutions, key=lambda solution: abs(solution.problem.speed - arguments.speed)
    )
    if abs(shown.problem.speed - arguments.speed) > 0.01:
        speeds = ", ".join(f"{solution.problem.speed:g}" for solution in solutions)
        raise UserError(f"--speed {arguments.speed:g}: there are only {speeds} m/s")
    make_folder(arguments.out)

    from bp2_rl.base.plotting import save_figure
    from bp2_rl.optimiser.figure import trajectory_figure
    from bp2_rl.paper.trajectories import (
        coupling_account,
        decomposition,
        figure_numbers,
    )
    from bp2_rl.paper.trajectories.coordinates import decompose_links
    from bp2_rl.paper.trajectories.coupling import split_sources
    from bp2_rl.paper.trajectories.figures.coupling import (
        coordinates_figure,
        coupling_figure,
    )
    from bp2_rl.paper.trajectories.figures.decomposition import decomposition_figure
    from bp2_rl.paper.trajectories.figures.family import family_figure

    terms, trends = decomposition.decompose(shown), decomposition.find_trends(solutions)
    sources, accounts = split_sources(shown), coupling_account.account_family(solutions)
    for name, figure in (
        ("decomposition", decomposition_figure(terms, trends)),
        ("trajectory", trajectory_figure(shown)),
        ("family", family_figure(solutions)),
        ("coupling", coupling_figure(sources, accounts)),
        ("coordinates", coordinates_figure(terms, decompose_links(shown))),
    ):
        save_figure(figure, arguments.out / f"{name}.png")
    account = next(
        account for account in accounts if account.speed == shown.problem.speed
    )
    numbers = figure_numbers.FigureNumbers(
        shown=figure_numbers.number_shown(shown, terms, trends),
        means=decomposition.means_by_speed(trends),
        by_speed=tuple(accounts),
    )
    save_config(arguments.out / NUMBERS, numbers)
    print(
        f"at {shown.problem.speed:g} m/s, closure of the equations of motion: {terms.closure:.1e} N or Nm"
    )
    print(f"C_z / (m g) at its peak: {decomposition.peak_velocity_force(terms):.2f}")
    print(
        f"coupled inertia opposes main inertia at {account.opposing:.0%} of the hips' peaks and covers "
        f"{account.covered:.0%} of it; its sources close to {sources.closure:.0e} of the largest"
    )
    for line in (*coupling_account.remarks(account), *decomposition.remarks(trends)):
        print(line)
    print_table(coupling_account.tabulate(accounts), 110)
    print(f"figures, and all their numbers in {NUMBERS}: {arguments.out}")
