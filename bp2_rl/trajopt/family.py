"""One smooth family of trajectories over speed: the library that serves as reference motion.

At each speed alone, neighbouring optima can differ by a lot: below 9 m/s several families of nearly equal cost exist,
with other postures, periods and springs that bounce in swing. The library follows one of them. It begins with the best
trajectory at the anchor's speed and walks from there to both ends, each step from its neighbour and, by a term beside
the cost, near to it. What that costs is in the provenance: `cost` is without the term.

The motions leave feedback something to work with: a tenth of the motors' torque and speed, and some friction.
"""

import concurrent.futures
import dataclasses
import itertools
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bp2_rl import config
from bp2_rl.errors import UserError
from bp2_rl.robot import specs
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.trajopt.problem import Problem, motor_coordinates
from bp2_rl.trajopt.solution import Solution, Trajectory, load_solution, save_solution, versions
from bp2_rl.trajopt.verify import verify
from bp2_rl.workers import spawned

FORMAT = 1
SHIPPED = "reference_motions/bp2_trot.npz"

RESERVED = HardwareSpec(peak_torque=0.9 * specs.PEAK_TORQUE, friction=0.7)
"""BP2 with what the library leaves to feedback taken away; its speed margin is in `FamilyConfig.problem`."""


@dataclasses.dataclass(frozen=True)
class FamilyConfig:
    """Which speeds the library has, and how it walks from one to the next."""

    slowest: float = 0.5  # m/s
    fastest: float = 15.0  # m/s
    step: float = 0.5  # m/s
    anchor: float = 10.0  # m/s, where the walk begins
    starts: int = 3  # guesses at the anchor
    coarse: int = 8  # intervals a segment, for those
    proximity: float = 10.0  # weight of staying near the neighbour
    problem: Problem = Problem(intervals=40, hardware=RESERVED, speed_margin=0.9)  # at all speeds alike

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field."""
        if not 0 < self.slowest <= self.anchor <= self.fastest:
            raise UserError(
                f"slowest ({self.slowest}), anchor ({self.anchor}) and fastest ({self.fastest}) must be in this order "
                "and positive"
            )
        if not self.step > 0:
            raise UserError(f"step must be positive, got {self.step}")
        if self.problem.stride.cycles != 0.5:
            raise UserError("the library is of trots, as left and right change places after half a cycle")

    @property
    def speeds(self) -> list[float]:
        """All speeds, ascending, m/s."""
        return sorted({*self._walk(self.slowest), *self._walk(self.fastest)})

    def walks(self) -> list[list[float]]:
        """The speeds from the anchor to the slowest and to the fastest, anchor included."""
        return [self._walk(self.slowest), self._walk(self.fastest)]

    def _walk(self, end: float) -> list[float]:
        count = round(abs(end - self.anchor) / self.step + 0.4999)  # the last step may be shorter
        steps = [self.anchor + (1 if end > self.anchor else -1) * self.step * i for i in range(count)]
        return [round(speed, 9) for speed in [*steps, end]]


def build_family(
    settings: FamilyConfig, folder: Path, *, workers: int = 2, report: Callable[[int, int], None] | None = None
) -> list[Solution]:
    """Solve and verify the family, a file for each speed in `folder`; those that are there already are kept.

    Args:
        settings: which family.
        folder: of the solutions; made if need be. One that holds a family of other settings is refused.
        workers: processes; the two walks are independent, so a third has nothing to do.
        report: called with (speeds done, speeds in all) now and then.

    Returns:
        The solutions, slowest first, each with verify's figures as its checks.

    Raises:
        NotSolved: IPOPT found no way on, even by smaller steps.
        UserError: the folder belongs to another family.
    """
    _claim(folder, settings)
    with spawned(min(workers, 2)) as pool:
        _solve_anchor(settings, folder)
        walks = [pool.submit(_walk, settings, folder, speeds) for speeds in settings.walks()]
        while True:
            waiting = concurrent.futures.wait(walks, timeout=0.5, return_when="FIRST_EXCEPTION")
            if report is not None:
                report(sum(_is_solved(folder, speed) for speed in settings.speeds), len(settings.speeds))
            if not waiting.not_done or any(walk.exception() for walk in waiting.done):
                break
        for walk in walks:
            walk.result()
    return [load_solution(_path(folder, speed)) for speed in settings.speeds]


def save_family(path: Path, family: list[Solution], settings: FamilyConfig) -> None:
    """Write the library: one .npz with the arrays of `bp2_rl.gait.collocation.library` and their provenance as JSON."""
    arrays: dict[str, Any] = {
        field.name: np.stack([getattr(solution.trajectory, field.name) for solution in family])
        for field in dataclasses.fields(Trajectory)
    }
    speeds = [solution.problem.speed for solution in family]
    facts = [
        {name: getattr(solution, name) for name in ("cost", "violation", "iterations", "seconds", "checks")}
        for solution in family
    ]
    provenance = {
        "settings": config.to_json(settings),
        "solutions": facts,
        "versions": versions(),
        "schema": "axes: speed, segment of half a gait cycle, point (equally spaced in time), then coordinate. See "
        "bp2_rl/gait/library.py.",
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp.npz")
    np.savez_compressed(
        temporary,
        format=np.asarray(FORMAT),
        speeds=np.asarray(speeds),
        provenance=np.asarray(json.dumps(provenance)),
        **arrays,
    )
    os.replace(temporary, path)


def load_family(path: Path) -> list[Solution]:
    """The solutions in a library file, for verification and figures.

    Raises:
        UserError: the file is missing, broken, or of another format.
    """
    try:
        # Opened here, as np.load leaves what it cannot read open.
        with path.open("rb") as stream, np.load(stream) as file:
            arrays = {name: file[name] for name in file.files}
        if int(arrays["format"]) != FORMAT:
            raise UserError(f"library {path} has format {int(arrays['format'])}, this version reads {FORMAT}")
        provenance: dict[str, Any] = json.loads(str(arrays["provenance"]))
        settings = config.from_json(FamilyConfig, provenance["settings"])
        parts = {field.name: arrays[field.name] for field in dataclasses.fields(Trajectory)}
        speeds = [float(speed) for speed in arrays["speeds"]]
        return [
            Solution(
                settings.problem.at(speed),
                Trajectory(**{name: part[i] for name, part in parts.items()}),
                **provenance["solutions"][i],
            )
            for i, speed in enumerate(speeds)
        ]
    except (OSError, ValueError, KeyError, IndexError, TypeError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(
            f"library {path} cannot be read ({error}): build it with `bp2 trajopt library build`"
        ) from error


@dataclasses.dataclass(frozen=True)
class Steps:
    """How two neighbours of a family differ."""

    speed: float  # m/s, of the faster
    period: float  # relative change
    joints: float  # rad, root mean square over phase, of the joint that changes most


def steps_of(family: list[Solution]) -> list[Steps]:
    """How smooth a family is."""
    return [
        Steps(
            faster.problem.speed,
            faster.period / slower.period - 1.0,
            _joint_distance(slower, faster),
        )
        for slower, faster in itertools.pairwise(family)
    ]


def _joint_distance(one: Solution, other: Solution) -> float:
    motors = motor_coordinates(one.problem.stride.legs)
    away = (one.trajectory.q - other.trajectory.q)[..., motors]
    share = np.stack([s.trajectory.durations / np.sum(s.trajectory.durations) for s in (one, other)]).mean(axis=0)
    return float(np.sqrt(np.max(np.mean(away**2, axis=1).T @ share)))


def _solve_anchor(settings: FamilyConfig, folder: Path) -> None:
    from bp2_rl.trajopt.collocation import refine, solve_best  # CasADi only where something is solved

    if _is_solved(folder, settings.anchor):
        return
    problem = settings.problem.at(settings.anchor)
    best = solve_best(problem.on_mesh(min(settings.coarse, problem.intervals)), settings.starts)
    _keep(folder, refine(best, problem.intervals))


def _walk(settings: FamilyConfig, folder: Path, speeds: list[float]) -> None:
    """Solve one speed after the other, each from the one before."""
    from bp2_rl.trajopt.collocation import NotSolved, solve

    def step(here: Solution, speed: float, halvings: int) -> Solution:
        try:
            return solve(settings.problem.at(speed), here.trajectory, proximity=settings.proximity)
        except NotSolved:
            if halvings == 0:
                raise
        between = step(here, (here.problem.speed + speed) / 2.0, halvings - 1)
        return step(between, speed, halvings - 1)

    here = load_solution(_path(folder, speeds[0]))
    for speed in speeds[1:]:
        if _is_solved(folder, speed):
            here = load_solution(_path(folder, speed))
        else:
            here = step(here, speed, halvings=2)
            _keep(folder, here)


def _keep(folder: Path, solution: Solution) -> None:
    save_solution(_path(folder, solution.problem.speed), dataclasses.replace(solution, checks=verify(solution)))


def _claim(folder: Path, settings: FamilyConfig) -> None:
    """Make the folder this family's."""
    card = folder / "family.json"
    if card.is_file() and config.load_config(FamilyConfig, card) != settings:
        raise UserError(f"{folder} holds a family of other settings (see {card}): choose another folder or remove it")
    folder.mkdir(parents=True, exist_ok=True)
    config.save_config(card, settings)


def _path(folder: Path, speed: float) -> Path:
    return folder / f"speed-{speed:05.2f}"


def _is_solved(folder: Path, speed: float) -> bool:
    path = _path(folder, speed)
    return path.with_name(path.name + ".json").is_file()
