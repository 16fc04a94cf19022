"""The figure of learning curves: the speeds that the judge measured of a training's
policies, over control steps and time."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric, table_of
from bp2_rl.base.plotting import FALL, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.learning.judged import read_judged
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import LearningFigureSettings
from bp2_rl.robot.bp2 import OUTDOOR_TOP_SPEED

# letters that a line of the legend has room for, and of those a line's sample takes
LETTERS = 100
SAMPLE = 8
COLORS = (*LEG_COLORS.values(), FALL, INK, QUIET)


@dataclasses.dataclass(frozen=True)
class CurvePoint:
    """A policy on a learning curve: its speed and falls in the judge's launches from a
    stand."""

    steps: int  # control steps before it
    seconds: float  # from when the run's settings were written until it was judged
    speed: float  # m/s, held for 5 s after a launch at 3 m/s2; 0 where it fell
    falls: int  # of all launches


@dataclasses.dataclass(frozen=True)
class Curve:
    """Learning curve of a training: its judged policies by control step."""

    run: str
    judged: tuple[CurvePoint, ...]


@dataclasses.dataclass(frozen=True)
class CurveSummary:
    """The first policy of a training as fast as BP2 outdoors, and the fastest
    policy."""

    run: str = metric("Run", form="s")
    steps: float | None = metric(f"{OUTDOOR_TOP_SPEED:g} m/s after", "M", ".1f")
    seconds: float | None = metric("Known after", "s", ".0f")
    speed: float | None = metric("Its speed", "m/s", ".1f")
    best: float = metric("Best", "m/s", ".1f")
    best_steps: float = metric("After", "M", ".1f")


def learning(settings: LearningFigureSettings) -> Drawn:
    """Draw and tabulate the learning curves of trainings."""
    if not settings.runs:
        raise UserError("--runs: name the folders of one training or more")
    curves = tuple(read_curve(run) for run in settings.runs)
    summaries = [summarise_curve(curve) for curve in curves]
    table = table_of("Policies from a stand, beside their training", summaries)
    picture = learning_figure(curves)
    return Drawn({"curves": curves}, (table,), {"learning": picture})


def summarise_curve(curve: Curve) -> CurveSummary:
    """Return when a training's policies reached BP2's outdoor speed, and the fastest
    policy."""
    reached = [one for one in curve.judged if one.speed >= OUTDOOR_TOP_SPEED]
    first = next(iter(reached), None)
    best = max(curve.judged, key=_speed)
    return CurveSummary(
        curve.run,
        first and first.steps / 1e6,
        first and first.seconds,
        first and first.speed,
        best.speed,
        best.steps / 1e6,
    )


def _speed(policy: CurvePoint) -> float:
    return policy.speed


def read_curve(run: Path) -> Curve:
    """Read a training's learning curve from its judged policies.

    Raises:
        UserError: there is no training, or it had no judge; or its judged.json is
            damaged.
    """
    judged = [
        CurvePoint(
            one.control_steps,
            one.seconds,
            min(one.result.speed, one.result.held),
            one.result.falls,
        )
        for one in read_judged(run).policies
    ]
    if not judged:
        raise UserError(
            f"--runs: no policy of {run} was judged: train with --run.judged 1 or more"
        )
    return Curve(run.resolve().name, tuple(sorted(judged, key=lambda one: one.steps)))


@styled
def learning_figure(curves: Sequence[Curve]) -> Figure:
    """Draw speed over control steps and over time; circles are filled where no launch
    fell."""
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for place, curve in enumerate(curves):
        color = COLORS[place % len(COLORS)]
        _draw(left, [one.steps / 1e6 for one in curve.judged], curve, color)
        _draw(right, [one.seconds / 60.0 for one in curve.judged], curve, color)
    for axes in (left, right):
        axes.axhline(
            OUTDOOR_TOP_SPEED, color=INK, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1
        )
        axes.set(xlim=(0.0, None), ylim=(-0.5, None))
    left.annotate(
        f"BP2: {OUTDOOR_TOP_SPEED:g}",
        (0.0, OUTDOOR_TOP_SPEED),
        xytext=(4, -13),
        textcoords="offset points",
    )
    left.set(xlabel="Control steps [M]", ylabel="Speed held for 5 s [m/s], 0: it fell")
    right.set(xlabel="Minutes until it was known")
    longest = max(len(curve.run) for curve in curves)
    columns = max(1, min(5, LETTERS // (longest + SAMPLE)))
    figure.legend(
        handles=left.get_lines()[: len(curves)],
        loc="outside lower center",
        ncols=columns,
    )
    return figure


def _draw(axes: Axes, at: list[float], curve: Curve, color: str) -> None:
    axes.plot(
        at,
        [one.speed for one in curve.judged],
        color=color,
        linewidth=1.2,
        label=curve.run,
    )
    fills = [color if not one.falls else "white" for one in curve.judged]
    speeds = [one.speed for one in curve.judged]
    axes.scatter(at, speeds, s=18, facecolors=fills, edgecolors=color, zorder=3)
