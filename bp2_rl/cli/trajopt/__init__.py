"""`bp2 trajopt WHAT`: find trajectories, verify them, build the library of reference motions, draw what they show."""

import dataclasses
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bp2_rl.assets import asset_path
from bp2_rl.cli import app
from bp2_rl.errors import UserError
from bp2_rl.trajopt.codesign import CodesignSettings
from bp2_rl.trajopt.family import SHIPPED, FamilyConfig
from bp2_rl.trajopt.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.progress import Progress
    from rich.status import Status

    from bp2_rl.trajopt.solution import Solution

OUT = Path("reports/trajopt")
Flat = tyro.conf.arg(name="")
Out = Annotated[Path, tyro.conf.arg(metavar="DIR")]


@dataclasses.dataclass(frozen=True)
class Solve:
    """Find the best trajectory at one speed, verify it, and keep it with its picture."""

    problem: Annotated[Problem, Flat] = Problem()
    starts: int = 3
    """guesses to start from; the cheapest solution is kept"""
    refine: int = 32
    """intervals a segment on which that one is solved again; 0 for not"""
    out: Out = OUT / "solve"


def solve(config: Solve) -> None:
    """Leave a solution, named after its speed, in the output folder."""
    from bp2_rl.trajopt.collocation import refine, solve_best
    from bp2_rl.trajopt.figures import trajectory_figure
    from bp2_rl.trajopt.solution import save_solution
    from bp2_rl.trajopt.verify import verify

    if config.refine == 1 or config.refine < 0:
        raise UserError(f"--refine must be 0 or at least 2 intervals, got {config.refine}")
    _open(config.out)
    with _spinner(f"solving at {config.problem.speed:g} m/s from {config.starts} starts"):
        found = solve_best(config.problem, config.starts)
        if config.refine:
            found = refine(found, config.refine)
        found = dataclasses.replace(found, checks=verify(found))
    path = config.out / f"speed-{found.problem.speed:05.2f}"
    save_solution(path, found)
    _save_figure(trajectory_figure(found), path.with_name(path.name + ".png"))
    _describe([found])
    _judge([found])
    print(f"solution and picture: {path}.*")


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Solve at many speeds, each from several cold starts: how reliably, how fast, how many optima.

    Interrupted, it goes on where it stopped when run again.
    """

    problem: Annotated[Problem, Flat] = Problem()
    slowest: float = 1.0
    """m/s"""
    fastest: float = 13.2
    """m/s"""
    step: float = 1.0
    """m/s"""
    starts: int = 3
    """cold starts at each speed"""
    workers: int = 2
    """processes"""
    out: Out = OUT / "sweep"


def sweep(config: Sweep) -> None:
    """Leave the solutions in the output folder and print how the solves went."""
    import numpy as np

    from bp2_rl.trajopt.sweep import best_of
    from bp2_rl.trajopt.sweep import sweep as attempts_of

    if not 0 < config.slowest <= config.fastest or config.step <= 0:
        raise UserError("a sweep goes from --slowest up to --fastest by a positive --step, all above 0 m/s")
    if config.starts < 1:
        raise UserError(f"--starts must be at least 1, got {config.starts}")
    _open(config.out)
    speeds = np.arange(config.slowest, config.fastest + 1e-9, config.step).round(9).tolist()
    speeds += [config.fastest] if config.fastest > speeds[-1] + 1e-9 else []
    attempts = []
    with _progress() as progress:
        task = progress.add_task("cold starts", total=len(speeds) * config.starts)
        for attempt in attempts_of(config.problem, speeds, config.starts, config.out, config.workers):
            attempts.append(attempt)
            progress.advance(task)
    solved = [attempt for attempt in attempts if attempt.solved]
    if solved:
        _describe(best_of(config.out))
        seconds = [attempt.seconds for attempt in solved]
        print(f"seconds a solve: median {np.median(seconds):.1f}, longest {max(seconds):.1f}")
        print(f"largest constraint violation: {max(attempt.violation for attempt in solved):.1e}")
    for attempt in attempts:
        if not attempt.solved:
            print(f"start {attempt.start}: {attempt.why}")
    print(f"converged: {len(solved)} of {len(attempts)} cold starts ({len(solved) / len(attempts):.1%})")


@dataclasses.dataclass(frozen=True)
class Limits:
    """Find the greatest speed that has a trajectory at all, for BP2 and with one thing about it changed at a time."""

    problem: Annotated[Problem, Flat] = Problem(speed=13.2, intervals=8)
    workers: int = 2
    """processes"""


def limits(config: Limits) -> None:
    """Print the greatest speeds, BP2's own first."""
    from rich.console import Console
    from rich.table import Table

    from bp2_rl.trajopt.limits import CHANGES, NO_SPEED_LIMIT, greatest_speeds

    order = [*CHANGES, NO_SPEED_LIMIT]
    found = {}
    with _progress() as progress:
        task = progress.add_task("variants", total=len(order))
        for limit in greatest_speeds(config.problem, config.workers):
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


