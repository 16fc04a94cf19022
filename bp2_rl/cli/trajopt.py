"""`bp2 trajopt COMMAND`: find trajectories, verify them, build the library of reference
motions.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake
is answered at once.
"""

import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)
from rich.status import Status
from rich.table import Table

from bp2_rl.base.bounds import Bounded, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import make_folder, own_folder
from bp2_rl.cli import app
from bp2_rl.cli.app import Command, choose, entries
from bp2_rl.optimiser.family import (
    FamilyConfig,
    arrays_of,
    build_family,
    family_of,
    provenance_of,
    steps_of,
)
from bp2_rl.optimiser.problem import Problem, Starts
from bp2_rl.optimiser.solution import (
    Solution,
    load_solution,
    save_solution,
    speed_name,
)
from bp2_rl.reference.library.file import (
    MotionLibrary,
    broken,
    load_library,
    save_library,
)
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.reference import CollocationConfig
from bp2_rl.settings.training import RobotChoice

OUT = Path("reports/trajopt")
Flat = tyro.conf.arg(name="")
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
Workers = Annotated[int, Within(1, 256)]
Robot = Annotated[
    RobotChoice,
    tyro.conf.arg(
        help="the robot, which --hardware flags change; the planar model has no solid legs, "
        "no soft ground, no lag and no latency"
    ),
]
PROBLEM_SCREEN = """usage: {{prog}} [FLAGS]

{what}

flags:
{flags}

the stride:
  --robot NAME|FILE     built, ideal, go1, ... or a robot file [ideal]
  --gait {{trot,two-leg,pronk,half-bound,gallop}}
                        footfall sequence [trot]
  --intervals INT       mesh intervals in each segment (stance, flight)
  --scheme {{hermite-simpson,trapezoid,paper}}
                        transcription of the equations of motion
  --clearance FLOAT     height of a foot in mid-swing, m
  --pitch-limit FLOAT   greatest pitch of the trunk, rad
  --speed-margin FLOAT  greatest joint speed over the no-load speed
  --torque-rate FLOAT   greatest rate of change of a torque, Nm/s
  --force-rate FLOAT    greatest rate of change of a foot's force, N/s

all flags, with --hardware.*, --form.* and --weights.*: {{prog}} --help-all"""
"""Template of the `--help` text of commands that solve a problem, with places for
description and flags."""
SOLVE_SCREEN = PROBLEM_SCREEN.format(
    what="{what}",
    flags="""  --speed FLOAT         speed of the trunk, m/s [10]
  --starts INT          initial guesses; the cheapest solution is kept [3]
  --refine INT          intervals in each segment of a finer mesh, on which the
                        cheapest solution is solved again; 0: no second mesh [32]
  --out DIR             the solution's folder [reports/trajopt/solve]""",
)
SOLVE_SCREEN += """

examples:
  bp2 trajopt solve --speed 8                    # a trot of BP2 at 8 m/s
  bp2 trajopt solve --gait gallop --starts 5 --out reports/gallop"""
LIBRARY_SCREEN = """usage: {prog} build [FLAGS]

{what}

flags:
  --robot NAME|FILE     built, ideal, go1, ... or a robot file [ideal]
  --slowest FLOAT       lowest speed, m/s
  --fastest FLOAT       highest speed, m/s [the limit of robots other than BP2]
  --step FLOAT          difference between neighbouring speeds, m/s
  --starts INT          initial guesses at the first speed
  --coarse INT          mesh intervals in each segment at the first solve
  --proximity FLOAT     cost weight of the distance to the neighbouring solution
  --workers INT         processes; more than two do not help [2]
  --out DIR             folder of the solutions [reports/trajopt/library]
  --to FILE             the library [reports/trajopt/bp2_trot.npz]

all flags, with --problem.* and --slow.*: {prog} build --help-all"""


@dataclasses.dataclass(frozen=True)
class ProblemArguments(Bounded):
    """Flags of a command that solves a problem on a robot."""

    problem: Annotated[Problem, Flat] = Problem()
    robot: Robot = "ideal"


@dataclasses.dataclass(frozen=True)
class SolveArguments(ProblemArguments):
    """Find the stride of least cost at one speed by trajectory optimisation, verify it
    and draw it.

    This takes about three minutes on one processor. The solution, a .npz and a .json
    file, and its picture are named after the speed.
    """

    starts: Starts = 3
    """initial guesses; the cheapest solution is kept"""
    refine: Annotated[int, Within(0, 500)] = 32
    """intervals in each segment of a finer mesh, on which the cheapest solution is
    solved again; 0: no second mesh"""
    out: Folder = OUT / "solve"

    def __post_init__(self) -> None:
        """Raise UserError for values out of bounds, and for speeds that the joints
        cannot reach."""
        super().__post_init__()
        if self.refine == 1:
            raise UserError("refine must be 0 or at least 2 intervals, got 1")
        hardware = self.problem.hardware
        speed = self.problem.speed
        rate = self.problem.speed_margin * float(np.max(hardware.joint_no_load_speed))
        # two from hip to foot, one from knee to foot
        fastest = rate * 3.0 * hardware.anatomy.leg_length
        if speed > fastest:
            raise UserError(
                f"speed must be at most {fastest:.1f} m/s, as fast as hip and knee move a foot, got {speed:g}"
            )


