"""Pictures of a run: each function takes a Trajectory and returns a Matplotlib figure,
drawn off screen.

Each is drawn at a width in inches: `WIDTH` for a page, `NARROW` for a telephone, where
letters keep their size.
"""

from collections.abc import Callable

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from bp2_rl.base.plotting import (
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
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, of_joint, torque_limits
from bp2_rl.simulation.gait import contacts, leg_metrics
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.trajectory import Trajectory, best_window, steady_window

JOINT_TITLES = {"abad": "Abduction", "hip": "Hip", "knee": "Knee"}
CLOSE_UP = 1.2  # s of steady running shown stride by stride
SMOOTH = 0.01  # s: the mean that takes the chatter of contacts out of a foot's force
# the legs of a trot that swing together; the other two do the same half a stride later
PAIR = "FR", "RL"
CELL = 0.5, 4.0  # rad/s and Nm: of the torque-speed plane
OFTEN = LinearSegmentedColormap.from_list("often", ["#C4DDED", FRONT, "#00223A"])


@styled
def speed_figure(run: Trajectory, width: float = WIDTH) -> Figure:
    """Draw a run's forward speed and command over time, and the drift of its lateral
    offset and heading."""
    figure = Figure(figsize=(width, 4.8), layout="constrained")
    speed, lane = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))
    forward = run.ground_velocity[:, 0]
    speed.plot(
        run.time,
        forward,
        color=FRONT,
        alpha=0.25,
        linewidth=0.7,
        label="each millisecond",
        rasterized=True,
    )
    mean = moving_mean(forward, round(RIPPLE / run.dt))
    speed.plot(run.time, mean, color=FRONT, linewidth=1.8, label=f"{RIPPLE:g}-s mean")
    told = {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 1.2}
    speed.plot(run.time, run.command[:, 0], **told, label="command")
    best = best_window(run, 1.0)
    if best is not None:
        speed.axvspan(
            best.start,
            best.start + 1.0,
            color=LEG_COLORS["FL"],
            alpha=0.3,
            linewidth=0,
            label=f"best speed, {best.speed:.2f} m/s",
        )
    least = min(0.0, float(np.min(forward)))
    speed.set(ylabel="Speed [m/s]", title="Forward speed", ylim=(least, None))
    if width < WIDTH:
        # below the curve, which rises and stays
        speed.legend(loc="lower right", handlelength=1.6)
    else:
        legend_above(speed)
    for drift, leg, label in (
        (run.qpos[:, 1], "RR", "to the left [m]"),
        (run.heading, "RL", "heading [rad]"),
    ):
        lane.plot(run.time, drift - drift[0], color=LEG_COLORS[leg], label=label)
    lane.axhline(0.0, color=QUIET, linewidth=0.8)
    lane.set(
        title="Drift",
        xlabel="Time [s]",
        ylabel="[m], [rad]",
        xlim=(0.0, len(run) * run.dt),
    )
    legend_above(lane)
    if run.fell_at is not None:
        for axes in (speed, lane):
            axes.axvline(run.fell_at, color=FALL, linewidth=1.6)
        speed.annotate(
            "fell ",
            (run.fell_at, 0.02),
            xycoords=("data", "axes fraction"),
            ha="right",
            va="bottom",
            color=FALL,
        )
    return figure


@styled
def torque_speed_figure(run: Trajectory, width: float = WIDTH) -> Figure:
    """Draw where the motors worked: the share of time in each cell of torque and speed,
    inside the torque-speed envelope."""
    narrow = width < WIDTH
    figure = Figure(figsize=(width, 6.6 if narrow else 3.6), layout="constrained")
    panels = figure.subplots(*((3, 1) if narrow else (1, 3)), sharex=True, sharey=True)
    motors = Actuator.from_hardware(run.hardware)
    worked = run.joint_velocity, run.torque
    limits = run.hardware.joint_no_load_speed, run.hardware.joint_peak_torque
    reach, most = (
        room * max(float(np.max(limit)), float(np.nanmax(np.abs(values))))
        for room, limit, values in zip((1.15, 1.05), limits, worked, strict=True)
    )
    speeds = np.linspace(-reach, reach, 601)
    edges = [
        np.arange(-np.ceil(end / cell), np.ceil(end / cell) + 1) * cell
        for end, cell in zip((reach, most), CELL, strict=True)
    ]
    velocity, torque = (x.reshape(-1, 4, 3) for x in worked)
    percent = [
        np.histogram2d(velocity[:, :, j].ravel(), torque[:, :, j].ravel(), bins=edges)[
            0
        ]
        * (100.0 / (4 * len(run)))
        for j in range(3)
    ]
    norm = LogNorm(100.0 / (4 * len(run)), max(float(np.max(p)) for p in percent))
    for j, (axes, joint) in enumerate(zip(panels, conventions.JOINTS, strict=True)):
        low, high = torque_limits(of_joint(motors, j), speeds)
        axes.fill_between(speeds, low, high, color=FAINT, alpha=0.6, linewidth=0)
        shown = np.ma.masked_equal(percent[j].T, 0.0)
        axes.pcolormesh(*edges, shown, cmap=OFTEN, norm=norm, rasterized=True)
        axes.plot(speeds, np.stack((low, high), axis=-1), color=INK, linewidth=1.1)
        axes.set(
            title=JOINT_TITLES[joint],
            xlim=(-reach, reach),
            ylim=(-most, most),
            xlabel="Joint speed [rad/s]",
            ylabel="Torque [Nm]",
        )
        axes.grid(visible=False)
        axes.label_outer()
    figure.colorbar(
        ScalarMappable(norm, OFTEN),
        ax=panels,
        label="Share of time [%]",
        shrink=0.6 if narrow else 0.9,
        aspect=24,
        pad=0.02,
    )
    return figure


