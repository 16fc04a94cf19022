"""The figures of a sprint: speed over distance, the lane from above, and the times of
other athletes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import (
    FALL,
    FRONT,
    INK,
    LEG_COLORS,
    WIDTH,
    legend_above,
    mark_level,
    moving_mean,
    styled,
)
from bp2_rl.evaluation.benchmarks.outcome import Picture
from bp2_rl.evaluation.benchmarks.variants import Dots, Panel, variants_figure
from bp2_rl.evaluation.races import BOLT_SPLITS, MARKS, PAPER_BP2, TIMES, TRACK
from bp2_rl.robot import bp2
from bp2_rl.simulation.measuring import (
    LANE_WIDTH,
    foot_edges,
    track_position,
    trunk_edges,
)
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.trajectory import Trajectory

POLICY = "this policy"


def sprint_pictures(run: Trajectory, time: float | None) -> tuple[Picture, ...]:
    """Draw the figures of a sprint, with its time (s) beside the times of other
    athletes."""
    race = (
        f"The race: speed over distance (faint: each millisecond; bold: {RIPPLE:g}-s mean) with the mean speeds of "
        "Bolt's 10-m splits of 2009, his reaction time of 0.146 s included; and the lane seen from above."
    )
    is_bp2 = run.hardware.is_bp2
    athletes = "those whom the paper names" if is_bp2 else "people"
    times = {
        who: seconds for who, seconds in TIMES.items() if is_bp2 or who != PAPER_BP2
    }
    if time is not None:
        times[POLICY] = round(time, 2)
    ranked = sorted(times, key=lambda who: times[who])
    dots = Dots("time", [times[who] for who in ranked])
    panel = Panel(f"Time over {TRACK:g} m", "Time [s]", (dots,), time)
    return (
        Picture("sprint", race, sprint_figure(run)),
        Picture(
            "times",
            f"The time over {TRACK:g} m beside those of {athletes}.",
            variants_figure([f"{who}, {times[who]:g} s" for who in ranked], [panel]),
        ),
    )


@styled
def sprint_figure(run: Trajectory) -> Figure:
    """Draw a sprint's speed over distance, and the robot's path in its lane."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    speed, lane = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.1))
    _draw_speed(speed, run)
    _draw_lane(lane, run)
    return figure


def _draw_speed(axes: Axes, run: Trajectory) -> None:
    along = track_position(run)[0]
    forward = run.ground_velocity[:, 0]
    axes.plot(along, forward, color=FRONT, alpha=0.25, linewidth=0.7)
    axes.plot(
        along,
        moving_mean(forward, round(RIPPLE / run.dt)),
        color=FRONT,
        linewidth=2.0,
        label=POLICY,
    )
    axes.plot(
        np.array(MARKS) - 5.0,  # the middles
        10.0 / np.diff((0.0, *BOLT_SPLITS)),
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
    legend_above(axes)
    if run.fell_at is not None:
        axes.plot(along[-1], forward[-1], "X", ms=9, color=FALL, clip_on=False)
        axes.annotate(
            "fell",
            (along[-1], forward[-1]),
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