@dataclasses.dataclass(frozen=True)
class VerifyArguments:
    """Check solutions with an independent model, which shares no code with the
    optimiser's."""

    path: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SOLUTION_OR_LIBRARY")
    ] = None
    """a solution's .json or .npz, a folder of solutions, or a library; by default the
    library that ships"""


@dataclasses.dataclass(frozen=True)
class LibraryArguments:
    """Build a library of a robot's reference motions: solve a trot at each speed,
    verify the trots, and write the file.

    BP2's library ends at --fastest. The library of another robot ends at the robot's
    limit, the last speed at which a trot is found.

    The same command continues an interrupted build.
    """

    action: Annotated[Literal["build"], tyro.conf.Positional]
    family: Annotated[FamilyConfig, Flat] = FamilyConfig()
    robot: Robot = "ideal"
    workers: Workers = 2
    """processes; more than two do not help"""
    out: Folder = OUT / "library"
    """folder of the solutions"""
    to: Annotated[Path, tyro.conf.arg(metavar="FILE")] = OUT / "bp2_trot.npz"
    """the library"""

    def __post_init__(self) -> None:
        """Raise UserError for values out of bounds, and for a library file without the
        suffix .npz."""
        check_bounds(self)
        if self.to.suffix != ".npz":
            raise UserError(f"--to {self.to}: a library is an .npz file")


Solving = TypeVar("Solving", bound=ProblemArguments)


@dataclasses.dataclass(frozen=True)
class _Named:
    robot: Robot = "ideal"


def problem_of_robot(arguments: Callable[[], Solving], words: Sequence[str]) -> Solving:
    """Return the default arguments of a command for the robot that `--robot` names."""
    ours = arguments()
    robot = app.parse_known(_Named, words, "bp2 trajopt").robot
    return dataclasses.replace(ours, problem=ours.problem.sized(find_robot(robot)))


def library_of_robot(words: Sequence[str]) -> LibraryArguments:
    """Return the default arguments of a library for the robot that `--robot` names;
    folder and file bear its name."""
    robot = app.parse_known(_Named, words, "bp2 trajopt library").robot
    if robot == LibraryArguments.robot:
        return LibraryArguments("build")
    file = Path(robot)
    return LibraryArguments(
        "build",
        family=FamilyConfig.on(find_robot(robot)),
        robot=robot,
        out=OUT / f"library-{file.stem}",
        to=(file.parent if file.suffix else OUT) / f"{file.stem}_trot.npz",
    )


# --- The commands ---------------------------------------------------------------------


def _solve(arguments: SolveArguments) -> None:
    """Optimise, refine and verify a stride; save solution and figure in the output
    folder."""
    from bp2_rl.base.plotting import save_figure
    from bp2_rl.optimiser.collocation import refine, solve_best
    from bp2_rl.optimiser.figure import trajectory_figure
    from bp2_rl.optimiser.verify import verify

    solving = (
        f"solving at {arguments.problem.speed:g} m/s from {arguments.starts} starts"
    )
    make_folder(arguments.out)
    with spinner(solving):
        found = solve_best(arguments.problem, arguments.starts)
        if arguments.refine:
            found = refine(found, arguments.refine)
        found = dataclasses.replace(found, checks=verify(found))
        path = arguments.out / speed_name(found.problem.speed)
        save_solution(path, found)
        save_figure(trajectory_figure(found), path.with_name(path.name + ".png"))
    print_solutions([found])
    print_verification([found])
    print(f"solution and picture: {path}.*")


def _verify(arguments: VerifyArguments) -> None:
    """Verify solutions and print the results; raise UserError if a figure is beyond its
    limit."""
    solutions = load_solutions(arguments.path)

    from bp2_rl.optimiser.verify import verify

    checked = []
    with progress_bar() as bar:
        for solution in bar.track(solutions, description="verifying"):
            checked.append(dataclasses.replace(solution, checks=verify(solution)))
    print_solutions(checked)
    print_verification(checked, strict=True)


