"""The endurance benchmark in pictures."""

from collections.abc import Sequence
from typing import Any

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
    styled,
)
from bp2_rl.paper.benchmarks.endurance.calibration import MEMBERS, RISE, course
from bp2_rl.paper.benchmarks.endurance.heating import MARGIN, HeatedRun
from bp2_rl.paper.benchmarks.endurance.measured import (
    EnduranceMetrics,
    HeldSpeed,
    joint_of,
)
from bp2_rl.paper.motor_heat import Network, Temperatures, heated
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.robot.bp2 import ENDURANCE_TIME, HEATING_RATE
from bp2_rl.robot.hardware import HardwareSpec

DASHES: dict[str, Any] = {"hip": "-", "knee": (0, (5, 1.6)), "abad": (0, (1, 1.4))}
PAPER = LEG_COLORS["FL"]
GROUPS = {
    "rear hips": ("RR_hip", "RL_hip"),
    "front hips": ("FR_hip", "FL_hip"),
    "rear knees": ("RR_knee", "RL_knee"),
    "front knees": ("FR_knee", "FL_knee"),
}
GROUP_COLORS = dict(
    zip(
        GROUPS,
        (LEG_COLORS["RR"], LEG_COLORS["FR"], LEG_COLORS["RL"], LEG_COLORS["FL"]),
        strict=True,
    )
)

TEMPERATURES = (
    "The windings' temperatures; circles: the hottest one where heat runs faster than motion; yellow: the paper's rear "
    "hip, 1.8 K/s for 86 s, on which the motor is calibrated."
)
OPERATING = (
    "Torque over speed of the hottest motor's hip and knee, by the millisecond and coloured by time; black: the cold "
    "envelope, red: the one at the end."
)
MARGIN_CAPTION = "Share of each second on the envelope of the moment, two motors each, and the speed that is left."
ENDURANCE = (
    "How long the hottest winding lasts over speed, by the heat of the cold gait alone (line), and as run with warming "
    "motors (squares)."
)
CALIBRATION = (
    "Motors that heat at the paper's mean rate. Left: the winding's temperature less the straight line of 1.8 K/s; "
    "right: what a winding's capacity asks of its way to the case, how straight it heats, and how long it would last "
    "at the top speed."
)


@styled
def temperature_figure(
    metrics: EnduranceMetrics, accelerated: Sequence[HeatedRun]
) -> Figure:
    """All windings over time, a speed a panel."""
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(metrics.held), sharey=True))
    air, limit = metrics.heat.air, metrics.heat.limit
    for axes, held, fast in zip(panels, metrics.held, accelerated, strict=True):
        run = held.result
        time = np.concatenate([[0.0], held.course.time, [run.seconds]])
        winding = np.vstack(
            [
                np.full((1, 12), air),
                np.reshape(held.course.winding, (-1, 12)),
                [run.winding],
            ]
        )
        for i, name in enumerate(conventions.MOTOR_NAMES):
            leg, joint = name.split("_")
            bold = 2.6 if i == held.hottest else 1.2
            axes.plot(
                time,
                winding[:, i],
                color=LEG_COLORS[leg],
                linestyle=DASHES[joint],
                linewidth=bold,
            )
        axes.plot(
            fast.course.time,
            [row[held.hottest] for row in fast.course.winding],
            "o",
            ms=4.5,
            mfc="white",
            mec=INK,
            mew=0.9,
            linestyle="",
        )
        axes.plot(
            [0.0, ENDURANCE_TIME],
            [air, air + RISE],
            color=PAPER,
            linewidth=6.0,
            alpha=0.35,
            zorder=0.9,
        )
        axes.axhline(limit, color=QUIET, linewidth=0.9, linestyle=(0, (4, 2)))
        hottest = f"{joint_of(held.hottest)}: {run.seconds:.0f} s"
        for at, text, color in (
            (-8, f"limit, {limit:g} °C", QUIET),
            (-24, hottest, INK),
        ):
            axes.annotate(
                text,
                (0.0, limit),
                (8, at),
                textcoords="offset points",
                va="center",
                color=color,
            )
        axes.set(
            title=_title(held),
            xlabel="Time [s]",
            xlim=(0.0, max(ENDURANCE_TIME, run.seconds) * 1.02),
        )
    panels[0].set(ylabel="Winding [°C]", ylim=(air - 5.0, None))
    handles = [
        Line2D([], [], color=color, linewidth=3, label=leg)
        for leg, color in LEG_COLORS.items()
    ]
    handles += [
        Line2D([], [], color=INK, linestyle=DASHES[j], label=j)
        for j in ("hip", "knee", "abad")
    ]
    handles += [
        Line2D(
            [],
            [],
            color=INK,
            marker="o",
            mfc="white",
            linestyle="",
            ms=4.5,
            label="accelerated",
        ),
        Line2D([], [], color=PAPER, alpha=0.35, linewidth=6, label="paper"),
    ]
    figure.legend(
        handles=handles,
        loc="outside upper right",
        ncols=9,
        handlelength=1.7,
        columnspacing=1.2,
    )
    return figure


