"""How soon policies run: what the judge beside a training said of them, over control
steps and over time."""

import dataclasses
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.plotting import FALL, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.outcome import NOT_MEASURED, Table, show
from bp2_rl.learning.judged import read_judged
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import LearningSettings
from bp2_rl.robot.bp2 import OUTDOOR_TOP_SPEED

# letters that a line of the legend has room for, and of those a line's sample takes
LETTERS, SAMPLE = 100, 8
COLORS = (*LEG_COLORS.values(), FALL, INK, QUIET)


@dataclasses.dataclass(frozen=True)
class JudgedPolicy:
    """A policy, under the judge's launches from a stand."""

    steps: int  # control steps before it
    seconds: float  # from when the run's settings were written until it was judged
    speed: float  # m/s, held for 5 s after a launch at 3 m/s2; 0 where it fell
    falls: int  # of all launches


@dataclasses.dataclass(frozen=True)
class Curve:
    """A run's policies, the first one first."""

    run: str
    judged: tuple[JudgedPolicy, ...]

    @property
    def reached(self) -> JudgedPolicy | None:
        """The first policy as fast as BP2 outdoors."""
        return next(
            (one for one in self.judged if one.speed >= OUTDOOR_TOP_SPEED), None
        )

    @property
    def best(self) -> JudgedPolicy:
        """The fastest policy."""
        return max(self.judged, key=lambda one: one.speed)


@dataclasses.dataclass(frozen=True)
class LearningNumbers:
    """All that the figure shows."""

    curves: tuple[Curve, ...]


def learning(settings: LearningSettings) -> Drawn:
    """The figure and its table."""
    if not settings.runs:
        raise UserError("--runs: name the folders of one training or more")
    numbers = LearningNumbers(tuple(read_curve(run) for run in settings.runs))
    return Drawn(
        numbers, (_table(numbers),), (), {"learning": learning_figure(numbers)}
    )


def read_curve(run: Path) -> Curve:
    """What the judge said beside a training.

    Raises:
        UserError: there is no training, or it had no judge; or its judged.json is
            damaged.
    """
    judged = [
        JudgedPolicy(one.control_steps, one.seconds, one.result.speed, one.result.falls)
        for one in read_judged(run).policies
    ]
    if not judged:
        raise UserError(
            f"--runs: no policy of {run} was judged: train with --run.judged 1 or more"
        )
    return Curve(run.resolve().name, tuple(sorted(judged, key=lambda one: one.steps)))


def _table(numbers: LearningNumbers) -> Table:
    lines = []
    for curve in numbers.curves:
        first, best = curve.reached, curve.best
        lines.append(
            (
                curve.run,
                NOT_MEASURED if first is None else f"{first.steps / 1e6:.1f} M",
                show(None if first is None else first.seconds, ".0f"),
                NOT_MEASURED if first is None else f"{first.speed:.1f}",
                f"{best.speed:.1f}",
                f"{best.steps / 1e6:.1f} M",
            )
        )
    head = (
        "Run",
        f"{OUTDOOR_TOP_SPEED:g} m/s reached after",
        "Known after [s]",
        "Its speed [m/s]",
        "Best [m/s]",
        "After",
    )
    return Table(
        "Policies from a stand in C MuJoCo, beside their training", head, lines
    )


@styled
def learning_figure(numbers: LearningNumbers) -> Figure:
    """Speed over control steps, and over time; circles are filled where no launch
    fell."""
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for place, curve in enumerate(numbers.curves):
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
    longest = max(len(curve.run) for curve in numbers.curves)
    columns = max(1, min(5, LETTERS // (longest + SAMPLE)))
    figure.legend(
        handles=left.get_lines()[: len(numbers.curves)],
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