@styled
def gait_figure(run: Trajectory, width: float = WIDTH) -> Figure:
    """Draw the last strides, a row a leg: its vertical force without the chatter of
    contacts, and when it stands."""
    strides = _last_strides(run)
    standing = contacts(strides)
    smooth = moving_mean(strides.foot_force[:, :, 2], round(SMOOTH / run.dt))
    figure = Figure(figsize=(width, 6.0), layout="constrained")
    rows = figure.subplots(4, 1, sharex=True, sharey=True)
    weight = run.mass * conventions.GRAVITY
    for i, (axes, leg) in enumerate(
        zip(rows, leg_metrics(strides, strides), strict=True)
    ):
        color = LEG_COLORS[leg.name]
        axes.fill_between(
            strides.time,
            0.0,
            1.0,
            where=standing[:, i],
            transform=axes.get_xaxis_transform(),
            color=color,
            alpha=0.16,
            linewidth=0,
        )
        axes.plot(strides.time, smooth[:, i], color=color, linewidth=1.6)
        axes.axhline(weight, color=QUIET, linewidth=0.9, linestyle=(0, (4, 2)))
        # its share of stance, where whole strides are in sight
        duty = "" if leg.stride_frequency is None else f"  {leg.duty_factor:.0%}"
        axes.set_title(f"{leg.name}{duty}", fontsize="medium")
        axes.set_ylabel("Force [N]")
    rows[-1].set(
        xlabel="Time [s]", xlim=(strides.time[0], strides.time[-1]), ylim=(0.0, None)
    )
    return figure


@styled
def joint_figure(run: Trajectory, width: float = WIDTH) -> Figure:
    """Draw the angles of a diagonal pair's joints and springs over the last strides."""
    strides = _last_strides(run)
    angle, target = (
        np.rad2deg(x).reshape(-1, 4, 3)
        for x in (strides.joint_position, strides.target)
    )
    figure = Figure(figsize=(width, 6.0), layout="constrained")
    panels = figure.subplots(3 if run.hardware.anatomy.sprung else 2, 1, sharex=True)
    hip, knee = panels[:2]
    for leg in PAIR:
        i = conventions.LEGS.index(leg)
        color = LEG_COLORS[leg]
        for axes, j in ((hip, 1), (knee, 2)):
            axes.plot(strides.time, angle[:, i, j], color=color, label=leg)
            axes.plot(
                strides.time,
                target[:, i, j],
                color=color,
                linewidth=0.8,
                linestyle=(0, (2, 1.5)),
                alpha=0.8,
            )
        for spring in panels[2:]:
            spring.plot(
                strides.time, 1e3 * strides.spring_compression[:, i], color=color
            )
    hip.set(title="Hip angle", ylabel="Angle [deg]")
    hip.plot([], [], color=INK, linewidth=0.8, linestyle=(0, (2, 1.5)), label="target")
    legend_above(hip)
    knee.set(title="Knee angle", ylabel="Angle [deg]")
    for spring in panels[2:]:
        mark_level(spring, 1e3 * run.hardware.spring_travel, "stop")
        spring.set(title="Spring compression", ylabel="Travel [mm]")
    panels[-1].set(xlabel="Time [s]", xlim=(strides.time[0], strides.time[-1]))
    return figure


FIGURES: dict[str, tuple[Callable[..., Figure], str]] = {
    "speed": (
        speed_figure,
        "Forward speed with its command, and the drift from the line and heading at the start.",
    ),
    "torque_speed": (
        torque_speed_figure,
        "How long the motors worked at each torque and speed, the four legs' together; shaded: what a motor can give.",
    ),
    "gait": (
        gait_figure,
        "The last strides: vertical foot forces, means over 10 ms; dashed: body weight; shaded: stance, with its "
        "share of the stride.",
    ),
    "joints": (
        joint_figure,
        "The last strides of one diagonal pair: joint angles with the policy's targets; below, if there are springs, "
        "their travel.",
    ),
}
"""The figures of a run in a report: file name, drawing function and caption, in the
order shown."""


def _last_strides(run: Trajectory) -> Trajectory:
    steady = steady_window(run)
    end = steady.time[-1] + run.dt
    return steady.between(end - CLOSE_UP, end)
