"""`bp2 paper trajectories COMMAND`: study the trajectories that the optimiser finds.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake
is answered at once.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import make_folder, own_folder
from bp2_rl.base.metric import Table, show, table_of
from bp2_rl.base.serialization import save_config
from bp2_rl.cli import trajopt
from bp2_rl.cli.app import Command, choose, entries
from bp2_rl.cli.printing import print_table
from bp2_rl.cli.trajopt import (
    OUT,
    PROBLEM_SCREEN,
    Flat,
    Folder,
    ProblemArguments,
    Workers,
    problem_of_robot,
)
from bp2_rl.optimiser.problem import (
    Intervals,
    Problem,
    Speed,
)
from bp2_rl.paper.trajectories import codesign, objective

# --- limits ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class LimitsArguments(ProblemArguments):
    """Find the greatest speed that has a trajectory at all, for BP2 and with one thing
    about it changed at a time."""

    problem: Annotated[Problem, Flat] = Problem(speed=13.2, intervals=8)
    losses: bool = False
    """instead, for the robot without its losses, with each alone, with all, and with
    all but each; needs a robot that loses something, such as --robot built"""
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "limits"
    """folder of the file of speeds"""


def find_limits(arguments: LimitsArguments) -> None:
    """Print the greatest speeds of a robot's variants, and save them to a file."""
    from bp2_rl.paper.trajectories import limits
    from bp2_rl.paper.trajectories.variants import hardware_variants, loss_variants

    problem, workers = arguments.problem, arguments.workers
    if arguments.losses:
        variants = loss_variants(problem)
        search = limits.greatest_speeds_by_loss(variants, workers)
    else:
        variants = hardware_variants(problem)
        search = limits.greatest_speeds(variants, workers)
    numbers = arguments.out / "speeds.json"
    with own_folder(arguments.out):
        with trajopt.progress_bar() as progress:
            searched = progress.track(search, len(variants), description="variants")
            found = dict(searched)
        speeds = {name: found[name] for name in variants}
        save_config(numbers, limits.GreatestSpeeds(problem, speeds))
    lines: list[Sequence[str]] = []
    for name, speed in speeds.items():
        base = speeds[variants[name].base]
        change = None if speed is None or base is None else speed - base
        lines.append((name, show(speed, ".2f"), show(change, "+.2f")))
    print_table(Table("", ("Variant", "Greatest speed [m/s]", "Change"), lines))
    print(f"speeds: {numbers}")


# --- schemes --------------------------------------------------------------------------


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
    """Solve a trot by each discretisation scheme on each mesh, and print the table of
    errors."""
    from bp2_rl.optimiser.collocation import solve
    from bp2_rl.paper.trajectories.robustness import SCHEMES, SchemeRow, compare_schemes

    problem = Problem(speed=arguments.speed)
    meshes = arguments.meshes
    rows: list[SchemeRow] = []
    try:
        with trajopt.progress_bar() as progress:
            solved = compare_schemes(solve, problem, meshes)
            total = len(SCHEMES) * len(meshes)
            for row in progress.track(solved, total, description="solves"):
                rows.append(row)
    finally:  # also what there is when a scheme fails on one of the meshes
        if rows:
            print_table(table_of("", rows))


# --- objective and co-design ----------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class ObjectiveArguments(Bounded):
    """Compare BP2's cheapest trajectories under one, two and three body weights of F
    bar, what forces are divided by in the cost."""

    settings: Annotated[objective.ObjectiveSettings, Flat] = (
        objective.ObjectiveSettings()
    )
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "objective"


@dataclasses.dataclass(frozen=True)
class CodesignArguments(Bounded):
    """Find gear ratio, leg length and spring stiffness along with the trajectory, from
    several starts and on finer and finer meshes."""

    settings: Annotated[codesign.CodesignSettings, Flat] = codesign.CodesignSettings()
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "codesign"


def _leave_rows(
    arguments: ObjectiveArguments | CodesignArguments,
    find: Callable[..., Iterable[object]],
    record: Callable[..., object],
    name: str,
) -> None:
    """Print a table of the rows that are found, and leave them in a file as they are
    found."""
    numbers = arguments.out / name
    rows: list[object] = []
    with own_folder(arguments.out):
        try:
            for row in find(arguments.settings, arguments.workers):
                rows.append(row)
                save_config(numbers, record(arguments.settings, tuple(rows)))
        finally:  # also what there is when a mesh loses the design
            if rows:
                print_table(table_of("", rows))
    print(f"numbers: {numbers}")


# --- figures --------------------------------------------------------------------------

