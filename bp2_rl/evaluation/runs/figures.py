"""Pictures of a run: each function takes a Trajectory and returns a Matplotlib figure, drawn off screen."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.evaluation.runs.metrics import RIPPLE, best_window, contacts, steady_window, touchdowns
from bp2_rl.evaluation.runs.trajectory import Trajectory
from bp2_rl.plotting import (
    FAINT,
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
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import Actuator, torque_limits

JOINT_TITLES = {"abad": "Abduction", "hip": "Hip", "knee": "Knee"}
CLOSE_UP = 1.2  # s of steady running shown stride by stride
POINTS = 4000  # most torque-speed points drawn for one motor

Draw = Callable[[Trajectory], Figure]


@styled
def speed_figure(run: Trajectory) -> Figure:
    """Forward speed and command over time, and how well the robot kept its lane."""
    figure = Figure(figsize=(WIDTH, 4.8), layout="constrained")
    speed, lane = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))

    forward = run.ground_velocity[:, 0]
    stride = moving_mean(forward, round(RIPPLE / run.dt))
    speed.plot(run.time, forward, color=FRONT, alpha=0.25, linewidth=0.7, label="each millisecond")
    speed.plot(run.time, stride, color=FRONT, linewidth=1.8, label="0.25-s mean")
    speed.plot(run.time, run.command[:, 0], color=INK, linestyle=(0, (4, 2)), linewidth=1.2, label="command")
    best = best_window(run, 1.0)
    if best is not None:
        speed.axvspan(best.start, best.start + 1.0, color=LEG_COLORS["FL"], alpha=0.25, linewidth=0)
        speed.plot([], [], color=LEG_COLORS["FL"], alpha=0.35, linewidth=7, label=f"best second, {best.speed:.2f} m/s")
    speed.set(ylabel="Speed [m/s]", title="Forward speed")
    legend_above(speed)

    lane.plot(run.time, run.qpos[:, 1] - run.qpos[0, 1], color=LEG_COLORS["RR"], label="to the left [m]")
    lane.plot(run.time, run.heading - run.heading[0], color=LEG_COLORS["RL"], label="heading [rad]")
    lane.axhline(0.0, color=QUIET, linewidth=0.8)
    lane.set(title="Drift", xlabel="Time [s]", ylabel="[m], [rad]", xlim=(0.0, len(run) * run.dt))
    legend_above(lane)
    if run.fell_at is not None:
        for axes in (speed, lane):
            axes.axvline(run.fell_at, color=FALL, linewidth=1.6)
        speed.annotate(
            "fell ", (run.fell_at, 0.02), xycoords=("data", "axes fraction"), ha="right", va="bottom", color=FALL
        )
    return figure


@styled
def torque_speed_figure(run: Trajectory) -> Figure:
    """Where the motors worked: torque over speed at every millisecond, inside the torque-speed envelope."""
    figure = Figure(figsize=(WIDTH, 3.5), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    motors = Actuator.from_hardware(run.hardware)
    reach = 1.15 * max(run.hardware.joint_no_load_speed, float(np.max(np.abs(run.joint_velocity))))
    speeds = np.linspace(-reach, reach, 601)
    low, high = torque_limits(motors, speeds)
    every = max(1, len(run) // POINTS)
    velocity, torque = (x[::every].reshape(-1, 4, 3) for x in (run.joint_velocity, run.torque))
    for j, (axes, joint) in enumerate(zip(panels, specs.JOINTS, strict=True)):
        axes.fill_between(speeds, low, high, color=FAINT, alpha=0.6, linewidth=0)
        axes.plot(speeds, high, color=INK, linewidth=1.1)
        axes.plot(speeds, low, color=INK, linewidth=1.1)
        for i, leg in enumerate(specs.LEGS):
            axes.plot(
                velocity[:, i, j],
                torque[:, i, j],
                ".",
                ms=2.0,
                mew=0,
                alpha=0.45,
                color=LEG_COLORS[leg],
                rasterized=True,
            )
        axes.set(title=JOINT_TITLES[joint], xlabel="Joint speed [rad/s]", xlim=(-reach, reach))
    panels[0].set_ylabel("Joint torque [Nm]")
    _leg_legend(figure, marker="o")
    return figure


@styled
def gait_figure(run: Trajectory) -> Figure:
    """The last strides: vertical foot forces, and who stands when (Hildebrand diagram)."""
    strides = _last_strides(run)
    standing = contacts(strides)
    figure = Figure(figsize=(WIDTH, 4.8), layout="constrained")
    force, gait = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))

    for i, leg in enumerate(specs.LEGS):
        force.plot(strides.time, strides.foot_force[:, i, 2], color=LEG_COLORS[leg])
    weight = run.mass * specs.GRAVITY
    mark_level(force, weight, "body weight")
    force.set(ylabel="Vertical force [N]", title="Foot forces", ylim=(0.0, None))

    for i, leg in enumerate(specs.LEGS):
        gait.broken_barh(_spells(strides, standing[:, i]), (i - 0.32, 0.64), color=LEG_COLORS[leg], linewidth=0)
    gait.set(
        title="Stance",
        xlabel="Time [s]",
        yticks=range(4),
        yticklabels=[_duty_label(strides, standing, i) for i in range(4)],
    )
    gait.set(ylim=(3.6, -0.6), xlim=(strides.time[0], strides.time[-1]))
    gait.grid(axis="y", visible=False)
    gait.tick_params(axis="y", length=0)
    _leg_legend(figure)
    return figure


@styled
def joint_figure(run: Trajectory) -> Figure:
    """The last strides: hip and knee angles with the policy's targets, and the springs' travel."""
    strides = _last_strides(run)
    angle, target = (np.rad2deg(x).reshape(-1, 4, 3) for x in (strides.joint_position, strides.target))
    figure = Figure(figsize=(WIDTH, 6.0), layout="constrained")
    hip, knee, spring = figure.subplots(3, 1, sharex=True)
    for i, leg in enumerate(specs.LEGS):
        color = LEG_COLORS[leg]
        for axes, j in ((hip, 1), (knee, 2)):
            axes.plot(strides.time, angle[:, i, j], color=color)
            axes.plot(strides.time, target[:, i, j], color=color, linewidth=0.8, linestyle=(0, (2, 1.5)), alpha=0.8)
        spring.plot(strides.time, 1e3 * strides.spring_compression[:, i], color=color)
    hip.set(title="Hip angle (dotted: target)", ylabel="Angle [deg]")
    knee.set(title="Knee angle (dotted: target)", ylabel="Angle [deg]")
    travel = 1e3 * run.hardware.spring_travel
    mark_level(spring, travel, "stop")
    spring.set(title="Spring compression", ylabel="Travel [mm]", xlabel="Time [s]")
    spring.set(xlim=(strides.time[0], strides.time[-1]))
    _leg_legend(figure)
    return figure


FIGURES: dict[str, tuple[Draw, str]] = {
    "speed": (speed_figure, "Forward speed with its command, and the drift from the line and heading at the start."),
    "torque_speed": (
        torque_speed_figure,
        "Torque over speed of the twelve motors, by the millisecond; shaded: what a motor can give.",
    ),
    "gait": (
        gait_figure,
        "The last strides: vertical foot forces, and the stance of each foot with its share of the stride.",
    ),
    "joints": (
        joint_figure,
        "The last strides: joint angles with the policy's targets, and the travel of the springs.",
    ),
}
"""What a report shows of a run, in order, by the name of the file, each with its caption."""


def _last_strides(run: Trajectory) -> Trajectory:
    steady = steady_window(run)
    end = steady.time[-1] + run.dt
    return steady.between(end - CLOSE_UP, end)


def _spells(run: Trajectory, standing: np.ndarray) -> list[tuple[float, float]]:
    """(start, length) of every spell of contact, s."""
    edges = np.diff(np.concatenate(([0], standing.astype(int), [0])))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(float(run.time[a]), float((b - a) * run.dt)) for a, b in zip(starts, stops, strict=True)]


def _duty_label(run: Trajectory, standing: np.ndarray, leg: int) -> str:
    """Leg name, with its share of stance where whole strides are in sight."""
    starts = touchdowns(standing[:, leg])
    if len(starts) < 2:
        return specs.LEGS[leg]
    return f"{specs.LEGS[leg]}  {np.mean(standing[starts[0] : starts[-1], leg]):.0%}"


def _leg_legend(figure: Figure, marker: str | None = None) -> None:
    """One legend of the four legs for the whole figure, above it."""
    axes: Axes = figure.axes[0]
    style: dict[str, Any] = {"marker": marker, "linestyle": "", "ms": 5} if marker else {"linewidth": 3}
    handles = [axes.plot([], [], color=color, label=leg, **style)[0] for leg, color in LEG_COLORS.items()]
    figure.legend(handles=handles, loc="outside upper right", ncols=4, handlelength=1.2, columnspacing=1.4)
