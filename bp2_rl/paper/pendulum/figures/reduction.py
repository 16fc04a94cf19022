"""Where a free beam helps: maps over phase and frequency, and over phase and amplitude."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import INK, WIDTH, styled
from bp2_rl.paper.pendulum import bp2
from bp2_rl.paper.pendulum.figures.style import HELPS_AND_HURTS, ratio_norm
from bp2_rl.paper.pendulum.reduction import Maps

MOST = 1.5  # of the colours over frequency: at W = 1 the ratio has a pole
CONTOURS = (0.4, 0.7, 0.9)
LABELLED = 0.3  # of a map's height, at which its contours are labelled
COLOR_TICKS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5)


@styled
def reduction_figure(maps: Sequence[Maps]) -> Figure:
    """Peak torque of two pendulums, beam free over beam fixed; a column for each mass ratio, BP2's last.

    The dashed line is the boundary in closed form, the black curve that of the map; a star is BP2's trot.
    """
    figure = Figure(figsize=(WIDTH, 5.9), layout="constrained")
    panels = figure.subplots(2, len(maps), sharex=True, sharey="row", squeeze=False)
    least = min(float(one.over_frequency.min()) for one in maps)
    most = max(1.2, *(one.reduction.greatest for one in maps))
    images = []
    for one, (upper, lower) in zip(maps, panels.T, strict=True):
        for axes, rows, values, norm in (
            (upper, one.frequencies, np.minimum(one.over_frequency, MOST), ratio_norm(least, MOST)),
            (lower, one.amplitudes, one.over_amplitude, ratio_norm(least, most)),
        ):
            axes.grid(visible=False)
            image = axes.pcolormesh(
                one.phases, rows, values, cmap=HELPS_AND_HURTS, norm=norm, shading="gouraud", rasterized=True
            )
            lines = axes.contour(one.phases, rows, values, CONTOURS, colors=INK, linewidths=0.5)
            axes.clabel(lines, fmt="%.1f", fontsize=7.0, manual=_label_places(one.phases, rows, values))
            images.append(image)
        reduction = one.reduction
        lower.contour(one.phases[:-1], one.amplitudes, one.over_amplitude[:, :-1], [1.0], colors=INK, linewidths=1.4)
        upper.axhline(reduction.boundary, color=INK, linewidth=1.2, linestyle=(0, (4, 2)))
        upper.set_title(f"R = {reduction.mass_ratio:.3g}")
        lower.set_title(f"W = {reduction.frequency:.3g}", fontweight="normal")
        lower.set_xlabel("Phase [rad]")
        lower.set_xticks([0.0, math.pi / 2.0, math.pi], labels=["0", "$\\pi/2$", "$\\pi$"])
    _mark_trot(panels[0, -1], maps[-1].reduction.frequency)
    _mark_trot(panels[1, -1], bp2.HIP_AMPLITUDE)
    panels[0, -1].set_title(f"BP2: R = {maps[-1].reduction.mass_ratio:.3g}")
    panels[0, 0].set_ylabel("Frequency of small swings, $W = \\omega/\\omega_0$")
    panels[1, 0].set_ylabel("Amplitude [rad]")
    for row, image, extend in ((panels[0], images[0], "max"), (panels[1], images[1], "neither")):
        bar = figure.colorbar(image, ax=row.tolist(), extend=extend, pad=0.01, aspect=18)
        bar.set_ticks([tick for tick in COLOR_TICKS if tick <= image.norm.vmax], minor=False)
        bar.ax.set_yticklabels([f"{tick:g}" for tick in bar.get_ticks()])
        bar.set_label("Peak torque, free / fixed")
        bar.outline.set_visible(False)
    handles = [
        Line2D([], [], color=INK, linewidth=1.2, linestyle=(0, (4, 2)), label="boundary, exact: $W^2 = (R+2)/(R+1)$"),
        Line2D([], [], color=INK, linewidth=1.4, label="no difference"),
        Line2D([], [], color=INK, marker="*", ms=9, linestyle="", label="BP2's trot"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _label_places(
    phases: Float[np.ndarray, " phases"], rows: Float[np.ndarray, " rows"], values: Float[np.ndarray, "rows phases"]
) -> list[tuple[float, float]]:
    """Where contours cross one row of a map, clear of where they crowd."""
    row = round(LABELLED * len(rows))
    crossed = [np.flatnonzero(np.diff(np.sign(values[row] - level))) for level in CONTOURS]
    return [(float(phases[columns[0]]), float(rows[row])) for columns in crossed if len(columns)]


def _mark_trot(axes: Axes, height: float) -> None:
    axes.plot(math.pi, height, "*", color=INK, ms=10, clip_on=False, zorder=5)
