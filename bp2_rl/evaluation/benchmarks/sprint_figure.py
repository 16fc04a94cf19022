"""The picture of a race: speed over distance, the lane from above, and the times of
others."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import (
    FALL,
    FRONT,
    INK,
    LEG_COLORS,
    QUIET,
    WIDTH,
    legend_above,
    mark_level,
    moving_mean,
    styled,
)
from bp2_rl.evaluation.races import BOLT_SPLITS, MARKS, PAPER_BP2, TIMES, TRACK
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.track import LANE_WIDTH, foot_edges, track_position, trunk_edges
from bp2_rl.simulation.trajectory import Trajectory

POLICY = "this policy"


def caption(robot: HardwareSpec) -> str:
    """Return what a reader must know of the picture."""
    others = "those whom the paper names" if robot.is_bp2 else "people"
    return (
        "The race: speed over distance (faint: each millisecond; bold: 0.25-s mean) with the mean speeds of Bolt's "
        "10-m splits of 2009, his reaction time of 0.146 s included; the lane seen from above; and the times over "
        f"100 m of {others}."
    )


@styled
def sprint_figure(run: Trajectory, time: float | None) -> Figure:
    """Speed over distance, the lane, and the time beside those of others."""
    figure = Figure(figsize=(WIDTH, 7.2), layout="constrained")
    speed, lane, times = figure.subplots(3, 1, height_ratios=(2.6, 1.1, 1.6))
    lane.sharex(speed)
    _draw_speed(speed, run)
    _draw_lane(lane, run)
    _draw_times(times, time, run.hardware.is_bp2)
    return figure


def _draw_speed(axes: Axes, run: Trajectory) -> None:
    along, forward = track_position(run)[0], run.ground_velocity[:, 0]
    axes.plot(along, forward, color=FRONT, alpha=0.25, linewidth=0.7)
    axes.plot(
        along,
        moving_mean(forward, round(RIPPLE / run.dt)),
        color=FRONT,
        linewidth=2.0,
        label=POLICY,
    )
    middles, means = np.array(MARKS) - 5.0, 10.0 / np.diff((0.0, *BOLT_SPLITS))
    axes.plot(
        middles,
        means,
        "o",
        ms=5,
        color=LEG_COLORS["FL"],
        label="Bolt 2009, mean of each 10 m",
    )
    if run.hardware.is_bp2:
        mark_level(
            axes,
            bp2.OUTDOOR_TOP_SPEED,
            f"BP2's outdoor top speed, {bp2.OUTDOOR_TOP_SPEED:g} m/s",
        )
    axes.set(title="Speed", ylabel="Speed [m/s]", xlim=(0.0, TRACK), ylim=(0.0, None))
    axes.tick_params(axis="x", labelbottom=False)
    legend_above(axes)
    if run.fell_at is not None:
        axes.plot(along[-1], forward[-1], "X", ms=9, color=FALL, clip_on=False)
        end = along[-1], forward[-1]
        axes.annotate(
            "fell",
            end,
            (8, 4),
            color=FALL,
            textcoords="offset points",
            annotation_clip=False,
        )


def _draw_lane(axes: Axes, run: Trajectory) -> None:
    along, left = track_position(run)
    trunk, feet = trunk_edges(run), foot_edges(run)
    axes.fill_between(
        along, *trunk.T, color=FRONT, alpha=0.3, linewidth=0, label="trunk"
    )
    for i, label in enumerate(("feet", None)):
        axes.plot(along, feet[:, i], color=LEG_COLORS["FL"], linewidth=1.0, label=label)
    axes.plot(along, left, color=INK, linewidth=1.0, label="trunk's centre")
    half = LANE_WIDTH / 2
    for side in (-half, half):
        axes.axhline(side, color=INK, linewidth=1.6)
    axes.set(
        title=f"Lane of {LANE_WIDTH:g} m",
        xlabel="Distance [m]",
        ylabel="To the left [m]",
    )
    axes.set(yticks=(-half, 0.0, half), ylim=(-1.4 * half, 1.4 * half))
    legend_above(axes)


def _draw_times(axes: Axes, time: float | None, is_bp2: bool) -> None:
    times = {
        name: value for name, value in TIMES.items() if is_bp2 or name != PAPER_BP2
    }
    times |= {POLICY: round(time, 2)} if time is not None else {}
    ranked = sorted(times, key=lambda name: -times[name])
    for place, name in enumerate(ranked):
        ours = name == POLICY
        color = FRONT if ours else QUIET
        axes.plot(
            (0.0, times[name]),
            (place, place),
            color=color,
            linewidth=2.4 if ours else 1.0,
        )
        axes.plot(times[name], place, "o", ms=6, color=color)
        at, weight = (times[name], place), "bold" if ours else "normal"
        axes.annotate(
            f"{times[name]:g}",
            at,
            (7, 0),
            textcoords="offset points",
            va="center",
            weight=weight,
        )
    axes.set(
        title="Time over 100 m",
        xlabel="Time [s]",
        yticks=range(len(ranked)),
        yticklabels=ranked,
    )
    axes.set(xlim=(0.0, 1.1 * max(times.values())), ylim=(-0.7, len(ranked) - 0.3))
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