@styled
def operating_figure(
    metrics: EnduranceMetrics, runs: Sequence[HeatedRun], robot: HardwareSpec
) -> Figure:
    """Torque over speed, coloured by time: rows are speeds, columns hip and knee of the
    hottest leg."""
    count = len(metrics.held)
    figure = Figure(figsize=(WIDTH, 0.6 + 3.3 * count), layout="constrained")
    panels = np.reshape(figure.subplots(count, 2, sharex=True, sharey=True), (count, 2))
    motors = Actuator.from_hardware(robot)
    network = Network.from_spec(metrics.heat, metrics.heat.winding_to_case or 1.0)
    reach = 1.12 * max(
        robot.joint_no_load_speed,
        *(float(np.max(np.abs(run.rate), initial=0.0)) for run in runs),
    )
    speeds = np.linspace(-reach, reach, 601)
    cold = torque_limits(motors, speeds)
    for row, held, run in zip(panels, metrics.held, runs, strict=True):
        end, points = held.result, None
        for axes, joint in zip(row, (1, 2), strict=True):
            i = 3 * (held.hottest // 3) + joint
            hot = heated(
                motors,
                network,
                Temperatures(np.array([end.winding[i]]), np.array([end.case[i]])),
            )
            axes.fill_between(speeds, *cold, color=FAINT, alpha=0.6, linewidth=0)
            points = axes.scatter(
                run.rate[:, i],
                run.torque[:, i],
                c=run.time,
                s=4.0,
                cmap="plasma",
                vmin=0.0,
                vmax=max(end.seconds, 1.0),
                linewidths=0,
                rasterized=True,
            )
            for limits, color, width in (
                (cold, INK, 1.1),
                (torque_limits(hot, speeds), FALL, 1.6),
            ):
                for bound in limits:
                    axes.plot(speeds, bound, color=color, linewidth=width)
            warmed = f"{joint_of(i).capitalize()}, {end.first.speed:.1f} m/s, to {end.winding[i]:.0f} °C"
            axes.set(title=warmed, xlim=(-reach, reach))
        row[0].set_ylabel("Joint torque [Nm]")
        if points is not None:
            figure.colorbar(
                points, ax=list(row), label="Time [s]", pad=0.02
            ).outline.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("Joint speed [rad/s]")
    return figure


@styled
def margin_figure(metrics: EnduranceMetrics) -> Figure:
    """Share on the envelope, and speed, over time; a speed a column."""
    count = len(metrics.held)
    figure = Figure(figsize=(WIDTH, 5.0), layout="constrained")
    panels = np.reshape(
        figure.subplots(2, count, sharex="col", sharey="row", height_ratios=(1.6, 1)),
        (2, count),
    )
    for (share, speed), held in zip(panels.T, metrics.held, strict=True):
        on, cold = (
            np.reshape(held.course.on_envelope, (-1, 12)),
            held.result.first.speed,
        )
        for name, members in GROUPS.items():
            values = 100.0 * np.mean(
                on[:, [conventions.MOTOR_NAMES.index(motor) for motor in members]],
                axis=1,
            )
            share.plot(held.course.time, values, color=GROUP_COLORS[name])
        share.set_title(_title(held))
        speed.plot(
            held.course.time,
            100.0 * np.array(held.course.speed) / max(cold, 1e-9),
            color=FRONT,
        )
        speed.axhline(100.0 * MARGIN, color=FALL, linewidth=1.1, linestyle=(0, (4, 2)))
        speed.annotate(
            "below this, no torque margin",
            (0.0, 100.0 * MARGIN),
            (6, 3),
            textcoords="offset points",
            va="bottom",
            color=FALL,
            fontsize=9,
        )
        speed.set(xlabel="Time [s]", xlim=(0.0, max(held.result.seconds, 1.0)))
    panels[0, 0].set_ylabel("On the envelope [%]")
    panels[0, 0].set_ylim(0.0, None)
    panels[1, 0].set_ylabel("Speed [% of cold]")
    panels[1, 0].set_ylim(100.0 * MARGIN - 1.0, 102.0)
    handles = [
        Line2D([], [], color=color, linewidth=3, label=name)
        for name, color in GROUP_COLORS.items()
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=4, handlelength=1.4)
    return figure


@styled
def endurance_figure(metrics: EnduranceMetrics) -> Figure:
    """Time to the limit over speed."""
    figure = Figure(figsize=(WIDTH, 3.8), layout="constrained")
    axes: Axes = figure.subplots()
    line = sorted(
        (at.speed, at.seconds)
        for at in metrics.speeds
        if at.seconds is not None and not at.fell
    )
    if line:
        axes.plot(
            *zip(*line, strict=True),
            "o-",
            color=FRONT,
            ms=5,
            label="by the heat of the cold gait",
        )
    upright = [one.ran for one in metrics.drawn if not one.ran.fell]
    drawn = [(ran.speed, ran.seconds) for ran in upright if ran.seconds is not None]
    if drawn:
        axes.plot(
            *zip(*drawn, strict=True),
            "o",
            ms=4,
            mfc="white",
            mec=QUIET,
            label="drawn robots, by that heat",
        )
    run = [
        (held.result.first.speed, held.result.seconds)
        for held in metrics.held
        if held.result.cause == "winding"
    ]
    if run:
        axes.plot(
            *zip(*run, strict=True),
            "s",
            color=FALL,
            ms=8,
            label="run with warming motors",
        )
        for speed, seconds in run:
            axes.annotate(
                f"{seconds:.0f} s",
                (speed, seconds),
                (7, 6),
                textcoords="offset points",
                fontsize=9,
            )
    axes.plot(
        bp2.OUTDOOR_TOP_SPEED,
        ENDURANCE_TIME,
        "*",
        color=PAPER,
        ms=15,
        mec=INK,
        mew=0.6,
        label="paper, 86 s",
    )
    axes.set(
        title="Endurance over speed",
        xlabel="Speed [m/s]",
        ylabel="Time to the limit [s]",
    )
    axes.margins(x=0.08, y=0.15)
    axes.set_ylim(0.0, None)
    axes.legend(loc="lower left")
    return figure


@styled
def calibration_figure(metrics: EnduranceMetrics) -> Figure:
    """The family of motors that heat at the paper's rate."""
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1))
    axes = figure.add_subplot(grid[:, 0])
    best = metrics.straightest
    shown = (
        (metrics.family[MEMBERS // 2], LEG_COLORS["RL"]),
        (best, LEG_COLORS["RR"]),
        (metrics.family[-1], FALL),
    )
    for member, color in shown:
        network = Network.from_spec(metrics.heat, member.winding_to_case)
        network = network.replace(winding_capacity=member.winding_capacity)
        time, t = course(network, np.array([metrics.cold_heat]), ENDURANCE_TIME)
        way = (
            f"{member.winding_to_case:.2g} K/W"
            if member.winding_to_case < 1e3
            else "nothing given away"
        )
        off = t.winding[:, 0] - metrics.heat.air - HEATING_RATE * time
        axes.plot(time, off, color=color, linewidth=2.2 if member is best else 1.4)
        furthest = int(np.argmax(np.abs(off)))
        above = off[furthest] > 0.0
        axes.annotate(
            f"{member.winding_capacity:.0f} J/K, {way}",
            (time[furthest], off[furthest]),
            (0, 6 if above else -6),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            color=color,
        )
    axes.axhline(0.0, color=PAPER, linewidth=6.0, alpha=0.35, zorder=0.9)
    axes.margins(y=0.14)
    axes.set(
        title="Off the straight line of 1.8 K/s",
        xlabel="Time [s]",
        ylabel="Winding [K]",
        xlim=(0.0, ENDURANCE_TIME),
    )
    capacity = [member.winding_capacity for member in metrics.family]
    panels = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    most = 1.05 * max(*capacity, metrics.heat.winding_capacity)
    marks = (
        (best.winding_capacity, "straightest", "right", -4),
        (metrics.heat.winding_capacity, "used", "left", 4),
    )
    rows = (
        (
            "To the case [K/W]",
            [
                m.winding_to_case if m.winding_to_case < 1e3 else np.nan
                for m in metrics.family
            ],
        ),
        ("Off straight [K]", [m.bend for m in metrics.family]),
        (
            "At the top [s]",
            [m.at_top if m.at_top is not None else np.nan for m in metrics.family],
        ),
    )
    for panel, (label, values) in zip(panels, rows, strict=True):
        panel.plot(capacity, values, color=FRONT)
        panel.axvline(
            best.winding_capacity, color=LEG_COLORS["RR"], linewidth=2.2, zorder=0.9
        )
        panel.axvline(
            metrics.heat.winding_capacity,
            color=QUIET,
            linewidth=1.2,
            linestyle=(0, (4, 2)),
            zorder=0.9,
        )
        panel.set_ylabel(label)
        panel.set_ylim(0.0, None)
        panel.set_xlim(0.0, most)
        panel.tick_params(labelbottom=panel is panels[-1])
    panels[0].set_ylim(0.0, 3.0)
    panels[0].set_title("The family")
    for at, text, side, by in marks:
        panels[1].annotate(
            text,
            (at, 0.9),
            (by, 0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha=side,
            va="center",
            fontsize=9,
        )
    panels[-1].set_xlabel("Winding [J/K]")
    figure.align_ylabels(panels)
    return figure


def _title(held: HeldSpeed) -> str:
    return (
        f"{held.result.first.speed:.1f} m/s ({held.result.commanded_speed:g} commanded)"
    )
