"""What a solved problem is: a stride on its mesh, how to read it between the mesh's points, and how to keep it."""

import contextlib
import dataclasses
import importlib.metadata
import json
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bp2_rl import config
from bp2_rl.errors import UserError
from bp2_rl.files import write_text
from bp2_rl.trajopt.problem import Problem

FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A stride on its mesh. Axes: segment, point of the segment, then what the name says.

    Coordinates, motors and contact coordinates are in the order of `Stride.legs`; see `sagittal` for their meaning.
    """

    durations: np.ndarray  # (segments,) s
    q: np.ndarray  # (segments, points, nq) m, rad
    v: np.ndarray  # (segments, points, nq) m/s, rad/s
    a: np.ndarray  # (segments, points, nq) m/s2, rad/s2
    tau: np.ndarray  # (segments, points, 2 legs) Nm
    force: np.ndarray  # (segments, points, 2 legs) N, (x, z) of each leg; zero in swing
    impulse: np.ndarray  # (segments, 2 legs) N s, at the beginning of each segment


class Moment(NamedTuple):
    """A trajectory at some instants of one segment; axes: instant, then as in `Trajectory`."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    force: np.ndarray


@dataclasses.dataclass(frozen=True)
class Solution:
    """A trajectory that satisfies its problem."""

    problem: Problem
    trajectory: Trajectory
    cost: float
    violation: float  # largest violation of any constraint, in the program's own scaled units
    iterations: int
    seconds: float  # wall time of the solve
    checks: dict[str, float] = dataclasses.field(default_factory=dict)  # what verify.py measured

    @property
    def period(self) -> float:
        """Duration of a whole gait cycle, s."""
        return float(np.sum(self.trajectory.durations)) / self.problem.stride.cycles

    @property
    def duty(self) -> float:
        """Share of the cycle that a foot spends on the ground: that of the first leg that stands."""
        stride = self.problem.stride
        leg = stride.standing[0][0]
        standing = [leg in feet for feet in stride.standing]
        return float(np.sum(self.trajectory.durations[standing])) / self.period


def sample(problem: Problem, trajectory: Trajectory, segment: int, share: np.ndarray) -> Moment:
    """The trajectory at shares (0 to 1) of a segment, by the polynomials that its scheme stands for.

    Hermite-Simpson: q and v cubic, tau, force and a quadratic in each interval. Trapezoid: v quadratic, the others
    linear. The paper's scheme: v linear, tau, force and a constant. q is always the cubic through its ends' q and v.
    """
    duration, intervals = trajectory.durations[segment], problem.intervals
    position = np.clip(share, 0.0, 1.0) * intervals
    k = np.minimum(position.astype(int), intervals - 1)
    s = (position - k)[:, None]
    h = duration / intervals
    step = 2 if problem.scheme == "hermite-simpson" else 1

    def ends(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[segment, step * k], x[segment, step * k + step]

    def linear(x: np.ndarray) -> np.ndarray:
        left, right = ends(x)
        return left + s * (right - left)

    def held(x: np.ndarray) -> np.ndarray:
        return ends(x)[0]

    def quadratic(x: np.ndarray) -> np.ndarray:
        left, right = ends(x)
        middle = x[segment, 2 * k + 1]
        return left * (1 - s) * (1 - 2 * s) + middle * 4 * s * (1 - s) + right * s * (2 * s - 1)

    def cubic(x: np.ndarray, rate: np.ndarray) -> np.ndarray:
        (left, right), (out, into) = ends(x), ends(rate)
        return (
            left * (1 + 2 * s) * (1 - s) ** 2
            + right * s**2 * (3 - 2 * s)
            + h * (out * s * (1 - s) ** 2 - into * s**2 * (1 - s))
        )

    rule = {"hermite-simpson": quadratic, "trapezoid": linear, "paper": held}[problem.scheme]
    return Moment(
        q=cubic(trajectory.q, trajectory.v),
        v=linear(trajectory.v) if problem.scheme == "paper" else cubic(trajectory.v, trajectory.a),
        a=rule(trajectory.a),
        tau=rule(trajectory.tau),
        force=rule(trajectory.force),
    )


def resample(problem: Problem, trajectory: Trajectory, onto: Problem) -> Trajectory:
    """The trajectory on the mesh of another problem with the same stride."""
    segments = range(len(trajectory.durations))
    moments = [sample(problem, trajectory, segment, onto.points) for segment in segments]
    q, v, a, tau, force = (np.stack(parts) for parts in zip(*moments, strict=True))
    return Trajectory(trajectory.durations, q, v, a, tau, force, trajectory.impulse)


def save_solution(path: Path, solution: Solution) -> None:
    """Write `path`.npz with the arrays and `path`.json with problem, figures and versions; each whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {field.name: getattr(solution.trajectory, field.name) for field in dataclasses.fields(Trajectory)}
    temporary = path.with_name(f".{path.name}.tmp.npz")
    np.savez_compressed(temporary, **arrays)
    temporary.replace(path.with_name(path.name + ".npz"))
    facts = {name: getattr(solution, name) for name in ("cost", "violation", "iterations", "seconds", "checks")}
    card = {"format": FORMAT, "problem": config.to_json(solution.problem), **facts, "versions": versions()}
    write_text(path.with_name(path.name + ".json"), json.dumps(card, indent=2) + "\n")


def load_solution(path: Path) -> Solution:
    """The solution that `save_solution` wrote to `path`.

    Raises:
        UserError: a file is missing, broken, or of another format.
    """
    try:
        card = json.loads(path.with_name(path.name + ".json").read_text(encoding="utf-8"))
        # Opened here, as np.load leaves what it cannot read open.
        with path.with_name(path.name + ".npz").open("rb") as stream, np.load(stream) as arrays:
            trajectory = Trajectory(**{field.name: arrays[field.name] for field in dataclasses.fields(Trajectory)})
        if card["format"] != FORMAT:
            raise UserError(f"solution {path} has format {card['format']}, this version reads {FORMAT}: solve it again")
        if not all(np.isfinite(getattr(trajectory, field.name)).all() for field in dataclasses.fields(Trajectory)):
            raise UserError(f"solution {path} holds numbers that are not finite: solve it again")
        facts: dict[str, Any] = {name: card[name] for name in ("cost", "violation", "iterations", "seconds", "checks")}
        return Solution(config.from_json(Problem, card["problem"]), trajectory, **facts)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"solution {path} cannot be read ({error}): solve it again") from error


def versions() -> dict[str, str]:
    """The versions that a solution depends on."""
    found = {"bp2_rl": config.package_versions()["bp2_rl"], "numpy": np.__version__}
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        found["casadi"] = importlib.metadata.version("casadi")
    return found
