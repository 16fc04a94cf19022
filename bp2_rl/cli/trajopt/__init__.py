"""`bp2 trajopt COMMAND`: find trajectories, verify them, build the library of reference
motions.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake
is answered at once.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import make_folder, own_folder
from bp2_rl.cli import app
from bp2_rl.cli.dispatch import Command, choose, entries
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.arguments import (
    OUT,
    Flat,
    Folder,
    Robot,
    Workers,
    named_robot,
    parse_on_robot,
)
from bp2_rl.cli.trajopt.solutions import load_solutions, save_family
from bp2_rl.optimiser.family import FamilyConfig, build_family, steps_of
from bp2_rl.optimiser.problem import Problem, Starts
from bp2_rl.optimiser.solution import save_solution, speed_name
from bp2_rl.robot.named import find_robot


@dataclasses.dataclass(frozen=True)
class SolveArguments:
    """Find the stride that costs least at one speed, by trajectory optimisation; verify
    it and draw it.

    It takes about three minutes of a processor. The solution, a .npz and a .json file,
    and its picture are named after the speed.

    Examples:
        bp2 trajopt solve --speed 8                    # a trot of BP2 at 8 m/s
        bp2 trajopt solve --gait gallop --starts 5 --out reports/gallop
    """

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
        hardware, speed = self.problem.hardware, self.problem.speed
        rate = self.problem.speed_margin * float(np.max(hardware.joint_no_load_speed))
        # two from hip to foot, one from knee to foot
        fastest = rate * 3.0 * hardware.anatomy.leg_length
        if speed > fastest:
            raise UserError(
                f"speed must be at most {fastest:.1f} m/s, as fast as hip and knee move a foot, got {speed:g}"
            )


@dataclasses.dataclass(frozen=True)
class VerifyArguments:
    """Judge solutions by a model that shares no code with the one they were found
    with."""

    path: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SOLUTION_OR_LIBRARY")
    ] = None
    """a solution's .json or .npz, a folder of solutions, or a library; by default the
    library that ships"""


@dataclasses.dataclass(frozen=True)
class LibraryArguments:
    """Build the library of a robot's reference motions: solve the family, verify it,
    write the file.

    A library of BP2 has the speeds asked for. Another robot's goes up to the robot's
    limit, found by walking on until no faster trot solves.

    Interrupted, it goes on where it stopped when run again.
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
        """Refuse impossible values."""
        check_bounds(self)
        if self.to.suffix != ".npz":
            raise UserError(f"--to {self.to}: a library is an .npz file")


def _parse_library(
    arguments: type[LibraryArguments], argv: Sequence[str] | None, prog: str
) -> LibraryArguments:
    """The arguments on the robot that `--robot` names; its folder and file have its
    name unless flags say otherwise."""
    robot = named_robot(argv, prog)
    if robot == arguments.robot:
        return app.parse(arguments, argv, prog)
    name, file = Path(robot).stem, Path(robot)
    default = arguments(
        "build",
        family=FamilyConfig.on(find_robot(robot)),
        robot=robot,
        out=OUT / f"library-{name}",
        to=file.with_name(f"{name}_trot.npz")
        if file.suffix
        else OUT / f"{name}_trot.npz",
    )
    return app.parse(arguments, argv, prog, default)


def _solve(arguments: SolveArguments) -> None:
    """Leave a solution, named after its speed, in the output folder."""
    from bp2_rl.base.plotting import save_figure
    from bp2_rl.optimiser.collocation import refine, solve_best
    from bp2_rl.optimiser.figure import trajectory_figure
    from bp2_rl.optimiser.verify import verify

    solving = (
        f"solving at {arguments.problem.speed:g} m/s from {arguments.starts} starts"
    )
    make_folder(arguments.out)
    with output.spinner(solving):
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


def _verify(arguments: VerifyArguments) -> None:
    """Print every figure and its limit; a figure beyond its limit is a user's mistake
    like any other."""
    solutions = load_solutions(arguments.path)

    from bp2_rl.optimiser.verify import verify

    checked = []
    with output.progress() as progress:
        for solution in progress.track(solutions, description="verifying"):
            checked.append(dataclasses.replace(solution, checks=verify(solution)))
    output.describe(checked)
    output.judge(checked, strict=True)


def _build(arguments: LibraryArguments) -> None:
    """Leave the solutions in their folder and the library in its file."""
    with own_folder(arguments.out):
        make_folder(arguments.to.parent)
        with output.progress() as progress:
            task = progress.add_task("speeds", total=None)
            family = build_family(
                arguments.family,
                arguments.out,
                workers=arguments.workers,
                report=lambda done, total: progress.update(
                    task, completed=done, total=total
                ),
            )
    output.describe(family)
    if arguments.family.fastest is None:
        print(
            f"the robot's limit, less what is left to feedback: {family[-1].problem.speed:g} m/s"
        )
        kept = {speed_name(solution.problem.speed) for solution in family}
        if refused := sorted(
            {path.stem for path in arguments.out.glob("speed-*.json")} - kept
        ):
            print(
                f"left out, as the verifier refuses them ({arguments.out}): {', '.join(refused)}"
            )
    steps = steps_of(family)
    print(
        f"largest step between neighbours: period {max(abs(step.period) for step in steps):.1%}, "
        f"joint angles {max(step.joints for step in steps):.3f} rad"
    )
    output.judge(family, strict=True)
    save_family(arguments.to, family, arguments.family)
    print(f"library: {arguments.to}")


COMMANDS = {
    "solve": Command("bp2 trajopt solve", SolveArguments, _solve, parse_on_robot),
    "verify": Command("bp2 trajopt verify", VerifyArguments, _verify),
    "library": Command("bp2 trajopt library", LibraryArguments, _build, _parse_library),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; return
    its exit status."""
    return choose("bp2 trajopt", entries(COMMANDS), argv)