NUMBERS = "coupling.json"  # what is left in the folder, beside the figures


@dataclasses.dataclass(frozen=True)
class FiguresArguments(Bounded):
    """Draw the paper's figures of a family of trajectories: force decomposition, one
    stride, and where its coupled inertial torques come from."""

    path: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SOLUTIONS_OR_LIBRARY")
    ] = None
    """a folder of solutions or a library; by default the library that ships"""
    speed: Speed = 10.0
    """of the stride that is drawn, m/s"""
    out: Folder = OUT / "figures"


def draw_figures(arguments: FiguresArguments) -> None:
    """Draw the figures of a family of trajectories, and print the effects of inertial
    coupling."""
    from bp2_rl.cli.trajopt import load_solutions

    solutions = load_solutions(arguments.path)
    shown = min(solutions, key=lambda one: abs(one.problem.speed - arguments.speed))
    if abs(shown.problem.speed - arguments.speed) > 0.01:
        speeds = ", ".join(f"{solution.problem.speed:g}" for solution in solutions)
        raise UserError(f"--speed {arguments.speed:g}: there are only {speeds} m/s")
    make_folder(arguments.out)

    from bp2_rl.base.plotting import save_figure
    from bp2_rl.optimiser.figure import trajectory_figure
    from bp2_rl.paper.trajectories import coupling, decomposition, figures

    terms, trends = decomposition.decompose(shown), decomposition.find_trends(solutions)
    family = decomposition.comparable(solutions)
    accounts = [coupling.account_coupling(solution) for solution in family]
    for name, figure in (
        ("decomposition", figures.decomposition_figure(terms, trends)),
        ("trajectory", trajectory_figure(shown)),
        ("coupling", figures.coupling_figure(terms)),
    ):
        save_figure(figure, arguments.out / f"{name}.png")
    numbers = coupling.FigureNumbers(
        shown=coupling.number_shown(shown, terms, trends),
        means=decomposition.means_by_speed(trends),
        by_speed=tuple(accounts),
    )
    save_config(arguments.out / NUMBERS, numbers)
    print_table(table_of("Shares of the hips' main torque at its peaks", accounts))
    account = next(one for one in accounts if one.speed == shown.problem.speed)
    for cut in account.cutoffs:
        ends = ", ".join(f"{peak:.0f} Nm ({end})" for end, peak in cut.largest.items())
        print(f"main torque of harmonics 1 to {cut.harmonics}: {ends}")
    title = f"Motors at {account.speed:g} m/s; ũ: on a trunk that is not accelerated"
    print_table(table_of(title, list(account.torques.values())))
    print(f"figures, and all their numbers in {NUMBERS}: {arguments.out}")


PROG = "bp2 paper trajectories"
COMMON_FLAGS = """
  --workers INT         processes [2]
  --out DIR             the folder of what is found"""
LIMITS_SCREEN = PROBLEM_SCREEN.format(
    what="""Find the greatest speed that has a trajectory at all, for BP2 and with one thing about
it changed at a time.""",
    flags="""  --losses              instead, for the robot without its losses, with each alone,
                        with all, and with all but each: --robot built
  --speed FLOAT         m/s, at which the search begins [13.2]"""
    + COMMON_FLAGS,
)
CODESIGN_SCREEN = f"""usage: {{prog}} [FLAGS]

Find gear ratio, leg length and spring stiffness along with the trajectory.

flags:
  --starts INT          of the optimum [4]
  --confirm INT ...     meshes on which the optimum is solved again [16 24 32 48]\
{COMMON_FLAGS}

all flags, with the problem's: {{prog}} --help-all"""
COMMANDS = {
    "limits": Command(
        f"{PROG} limits",
        LimitsArguments,
        find_limits,
        functools.partial(problem_of_robot, LimitsArguments),
        LIMITS_SCREEN,
    ),
    "schemes": Command(f"{PROG} schemes", SchemesArguments, run_schemes),
    "objective": Command(
        f"{PROG} objective",
        ObjectiveArguments,
        lambda told: _leave_rows(
            told, objective.compare_objectives, objective.Objective, "objective.json"
        ),
    ),
    "codesign": Command(
        f"{PROG} codesign",
        CodesignArguments,
        lambda told: _leave_rows(
            told, codesign.optimise_design, codesign.Codesign, "codesign.json"
        ),
        screen=CODESIGN_SCREEN,
    ),
    "figures": Command(f"{PROG} figures", FiguresArguments, draw_figures),
}

main = functools.partial(choose, PROG, entries(COMMANDS))
