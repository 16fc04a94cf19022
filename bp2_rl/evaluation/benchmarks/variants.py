"""Measurement and figure of runs with a variant of the robot or of the physics."""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import FALL, FRONT, INK, WIDTH, legend_above, styled
from bp2_rl.evaluation.races import TRACK
from bp2_rl.simulation.measuring import measure_lane, time_at
from bp2_rl.simulation.metrics import RunMetrics
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.trajectory import Trajectory

HEIGHT = 0.3  # inches, of a line


class VariantRun(NamedTuple):
    """The figures of merit of a run with a variant of the robot or of the physics."""

    metrics: RunMetrics
    time_100m: float | None  # s; None if it did not come so far
    lane_kept: bool


def measure_variant(_: RunRequest, run: Trajectory) -> VariantRun:
    """Measure a run with a variant: figures of merit, time over 100 m, and whether the
    lane was kept."""
    return VariantRun(run.metrics, time_at(run, TRACK), measure_lane(run).kept)


class Dots(NamedTuple):
    """A figure of merit for all variants, drawn as dots; None where a variant has
    none."""

    label: str
    values: Sequence[float | None]
    hollow: bool = False


class Panel(NamedTuple):
    """One column of the figure of variants, with its dots; a cross marks a variant
    without any."""

    title: str
    label: str
    series: Sequence[Dots]
    reference: float | None  # where a line is drawn
    most: float | None = None  # what lies beyond is an arrowhead at the edge


@styled
def variants_figure(names: Sequence[str], panels: Sequence[Panel]) -> Figure:
    """Draw the figures of merit of all variants, one row for each variant."""
    size = WIDTH, 1.1 + HEIGHT * len(names)
    figure = Figure(figsize=size, layout="constrained")
    columns = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, panel in zip(columns, panels, strict=True):
        for dots in panel.series:
            _draw_dots(axes, dots, panel.most)
        for place, values in enumerate(
            zip(*(x.values for x in panel.series), strict=True)
        ):
            if all(value is None for value in values):
                across = axes.get_yaxis_transform()
                axes.plot(0.03, place, "X", ms=8, color=FALL, transform=across)
        if panel.reference is not None:
            axes.axvline(panel.reference, color=INK, linewidth=1.0, zorder=0.9)
        axes.margins(x=0.12)
        axes.set(title=panel.title, xlabel=panel.label)
        axes.tick_params(axis="y", length=0)
        legend_above(axes)
    columns[0].set(
        yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5)
    )
    return figure


def _draw_dots(axes: Axes, dots: Dots, most: float | None) -> None:
    fill = "white" if dots.hollow else FRONT
    for place, value in enumerate(dots.values):
        if value is None:
            continue
        if most is None or value <= most:
            axes.plot(value, place, "o", ms=7, color=FRONT, mfc=fill, mew=1.4)
            continue
        across = axes.get_yaxis_transform()
        axes.plot(0.97, place, ">", ms=7, color=FRONT, mfc=fill, transform=across)
        axes.text(
            0.93, place, f"{value:.1f}", transform=across, ha="right", va="center"
        )
    axes.plot([], [], "o", ms=7, color=FRONT, mfc=fill, mew=1.4, label=dots.label)
