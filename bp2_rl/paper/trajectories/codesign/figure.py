"""The picture of a co-design study: what each of the three parameters costs, alone and
with the others free."""

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bp2_rl.base.plotting import FAINT, INK, LEG_COLORS, WIDTH, styled
from bp2_rl.paper.trajectories.codesign.scan import FLAT, Scan
from bp2_rl.paper.trajectories.codesign.search import DesignRow
from bp2_rl.paper.trajectories.codesign.settings import PARAMETERS, Parameter
from bp2_rl.paper.trajectories.codesign.study import Codesign
from bp2_rl.robot.hardware import IDEAL

TITLES: dict[Parameter, str] = {
    "gear_ratio": "Gear ratio [1]",
    "leg_length": "Leg length [m]",
    "spring_stiffness": "Stiffness [kN/m]",
}
COLORS = {"BP2": LEG_COLORS["FR"], "free": LEG_COLORS["FL"]}
LABELS = {"BP2": "the other two as in BP2", "free": "the other two free"}
ROWS: tuple[tuple[str, Callable[[DesignRow], float]], ...] = (
    ("Cost [1]", lambda row: row.cost),
    ("Period [s]", lambda row: row.period),
    ("Peak torque [Nm]", lambda row: row.peak_torque),
    ("Joint speed [rad/s]", lambda row: row.peak_speed),
)
"""What is drawn over each parameter."""


@styled
def codesign_figure(study: Codesign) -> Figure:
    """Cost, period, torque and joint speed over each parameter; shaded where the cost
    is within `FLAT` of the least.

    A vertical line is BP2's value, the large marker the cheapest value of the scan.
    """
    figure = Figure(figsize=(WIDTH, 8.4), layout="constrained")
    panels = figure.subplots(len(ROWS), len(PARAMETERS), sharex="col", sharey="row")
    for name, column in zip(PARAMETERS, panels.T, strict=True):
        scans = [scan for scan in study.scans if scan.parameter == name]
        for (label, figure_of), axes in zip(ROWS, column, strict=True):
            _draw(axes, scans, figure_of)
            axes.yaxis.set_major_locator(MaxNLocator(5))
            axes.axvline(
                _shown(name, IDEAL.parameter(name)),
                color=INK,
                linewidth=0.9,
                linestyle=(0, (4, 2)),
            )
            if axes in panels[:, 0]:
                axes.set_ylabel(label)
        for scan in scans:
            low, high = (_shown(name, value) for value in scan.flat)
            column[0].axvspan(
                low, high, color=COLORS[scan.others], alpha=0.15, linewidth=0
            )
        column[0].set_title(TITLES[name].split(" [")[0])
        column[-1].set_xlabel(TITLES[name])
    handles = [
        axes_line
        for axes_line in panels[0, 0].get_lines()
        if axes_line.get_label() in LABELS.values()
    ]
    handles.append(
        panels[0, 0].plot(
            [], [], color=INK, linewidth=0.9, linestyle=(0, (4, 2)), label="BP2"
        )[0]
    )
    handles.append(
        panels[0, 0].fill_between(
            [], [], color=FAINT, label=f"cost within {FLAT:.0%} of the least"
        )
    )
    figure.legend(handles=handles, loc="outside upper right", ncols=4, handlelength=1.6)
    return figure


def _draw(
    axes: Axes, scans: Sequence[Scan], figure_of: Callable[[DesignRow], float]
) -> None:
    """One figure of every scan over the same parameter."""
    for scan in scans:
        color = COLORS[scan.others]
        values = [_shown(scan.parameter, value) for value in scan.values]
        axes.plot(
            values,
            [figure_of(row) for row in scan.rows],
            "o-",
            ms=3,
            color=color,
            label=LABELS[scan.others],
        )
        best = scan.best
        axes.plot(
            _shown(scan.parameter, getattr(best, scan.parameter)),
            figure_of(best),
            "o",
            ms=7,
            color=color,
        )


def _shown(name: Parameter, value: float) -> float:
    """A parameter's value in the unit of its axis."""
    return value / 1e3 if name == "spring_stiffness" else value