@dataclasses.dataclass(frozen=True)
class Verify:
    """Judge solutions by a model that shares no code with the one they were found with."""

    path: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SOLUTION_OR_LIBRARY")] = None
    """a solution's .json or .npz, a folder of solutions, or a library; by default the library that ships"""


def verify(config: Verify) -> None:
    """Print every figure and its limit; a figure beyond its limit is a user's mistake like any other."""
    from bp2_rl.trajopt.verify import verify as figures_of

    solutions = _load(config.path or asset_path(SHIPPED))
    checked = []
    with _progress() as progress:
        for solution in progress.track(solutions, description="verifying"):
            checked.append(dataclasses.replace(solution, checks=figures_of(solution)))
    _describe(checked)
    _judge(checked, strict=True)


@dataclasses.dataclass(frozen=True)
class Schemes:
    """Compare discretisation schemes over meshes: what each leaves of energy, how far off a re-simulation is."""

    speed: float = 10.0
    """m/s"""
    meshes: tuple[int, ...] = (8, 16, 32)
    """intervals a segment"""


def schemes(config: Schemes) -> None:
    """Print the table."""
    from rich.console import Console

    from bp2_rl.trajopt.collocation import solve
    from bp2_rl.trajopt.schemes import SCHEMES, compare_schemes, tabulate_schemes

    if not config.meshes or sorted(config.meshes) != list(config.meshes):
        raise UserError("--meshes: give the coarsest first, as each solve starts from the one before")
    rows = []
    try:
        with _progress() as progress:
            task = progress.add_task("solves", total=len(SCHEMES) * len(config.meshes))
            for row in compare_schemes(solve, Problem(speed=config.speed), config.meshes):
                rows.append(row)
                progress.advance(task)
    finally:  # also what there is when a scheme fails on one of the meshes
        # A number that is cut off is worse than a line that is folded.
        Console(width=max(Console().width, 110)).print(tabulate_schemes(rows))


@dataclasses.dataclass(frozen=True)
class Library:
    """Build the library of reference motions: solve the family, verify it, write the file.

    Interrupted, it goes on where it stopped when run again.
    """

    action: Annotated[Literal["build"], tyro.conf.Positional]
    family: Annotated[FamilyConfig, Flat] = FamilyConfig()
    workers: int = 2
    """processes; more than two do not help"""
    out: Out = OUT / "library"
    """folder of the solutions"""
    to: Annotated[Path, tyro.conf.arg(metavar="FILE")] = OUT / "bp2_trot.npz"
    """the library"""


def library(config: Library) -> None:
    """Build as configured."""
    from bp2_rl.trajopt.family import build_family, save_family, steps_of

    if config.to.suffix != ".npz":
        raise UserError(f"--to {config.to}: a library is an .npz file")
    _open(config.out)
    _open(config.to.parent)
    with _progress() as progress:
        task = progress.add_task("speeds", total=len(config.family.speeds))
        family = build_family(
            config.family,
            config.out,
            workers=config.workers,
            report=lambda done, total: progress.update(task, completed=done, total=total),
        )
    _describe(family)
    steps = steps_of(family)
    print(
        f"largest step between neighbours: period {max(abs(step.period) for step in steps):.1%}, "
        f"joint angles {max(step.joints for step in steps):.3f} rad"
    )
    _judge(family, strict=True)
    save_family(config.to, family, config.family)
    print(f"library: {config.to}")


@dataclasses.dataclass(frozen=True)
class Codesign:
    """Find gear ratio, leg length and spring stiffness along with the trajectory, and scan each."""

    settings: Annotated[CodesignSettings, Flat] = CodesignSettings()
    workers: int = 2
    """processes"""
    out: Out = OUT / "codesign"


def codesign(config: Codesign) -> None:
    """Print the study and leave it with its picture; what was solved before is not solved again."""
    from bp2_rl.trajopt.codesign import study_codesign
    from bp2_rl.trajopt.codesign_figure import codesign_figure

    study = study_codesign(config.settings, config.out, config.workers)
    _save_figure(codesign_figure(study), config.out / "codesign.png")
    print(f"study and picture: {config.out}")


@dataclasses.dataclass(frozen=True)
class Drawings:
    """Draw the paper's figures of a family of trajectories: force decomposition, one stride, the family over speed."""

    path: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP_OR_LIBRARY")] = None
    """a folder of solutions or a library; by default the library that ships"""
    speed: float = 10.0
    """of the stride that is drawn, m/s"""
    out: Out = OUT / "figures"


