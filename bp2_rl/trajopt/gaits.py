"""Is it the trot that limits BP2? Trot, bound and pronk in the plane: what each costs over speed, and how fast it gets.

A bound is the model of half a robot on a fore and a hind leg half a cycle apart ("two-leg"), a pronk that on both at
once; with left and right alike the other half does the same. In the plane right and left legs of one end cannot be
told apart, so a pace is a trot with other pairs and has the same trajectories. What a plane cannot know is roll, and
how a pace or a gallop holds it: greatest speeds are upper bounds.

The objective counts every segment alike, and gaits have different numbers of them. So gaits are set beside each other
by the mean over time of its running cost.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from bp2_rl import config
from bp2_rl.trajopt.described import Gait as Described
from bp2_rl.trajopt.described import describe
from bp2_rl.trajopt.problem import Gait, Problem
from bp2_rl.trajopt.solution import NotSolved, Solution, is_saved, load_solution, save_solution, speed_name

GAITS: dict[str, Gait] = {"trot (and pace)": "trot", "bound": "two-leg", "pronk": "pronk"}
GREATEST = "greatest"  # name of the file


@dataclasses.dataclass(frozen=True)
class GaitRow:
    """A gait at a speed."""

    name: str
    speed: float | None  # m/s, asked for or, of the greatest, found
    greatest: bool
    described: Described | None  # None where no trajectory was found
    pitch: tuple[float, float] | None  # rad, least and greatest; nose down is positive


@dataclasses.dataclass(frozen=True)
class GaitNumbers:
    """A whole comparison."""

    problem: Problem
    speeds: tuple[float, ...]  # m/s
    rows: tuple[GaitRow, ...]


def compare_gaits(problem: Problem, speeds: Sequence[float], folder: Path) -> Iterator[GaitRow]:
    """A row for each gait and speed, and for each gait's greatest speed, as they are found.

    Each is the cheaper of two searches, from the cold guess and from the speed before; a greatest speed is the better
    of what the last two speeds lead to. Solutions are kept in `folder`, and what is there is not solved again.

    Raises:
        UserError: the folder holds gaits of another problem.
    """
    from bp2_rl.trajopt.collocation import fastest, solve  # CasADi, where something is solved

    config.claim_folder(folder, "problem.json", problem, "gaits")
    for name, gait in GAITS.items():
        found: list[Solution] = []
        for speed in speeds:
            asked = dataclasses.replace(problem, gait=gait, speed=speed)
            starts = [None, *(solution.motion for solution in found[-1:])]
            tries = [lambda start=start, asked=asked: solve(asked, start) for start in starts]
            solution = _kept(folder / gait / speed_name(speed), tries, lambda solution: -solution.cost)
            found += [] if solution is None else [solution]
            yield _row(name, speed, solution, greatest=False)
        tries = [lambda start=start: fastest(start) for start in found[-2:]]
        top = _kept(folder / gait / GREATEST, tries, lambda solution: solution.problem.speed)
        yield _row(name, None if top is None else top.problem.speed, top, greatest=True)


def _kept(path: Path, tries: Sequence[Callable[[], Solution]], worth: Callable[[Solution], float]) -> Solution | None:
    """The solution that is kept there, or else the worthiest of the tries, which is then kept; None of none."""
    if is_saved(path):
        return load_solution(path)
    found = []
    for solve_it in tries:
        try:
            found.append(solve_it())
        except NotSolved:
            continue
    best = max(found, key=worth, default=None)
    if best is not None:
        save_solution(path, best)
    return best


def _row(name: str, speed: float | None, solution: Solution | None, *, greatest: bool) -> GaitRow:
    if solution is None:
        return GaitRow(name, speed, greatest, None, None)
    pitch = solution.motion.q[..., 2]
    return GaitRow(name, speed, greatest, describe(solution), (float(np.min(pitch)), float(np.max(pitch))))


def tabulate_gaits(rows: Sequence[GaitRow]) -> Table:
    """A line for each row."""
    table = Table("gait", "m/s", "R", "work / m g d", "period", "duty", "peak torque", "RMS", "force", "pitch")
    for row in rows:
        speed = "greatest" if row.speed is None else f"{row.speed:.2f}, greatest" if row.greatest else f"{row.speed:g}"
        gait = row.described
        if gait is None or row.pitch is None:
            table.add_row(row.name, speed, "not found")
            continue
        table.add_row(
            row.name,
            speed,
            f"{gait.running_cost:.2f}",
            f"{gait.positive:.3f}",
            f"{gait.period:.3f} s",
            f"{gait.duty:.3f}",
            f"{gait.peak_torque:.0f} Nm",
            f"{gait.rms_torque:.0f} Nm",
            f"{gait.peak_force:.0f} N",
            f"{np.rad2deg(row.pitch[0]):+.1f} to {np.rad2deg(row.pitch[1]):+.1f} deg",
        )
    return table
