"""The solution of a problem: a stride on its mesh, its values between the mesh's
points, and its files."""

import contextlib
import dataclasses
import hashlib
import importlib.metadata
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base import serialization as config
from bp2_rl.base.arrays import hermite_and_rate, line, parabola
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import ArraySpec, read_bytes, read_json, read_npz, write_npz
from bp2_rl.optimiser.problem import Problem

FORMAT = 1
REMEDY = "solve it again"


class NotSolved(UserError):
    """Raised when IPOPT finds no trajectory; the message says how it ended."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """A stride on its mesh. Coordinates, motors and contact coordinates are in the
    order of `Stride.legs`; what they mean is said in `sagittal`. Contact coordinates
    are (x, z) of each leg in turn.
    """

    durations: Float[np.ndarray, " segments"]  # s
    q: Float[np.ndarray, "segments points nq"]  # m, rad
    v: Float[np.ndarray, "segments points nq"]  # m/s, rad/s
    a: Float[np.ndarray, "segments points nq"]  # m/s2, rad/s2
    tau: Float[np.ndarray, "segments points motors"]  # Nm
    force: Float[np.ndarray, "segments points contacts"]  # N; zero in swing
    # N s, at the beginning of each segment
    impulse: Float[np.ndarray, "segments contacts"]

    @property
    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """Return the motion's arrays by name."""
        return {name: getattr(self, name) for name in ARRAYS}


Points = Float[np.ndarray, "segments points _"]
Instants = Float[np.ndarray, "instants _"]
ARRAYS = tuple(field.name for field in dataclasses.fields(Motion))


