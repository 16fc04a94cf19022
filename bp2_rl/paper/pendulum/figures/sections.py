"""Poincare sections, a panel for each mass ratio."""

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import WIDTH, styled
from bp2_rl.paper.pendulum.figures.style import ONE, TWO, remark
from bp2_rl.paper.pendulum.sections import INSTANTS, Instant, Section

COLUMNS = 3


@styled
def sections_figure(sections: Sequence[Section], instant: Instant) -> Figure:
    """Angle and rate of both pendulums at each instant of the section (paper, Fig. 3D)."""
    columns = min(COLUMNS, len(sections))
    rows = -(-len(sections) // columns)
    figure = Figure(figsize=(WIDTH, 1.1 + 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.ravel()[len(sections) :]:
        axes.set_axis_off()
    for section, axes in zip(sections, panels.ravel(), strict=False):
        path = section.path
        axes.plot(section.theta[:, 0], section.rate[:, 0], "o", color=ONE, ms=3.2, mew=0.0)
        axes.plot(section.theta[:, 1], section.rate[:, 1], "o", color=TWO, ms=3.2, mew=0.8, mfc="none")
        axes.set_title(f"R = {path.mass_ratio:g}")
        if path.apart is not None:
            remark(axes, f"{path.apart:.2f} apart")
    top = max(float(abs(section.rate).max()) for section in sections)
    panels[0, 0].set_ylim(-1.15 * top, 1.35 * top)
    for axes in panels[:, 0]:
        axes.set_ylabel("Rate / $\\omega_0$ [rad]")
    for column in panels.T:
        below = [axes for axes in column if axes.axison][-1]
        below.set_xlabel("Angle [rad]")
        below.tick_params(labelbottom=True)
    handles = [
        Line2D([], [], color=ONE, marker="o", linestyle="", ms=4, label="pendulum 1, let go"),
        Line2D([], [], color=TWO, marker="o", linestyle="", ms=4, mfc="none", label="pendulum 2"),
        Line2D([], [], linestyle="", label=f"taken each time {INSTANTS[instant]}"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, handlelength=1.0)
    return figure