def _build(arguments: LibraryArguments) -> None:
    """Solve and verify the family of a library; save solutions in the folder and the
    library as a file."""
    with own_folder(arguments.out):
        make_folder(arguments.to.parent)
        with progress_bar() as bar:
            task = bar.add_task("speeds", total=None)
            family = build_family(
                arguments.family,
                arguments.out,
                workers=arguments.workers,
                report=lambda done, total: bar.update(
                    task, completed=done, total=total
                ),
            )
    print_solutions(family)
    if arguments.family.to_limit:
        print(
            f"the robot's limit, with a reserve for feedback: {family[-1].problem.speed:g} m/s"
        )
        kept = {speed_name(solution.problem.speed) for solution in family}
        if refused := sorted(
            {path.stem for path in arguments.out.glob("speed-*.json")} - kept
        ):
            print(
                f"left out, because the verifier rejects them ({arguments.out}): {', '.join(refused)}"
            )
    steps = steps_of(family)
    print(
        f"largest step between neighbours: period {max(abs(step.period) for step in steps):.1%}, "
        f"joint angles {max(step.joints for step in steps):.3f} rad"
    )
    print_verification(family, strict=True)
    save_family(arguments.to, family, arguments.family)
    print(f"library: {arguments.to}")


COMMANDS = {
    "solve": Command(
        "bp2 trajopt solve",
        SolveArguments,
        _solve,
        functools.partial(problem_of_robot, SolveArguments),
        SOLVE_SCREEN,
    ),
    "verify": Command("bp2 trajopt verify", VerifyArguments, _verify),
    "library": Command(
        "bp2 trajopt library",
        LibraryArguments,
        _build,
        library_of_robot,
        LIBRARY_SCREEN,
    ),
}

main = functools.partial(choose, "bp2 trajopt", entries(COMMANDS))


# --- What they show -------------------------------------------------------------------


def print_solutions(solutions: Sequence[Solution]) -> None:
    """Print a table with a row for each solution."""
    from bp2_rl.optimiser.verify import summarise

    table = Table(
        "m/s",
        "period",
        "duty",
        "torque",
        "force",
        "energy",
        "re-simulation",
        "cost",
        "s",
    )
    for solution in solutions:
        summary = summarise(solution)
        energy, position, velocity = (
            f"{solution.checks.get(name, math.nan):.1e}"
            for name in ("energy_residual", "position_error", "velocity_error")
        )
        table.add_row(
            f"{solution.problem.speed:g}",
            f"{summary.period:.3f} s",
            f"{summary.duty:.3f}",
            f"{summary.peak_torque:.0f} Nm",
            f"{summary.peak_force:.0f} N",
            energy,
            f"{position} / {velocity}",
            f"{solution.cost:.3f}",
            f"{solution.seconds:.1f}",
        )
    Console().print(table)


def print_verification(solutions: Sequence[Solution], *, strict: bool = False) -> None:
    """Print the figures of solutions that are beyond their limits; if `strict`, raise
    UserError for any."""
    from bp2_rl.optimiser.verify import failures

    lines = [
        f"{s.problem.speed:g} m/s: {line}"
        for s in solutions
        for line in failures(s.checks, exact=s.problem.hardware.anatomy.sprung)
    ]
    for line in lines:
        print(line)
    if lines and strict:
        raise UserError(
            f"{len(lines)} figures are beyond their limits: solve again on a finer mesh, into a new folder"
        )
    if not lines:
        print("verified: every figure is within its limit")


def progress_bar() -> Progress:
    """Return a progress bar on standard error."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(file=sys.stderr),
    )


def spinner(text: str) -> Status:
    """Return a spinner on standard error with a text, for work of unknown length."""
    return Console(file=sys.stderr).status(text)


# --- Solutions, wherever they are kept ------------------------------------------------


def load_solutions(path: Path | None) -> list[Solution]:
    """Return the solutions at `path`: a library, a folder or one solution; by default
    the library that ships.

    Raises:
        UserError: there are none, or they cannot be read.
    """
    path = CollocationConfig().file if path is None else path
    try:
        if path.is_dir():
            return _load_folder(path)
        if path.suffix == ".npz" and not path.with_suffix(".json").is_file():
            return load_family(path)
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from error
    return [
        load_solution(
            path.with_suffix("") if path.suffix in (".npz", ".json") else path
        )
    ]


def save_family(path: Path, family: list[Solution], settings: FamilyConfig) -> None:
    """Save a family of solutions as a motion library."""
    save_library(
        path,
        MotionLibrary(**arrays_of(family), provenance=provenance_of(family, settings)),
    )


def load_family(path: Path) -> list[Solution]:
    """Return the solutions in a motion library, slowest first.

    Raises:
        UserError: it cannot be read, or its provenance is not that of its arrays.
    """
    library = load_library(path)
    try:
        return family_of(library.arrays, library.provenance)
    except UserError as error:
        raise broken(path, f"holds a provenance that does not fit ({error})") from error


def _load_folder(folder: Path) -> list[Solution]:
    """Load the cheapest solution for every speed in a folder, slowest first."""
    cards = sorted(folder.glob("speed-*.npz"))
    if not cards:
        raise UserError(
            f"{folder} holds no solutions: run `bp2 trajopt library build --out {folder}`"
        )
    best: dict[float, Solution] = {}
    for solution in (load_solution(card.with_suffix("")) for card in cards):
        speed = solution.problem.speed
        if speed not in best or solution.cost < best[speed].cost:
            best[speed] = solution
    return [best[speed] for speed in sorted(best)]