class StrideMoment(NamedTuple):
    """A motion at some instants in a segment, in the columns of `Motion`."""

    q: Float[np.ndarray, "instants nq"]
    v: Float[np.ndarray, "instants nq"]
    a: Float[np.ndarray, "instants nq"]
    tau: Float[np.ndarray, "instants motors"]
    force: Float[np.ndarray, "instants contacts"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SolveStatistics:
    """Cost, constraint violation, iterations and time of a solve, and what the verifier
    measured."""

    cost: float
    # largest violation of any constraint, in the program's own scaled units
    violation: float
    iterations: int
    seconds: float  # wall time of the solve
    # what verify.py measured
    checks: dict[str, float] = dataclasses.field(default_factory=dict[str, float])

    @property
    def statistics(self) -> "SolveStatistics":
        """Return these numbers alone, without the motion."""
        names = (field.name for field in dataclasses.fields(SolveStatistics))
        return SolveStatistics(**{name: getattr(self, name) for name in names})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Solution(SolveStatistics):
    """A motion that satisfies its problem, and how it was solved."""

    problem: Problem
    motion: Motion

    @property
    def period(self) -> float:
        """Duration of a whole gait cycle, s."""
        return float(np.sum(self.motion.durations)) / self.problem.stride.cycles

    @property
    def duty(self) -> float:
        """Share of the cycle that a foot spends on the ground, mean over the feet."""
        stride = self.problem.stride
        # of half a cycle, the other half has as many
        feet = [len(standing) for standing in stride.standing]
        return (
            float(np.sum(feet * self.motion.durations))
            / stride.cycles
            / len(stride.legs)
            / self.period
        )


# --- Between the mesh's points --------------------------------------------------------


def sample(
    problem: Problem,
    motion: Motion,
    segment: int,
    share: Float[np.ndarray, " instants"],
) -> StrideMoment:
    """Return the motion at shares (0 to 1) of a segment, by the polynomials that the
    problem's scheme stands for.

    Hermite-Simpson: q and v cubic, tau, force and a quadratic in each interval.
    Trapezoid: v quadratic, the others linear. The paper's scheme: v linear, tau, force
    and a constant. q is always the cubic through its ends' q and v.
    """
    duration, intervals = motion.durations[segment], problem.intervals
    position = np.clip(share, 0.0, 1.0) * intervals
    k = np.minimum(position.astype(int), intervals - 1)
    s = (position - k)[:, None]
    h = duration / intervals
    step = 2 if problem.scheme == "hermite-simpson" else 1

    def ends(x: Points) -> tuple[Instants, Instants]:
        return x[segment, step * k], x[segment, step * k + step]

    def linear(x: Points) -> Instants:
        return line(s, *ends(x))

    def held(x: Points) -> Instants:
        return ends(x)[0]

    def quadratic(x: Points) -> Instants:
        left, right = ends(x)
        return parabola(s, left, x[segment, 2 * k + 1], right)

    def cubic(x: Points, rate: Points) -> Instants:
        return hermite_and_rate(s, h, *ends(x), *ends(rate))[0]

    rule = {"hermite-simpson": quadratic, "trapezoid": linear, "paper": held}[
        problem.scheme
    ]
    return StrideMoment(
        q=cubic(motion.q, motion.v),
        v=linear(motion.v) if problem.scheme == "paper" else cubic(motion.v, motion.a),
        a=rule(motion.a),
        tau=rule(motion.tau),
        force=rule(motion.force),
    )


def resample(problem: Problem, motion: Motion, onto: Problem) -> Motion:
    """The motion on the mesh of another problem with the same stride."""
    segments = range(len(motion.durations))
    moments = [sample(problem, motion, segment, onto.points) for segment in segments]
    q, v, a, tau, force = (np.stack(parts) for parts in zip(*moments, strict=True))
    return Motion(motion.durations, q, v, a, tau, force, motion.impulse)


# --- On disk --------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Card(SolveStatistics):
    """The JSON file beside the arrays of a solution."""

    format: int
    problem: Problem
    versions: dict[str, str]
    # of the .npz file; empty on cards of versions that kept none
    arrays_sha256: str = ""


def save_solution(path: Path, solution: Solution) -> None:
    """Write `path`.npz with the arrays and `path`.json, its card, with problem, figures
    and versions.

    An old card goes first and the new one comes last, so that there is none of other
    arrays wherever this is killed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays, card = _beside(path, ".npz"), _beside(path, ".json")
    card.unlink(missing_ok=True)
    write_npz(arrays, solution.motion.arrays, compressed=True)
    digest = hashlib.sha256(read_bytes(arrays)).hexdigest()
    about = _Card(
        **vars(solution.statistics),
        format=FORMAT,
        problem=solution.problem,
        versions=versions(),
        arrays_sha256=digest,
    )
    config.save_config(card, about)


def load_solution(path: Path, problem: Problem | None = None) -> Solution:
    """Read the solution that `save_solution` wrote to `path`.

    Args:
        path: without suffix.
        problem: what it must be a solution of, if that is known.

    Raises:
        UserError: a file is missing, broken, of another format, or holds the solution
            of another problem.
    """
    try:
        written = read_json(_beside(path, ".json"))
        if isinstance(written, dict) and written.get("format") != FORMAT:
            raise UserError(
                f"it has format {written.get('format')!r}, this version reads {FORMAT}"
            )
        card = config.from_json(_Card, written)
        content = read_bytes(_beside(path, ".npz"))
        if card.arrays_sha256 not in ("", hashlib.sha256(content).hexdigest()):
            raise UserError("its arrays are not those that its card was written for")
        motion = Motion(
            **read_npz(
                _beside(path, ".npz"), array_specs(card.problem), content=content
            )
        )
        for name, array in motion.arrays.items():
            if not np.isfinite(array).all():
                raise UserError(f"it holds numbers in {name} that are not finite")
    except UserError as error:
        raise UserError(
            f"solution {path} cannot be read ({error}): {REMEDY}"
        ) from error
    if problem is not None and card.problem != problem:
        raise UserError(
            f"{path} holds the solution of another problem, at {card.problem.speed:.9g} m/s: "
            "choose another folder or remove it"
        )
    return Solution(problem=card.problem, motion=motion, **vars(card.statistics))


def is_saved(path: Path) -> bool:
    """Return whether `save_solution` has written `path` completely."""
    return _beside(path, ".json").is_file()


def speed_name(speed: float) -> str:
    """Return a speed as a file's name, exact, and in order up to 100 m/s; such as
    speed-08.50 or speed-10.003."""
    whole, _, decimals = format(Decimal(repr(speed)), "f").partition(".")
    return f"speed-{whole:0>2}.{decimals:0<2}"


def array_specs(problem: Problem) -> dict[str, ArraySpec]:
    """Return types and shapes of the arrays of a problem's solution."""
    stride = problem.stride
    segments = len(stride.standing)
    points = len(problem.points)
    both = 2 * len(stride.legs)
    shapes = {
        "durations": (segments,),
        **dict.fromkeys("qva", (segments, points, stride.nq)),
        **dict.fromkeys(("tau", "force"), (segments, points, both)),
        "impulse": (segments, both),
    }
    return {name: ArraySpec(np.floating, shape) for name, shape in shapes.items()}


def versions() -> dict[str, str]:
    """Return the versions of the packages that a solution depends on."""
    packages = {"bp2_rl": config.package_versions()["bp2_rl"], "numpy": np.__version__}
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        packages["casadi"] = importlib.metadata.version("casadi")
    return packages


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)
