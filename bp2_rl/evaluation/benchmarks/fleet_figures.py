"""The pictures of a fleet: each robot's speed over its friction, and all speeds over
time."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import (
    FALL,
    FRONT,
    INK,
    WIDTH,
    legend_above,
    moving_mean,
    styled,
)
from bp2_rl.robot import conventions
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.parallel import FleetRun

if TYPE_CHECKING:
    from bp2_rl.evaluation.benchmarks.fleet import RobustnessMetrics

ROBOTS_CAPTION = "Each robot's mean speed while held over the friction drawn for it, with the latency as colour; crosses: fallen."
FLEET_CAPTION = (
    "Speed over time (0.25-s means) of the robots that had not fallen until then: the median, and the bands that hold "
    "half and nine tenths of them; ticks: falls."
)


@styled
def robots_figure(metrics: "RobustnessMetrics") -> Figure:
    """Draw mean speed over friction, coloured by latency; falls below all others."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes: Axes = figure.subplots()
    robots = [
        (r.friction, r.mean_speed, 1e3 * r.latency)
        for r in metrics.robots
        if r.mean_speed is not None
    ]
    fallen = [r.friction for r in metrics.robots if r.fell_at is not None]
    latencies = [1e3 * robot.latency for robot in metrics.robots]
    if robots:
        friction, speed, latency = zip(*robots, strict=True)
        points = axes.scatter(
            friction,
            speed,
            c=latency,
            s=26,
            linewidths=0,
            cmap="cividis",
            vmin=min(latencies),
            vmax=max(latencies),
        )
        figure.colorbar(
            points, ax=axes, label="Latency [ms]", pad=0.02
        ).outline.set_visible(False)
    axes.axhline(
        metrics.commanded_speed,
        color=INK,
        linestyle=(0, (4, 2)),
        linewidth=1.2,
        label="command",
    )
    if fallen:
        floor, at = [0.03] * len(fallen), axes.get_xaxis_transform()
        axes.plot(
            fallen,
            floor,
            "x",
            ms=7,
            mew=1.8,
            color=FALL,
            transform=at,
            label=f"{len(fallen)} fell",
        )
    axes.set(title="Mean speed held", xlabel="Friction [1]", ylabel="Speed [m/s]")
    axes.margins(y=0.12)
    legend_above(axes)
    return figure


@styled
def fleet_figure(run: FleetRun) -> Figure:
    """Draw bands of quantiles of the speed over time."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes: Axes = figure.subplots()
    speed = moving_mean(run.speed, round(RIPPLE / conventions.CONTROL_STEP))
    standing = run.time[:, None] < run.fell_at - RIPPLE / 2
    standing[0] = True
    last = int(np.sum(np.any(standing, axis=1)))
    shown = np.where(standing, speed, np.nan)[:last]
    bands = np.nanquantile(shown, (0.05, 0.25, 0.5, 0.75, 0.95), axis=1)
    time = run.time[:last]
    axes.fill_between(
        time,
        bands[0],
        bands[4],
        color=FRONT,
        alpha=0.18,
        linewidth=0,
        label="90 % of the robots",
    )
    axes.fill_between(
        time, bands[1], bands[3], color=FRONT, alpha=0.35, linewidth=0, label="50 %"
    )
    axes.plot(time, bands[2], color=FRONT, linewidth=1.8, label="median")
    axes.plot(
        run.time,
        run.command,
        color=INK,
        linestyle=(0, (4, 2)),
        linewidth=1.2,
        label="command",
    )
    fell = run.fell_at[np.isfinite(run.fell_at)]
    if len(fell):
        at = axes.get_xaxis_transform()
        axes.plot(
            fell,
            0.03 + 0.0 * fell,
            "|",
            ms=10,
            mew=1.6,
            color=FALL,
            transform=at,
            label="falls",
        )
    axes.set(
        title="Speed",
        xlabel="Time [s]",
        ylabel="Speed [m/s]",
        xlim=(0.0, run.time[-1]),
        ylim=(0.0, None),
    )
    legend_above(axes)
    return figure