def figures(config: Drawings) -> None:
    """Draw them and print what the decomposition says."""
    from bp2_rl.trajopt import decomposition
    from bp2_rl.trajopt import figures as drawings

    solutions = _load(config.path or asset_path(SHIPPED))
    shown = min(solutions, key=lambda solution: abs(solution.problem.speed - config.speed))
    if abs(shown.problem.speed - config.speed) > 0.01:
        speeds = ", ".join(f"{solution.problem.speed:g}" for solution in solutions)
        raise UserError(f"--speed {config.speed:g}: there are only {speeds} m/s")
    terms, trends = decomposition.decompose(shown), decomposition.find_trends(solutions)
    for name, figure in (
        ("decomposition", drawings.decomposition_figure(terms, trends)),
        ("trajectory", drawings.trajectory_figure(shown)),
        ("family", drawings.family_figure(solutions)),
    ):
        _save_figure(figure, config.out / f"{name}.png")
    print(f"at {shown.problem.speed:g} m/s, closure of the equations of motion: {terms.closure:.1e} N or Nm")
    print(f"C_z / (m g) at its peak: {decomposition.peak_velocity_force(terms):.2f}")
    coupling = decomposition.coupling_opposes(terms)
    print(
        f"coupled inertia opposes main inertia at {coupling.opposing:.0%} of the hips' peaks and covers "
        f"{coupling.covered:.0%} of it"
    )
    for line in decomposition.remarks(trends):
        print(line)
    print(f"figures: {config.out}")


COMMANDS: dict[str, tuple[type, Callable]] = {
    "solve": (Solve, solve),
    "sweep": (Sweep, sweep),
    "limits": (Limits, limits),
    "verify": (Verify, verify),
    "schemes": (Schemes, schemes),
    "library": (Library, library),
    "codesign": (Codesign, codesign),
    "figures": (Drawings, figures),
}
USAGE = "usage: bp2 trajopt WHAT ...\n\n" + "\n".join(
    f"  {name:8} {(kind.__doc__ or '').splitlines()[0]}" for name, (kind, _) in COMMANDS.items()
)


def main(argv: Sequence[str] | None = None) -> int:
    """The command that `argv` (the process's arguments by default) names; its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        print(USAGE, file=sys.stderr)
        return app.WRONG_INPUT
    name, rest = arguments[0], arguments[1:]
    if name in app.HELP:
        print(USAGE + "\n\n`bp2 trajopt WHAT --help` lists the flags.")
        return app.OK
    if name not in COMMANDS:
        print(f"error: no command {name!r}; bp2 trajopt has: {', '.join(COMMANDS)}", file=sys.stderr)
        return app.WRONG_INPUT
    kind, command = COMMANDS[name]
    return app.run(lambda: command(app.parse(kind, rest, f"bp2 trajopt {name}")))


def _load(path: Path) -> "list[Solution]":
    """The solutions at `path`: a library, a folder of solutions, or a single one."""
    from bp2_rl.trajopt.family import load_family
    from bp2_rl.trajopt.solution import load_solution
    from bp2_rl.trajopt.sweep import best_of

    if path.is_dir():
        if (path / "sweep.json").is_file():
            return best_of(path)
        cards = sorted(path.glob("speed-*.npz"))
        if not cards:
            raise UserError(f"{path} holds no solutions: run `bp2 trajopt sweep --out {path}`")
        return [load_solution(card.with_suffix("")) for card in cards]
    if path.suffix == ".npz" and not path.with_suffix(".json").is_file():
        return load_family(path)
    return [load_solution(path.with_suffix("") if path.suffix in (".npz", ".json") else path)]


def _describe(solutions: "Sequence[Solution]") -> None:
    """A row for each solution."""
    from rich.console import Console
    from rich.table import Table

    from bp2_rl.trajopt.verify import summarise

    table = Table("m/s", "period", "duty", "torque", "force", "energy", "re-simulation", "cost", "s")
    for solution in solutions:
        summary, checks = summarise(solution), solution.checks
        table.add_row(
            f"{solution.problem.speed:g}",
            f"{summary['period']:.3f} s",
            f"{summary['duty']:.3f}",
            f"{summary['peak_torque']:.0f} Nm",
            f"{summary['peak_force']:.0f} N",
            f"{checks['energy_residual']:.1e}",
            f"{checks['position_error']:.1e} / {checks['velocity_error']:.1e}",
            f"{solution.cost:.3f}",
            f"{solution.seconds:.1f}",
        )
    Console().print(table)


def _judge(solutions: "Sequence[Solution]", *, strict: bool = False) -> None:
    """Say which figures are beyond their limits; if strict, that ends the command."""
    from bp2_rl.trajopt.verify import failures

    lines = [f"{s.problem.speed:g} m/s: {line}" for s in solutions for line in failures(s.checks)]
    for line in lines:
        print(line)
    if lines and strict:
        raise UserError(f"{len(lines)} figures are beyond their limits: solve again on a finer mesh, into a new folder")
    if not lines:
        print("verified: every figure is within its limit")


def _open(folder: Path) -> None:
    """Make a folder, before anything is solved for it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror}; choose another folder") from error


def _progress() -> "Progress":
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
    )


def _spinner(text: str) -> "Status":
    from rich.console import Console

    return Console(stderr=True).status(text)


def _save_figure(figure: "Figure", path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
