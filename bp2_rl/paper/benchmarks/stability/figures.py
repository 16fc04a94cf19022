"""The stability benchmark in pictures."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import (
    FAINT,
    FALL,
    FRONT,
    INK,
    LEG_COLORS,
    QUIET,
    WIDTH,
    legend_above,
    styled,
)
from bp2_rl.paper.benchmarks.stability.measured import SpeedResult
from bp2_rl.robot import conventions

AXES = "roll rate", "pitch rate", "yaw rate"
# small deviations to great ones
SHADES = ("#9ECAE1", "#6BAED6", "#4292C6", "#2171B5", "#084594")
HIGHEST = 8.0  # harmonic that is drawn

SECTIONS = (
    "The trunk's angular velocity each time the clock's phase is 0: with noise (blue, all robots), and of the robot "
    "without (red). Grey: that robot all along its last strides."
)
SPECTRA = (
    "Spectra of the trunk's velocities over the stride's frequency, with noise: at harmonics that a gait with equal "
    "sides has (blue), at the others (red), and between (grey)."
)
TOUCHDOWNS = "Touchdowns against their mean phase of the clock, stride by stride, of one robot with noise."
RETURNS = (
    "Robots that begin side by side: their distance (root mean square over coordinates, each over its scatter under "
    "noise) stride by stride, by the first one; median of the robots. Sizes that meet at one level show that level to "
    "be how far the gait wanders by itself."
)
PUSHES = "Largest push survived, a jump of the whole robot's velocity [m/s], by direction and phase of the clock."


@styled
def section_figure(ran: Sequence[SpeedResult]) -> Figure:
    """Roll over pitch and yaw over pitch, a speed a row."""
    figure = Figure(figsize=(WIDTH, 0.5 + 3.5 * len(ran)), layout="constrained")
    panels = np.reshape(figure.subplots(len(ran), 2), (len(ran), 2))
    for row, found in zip(panels, ran, strict=True):
        shown = found.shown
        for axes, across, up in zip(row, (1, 1), (0, 2), strict=True):
            if shown.loop is not None:
                axes.plot(
                    shown.loop[:, across],
                    shown.loop[:, up],
                    color=QUIET,
                    linewidth=0.7,
                    alpha=0.6,
                )
            for points in shown.noisy:
                axes.plot(
                    points[:, across],
                    points[:, up],
                    "o",
                    color=FRONT,
                    ms=2.4,
                    mew=0,
                    alpha=0.45,
                )
            if shown.quiet is not None:
                axes.plot(
                    shown.quiet[:, across],
                    shown.quiet[:, up],
                    "o",
                    color=FALL,
                    ms=2.4,
                    mew=0,
                )
            axes.set(
                xlabel=f"{AXES[across].capitalize()} [rad/s]",
                ylabel=f"{AXES[up].capitalize()} [rad/s]",
            )
        row[0].set_title(_title(found))
    handles = [
        Line2D([], [], color=FRONT, marker="o", linestyle="", label="with noise"),
        Line2D([], [], color=FALL, marker="o", linestyle="", label="without"),
        Line2D([], [], color=QUIET, label="all along"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, handlelength=1.4)
    return figure


@styled
def spectrum_figure(found: SpeedResult) -> Figure:
    """Six velocities."""
    figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    panels = np.ravel(figure.subplots(3, 2, sharex=True, sharey=True))
    wanted = {one.name: one.symmetric for one in found.metrics.signals}
    for axes, (name, one) in zip(panels, found.shown.spectra.items(), strict=False):
        inside = (one.frequency > 0.0) & (one.frequency <= HIGHEST + 0.4)
        frequency, power = one.frequency[inside], 100.0 * one.power[inside]
        number = np.round(frequency).astype(int)
        harmonic = np.abs(frequency - number) < 1e-9
        right = harmonic & (number % 2 == (0 if wanted.get(name) == "even" else 1))
        for chosen, color, width in (
            (~harmonic, QUIET, 0.7),
            (right, FRONT, 2.6),
            (harmonic & ~right, FALL, 2.6),
        ):
            axes.vlines(
                frequency[chosen],
                1e-3,
                np.maximum(power[chosen], 1e-3),
                color=color,
                linewidth=width,
            )
        axes.set(
            title=name.capitalize(),
            yscale="log",
            ylim=(1e-2, 150.0),
            xlim=(0.0, HIGHEST + 0.4),
        )
    figure.supylabel("Share of the variance [%]", fontsize=9.5)
    for axes in panels[-2:]:
        axes.set_xlabel("Frequency over the stride's [1]")
    handles = [
        Line2D([], [], color=FRONT, linewidth=3, label="as equal sides have"),
        Line2D([], [], color=FALL, linewidth=3, label="leakage"),
        Line2D([], [], color=QUIET, label="between harmonics"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, handlelength=1.4)
    return figure


@styled
def touchdown_figure(ran: Sequence[SpeedResult]) -> Figure:
    """Legs over strides, a speed a panel."""
    figure = Figure(figsize=(WIDTH, 0.4 + 2.7 * len(ran)), layout="constrained")
    for axes, found in zip(
        np.atleast_1d(figure.subplots(len(ran), 1)), ran, strict=True
    ):
        for leg, offsets in zip(conventions.LEGS, found.shown.landings, strict=False):
            axes.plot(
                1e3 * offsets,
                color=LEG_COLORS[leg],
                linewidth=1.0,
                marker="o",
                ms=2.2,
                mew=0,
                label=leg,
            )
        axes.axhspan(-0.5, 0.5, color=FAINT, zorder=0.5)
        axes.set(title=_title(found), ylabel="Touchdown [ms]")
        if found.shown.landings:
            legend_above(axes)
        axes.set_xlabel("Stride")
    return figure


@styled
def return_figure(ran: Sequence[SpeedResult]) -> Figure:
    """Distances over strides, a speed a panel."""
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(ran), sharey=True))
    for axes, found in zip(panels, ran, strict=True):
        returns = found.metrics.returns
        for size, growth, color in (
            zip(returns.sizes, returns.growth, SHADES, strict=False) if returns else ()
        ):
            axes.plot(
                size * np.array(growth),
                color=color,
                marker="o",
                ms=3.5,
                label=f"{size:g}",
            )
        axes.set(title=_title(found), xlabel="Stride", yscale="log")
    panels[0].set_ylabel("Distance [1]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, title="first distance", loc="outside right center")
    return figure


@styled
def push_figure(ran: Sequence[SpeedResult]) -> Figure:
    """Size over direction, a line a phase, a speed a panel."""
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
    panels: Sequence[Axes] = np.atleast_1d(
        figure.subplots(1, len(ran), subplot_kw={"projection": "polar"})
    ).tolist()
    for axes, found in zip(panels, ran, strict=True):
        pushes = found.metrics.pushes
        phases = sorted({push.phase for push in pushes})
        for phase, color in zip(phases, LEG_COLORS.values(), strict=False):
            line = sorted(
                (push.direction, push.survived)
                for push in pushes
                if push.phase == phase
            )
            ways, sizes = np.array([*line, line[0]]).T
            axes.plot(
                ways, sizes, color=color, marker="o", ms=3.5, label=f"phase {phase:.2f}"
            )
        axes.set_theta_zero_location("N")  # pyright: ignore[reportAttributeAccessIssue]
        axes.set_title(_title(found))
        axes.set_ylim(0.0, None)
        axes.set_xticks(np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False))
        axes.set_xticklabels(["forward", "", "left", "", "backward", "", "right", ""])
        axes.tick_params(colors=INK)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.32), ncols=2)
    return figure


def _title(found: SpeedResult) -> str:
    speed = found.metrics.speed
    return f"{found.metrics.commanded:.2f} m/s commanded" + (
        "" if speed is None else f", {speed:.2f} run"
    )
