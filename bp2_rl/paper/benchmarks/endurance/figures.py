"""Figures of motors that warm up: temperatures over time, torque over speed."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import (
    FAINT,
    FALL,
    INK,
    LEG_COLORS,
    WIDTH,
    mark_level,
    styled,
)
from bp2_rl.paper.benchmarks.endurance.heating import EnduranceResult, HeatedRun
from bp2_rl.paper.motor_heat import RISE, Network, Temperatures, heated
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.robot.bp2 import ENDURANCE_TIME
from bp2_rl.robot.hardware import HardwareSpec

DASHES = {"hip": "-", "knee": "--", "abad": ":"}
PAPER = LEG_COLORS["FL"]

TEMPERATURES = (
    "The windings' temperatures; circles: the hottest one where heat runs faster than motion; yellow: the paper's rear "
    "hip, 1.8 K/s for 86 s, on which the motor is calibrated."
)
OPERATING = (
    "Torque over speed of the hottest motor's hip and knee, by the millisecond and coloured by time; black: the cold "
    "envelope, red: the one at the end."
)


@styled
def draw_temperatures(
    heat: MotorHeat, runs: Sequence[HeatedRun], accelerated: Sequence[HeatedRun]
) -> Figure:
    """Draw all windings' temperatures over time, a speed a panel."""
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(runs), sharey=True))
    for axes, run, fast in zip(panels, runs, accelerated, strict=True):
        end = run.endured
        hot = conventions.MOTOR_NAMES.index(end.hottest)
        time = np.array([0.0, *run.course.time, end.seconds])
        winding = np.array([(heat.air,) * 12, *run.course.winding, end.winding])
        for i, name in enumerate(conventions.MOTOR_NAMES):
            leg, joint = name.split("_")
            width = 2.6 if i == hot else 1.2
            axes.plot(
                time, winding[:, i], DASHES[joint], color=LEG_COLORS[leg], lw=width
            )
        fast_hot = [each[hot] for each in fast.course.winding]
        axes.plot(fast.course.time, fast_hot, "o", ms=4.5, mfc="white", mec=INK)
        rise = [heat.air, heat.air + RISE]
        axes.plot([0.0, ENDURANCE_TIME], rise, color=PAPER, lw=6.0, alpha=0.35)
        mark_level(axes, heat.limit, f"limit, {heat.limit:g} °C")
        axes.set(title=f"{_title(end)}: {end.seconds:.0f} s", xlabel="Time [s]")
    panels[0].set_ylabel("Winding [°C]")
    legs = [Line2D([], [], color=color, label=leg) for leg, color in LEG_COLORS.items()]
    joints = [Line2D([], [], color=INK, ls=ls, label=j) for j, ls in DASHES.items()]
    figure.legend(handles=legs + joints, loc="outside upper right", ncols=7)
    return figure


@styled
def draw_operating_points(
    heat: MotorHeat, runs: Sequence[HeatedRun], robot: HardwareSpec
) -> Figure:
    """Draw the hottest leg's torque over speed, coloured by time.

    Rows are speeds, columns the leg's hip and knee.
    """
    count = len(runs)
    figure = Figure(figsize=(WIDTH, 0.6 + 3.3 * count), layout="constrained")
    panels = figure.subplots(count, 2, sharex=True, sharey=True, squeeze=False)
    motors = Actuator.from_hardware(robot)
    network = Network.from_spec(heat, heat.winding_to_case or 1.0)
    fastest = max(float(np.max(np.abs(run.rate), initial=0.0)) for run in runs)
    reach = 1.12 * max(robot.joint_no_load_speed, fastest)
    speeds = np.linspace(-reach, reach, 601)
    cold = torque_limits(motors, speeds)
    for row, run in zip(panels, runs, strict=True):
        end, leg = (
            run.endured,
            3 * (conventions.MOTOR_NAMES.index(run.endured.hottest) // 3),
        )
        for axes, i in zip(row, (leg + 1, leg + 2), strict=True):
            now = Temperatures(np.array([end.winding[i]]), np.array([end.case[i]]))
            hot = torque_limits(heated(motors, network, now), speeds)
            axes.fill_between(speeds, *cold, color=FAINT, alpha=0.6, linewidth=0)
            points = axes.scatter(
                run.rate[:, i],
                run.torque[:, i],
                c=run.time,
                s=4.0,
                cmap="plasma",
                vmin=0.0,
                vmax=max(end.seconds, 1.0),
                rasterized=True,
            )
            axes.plot(speeds, np.transpose(cold), color=INK, linewidth=1.1)
            axes.plot(speeds, np.transpose(hot), color=FALL, linewidth=1.6)
            motor = f"{conventions.MOTOR_NAMES[i]} to {end.winding[i]:.0f} °C"
            title = f"{motor}, at {end.speed:.1f} m/s"
            axes.set(title=title, xlabel="Joint speed [rad/s]")
            figure.colorbar(points, ax=axes, label="Time [s]")
        row[0].set_ylabel("Joint torque [Nm]")
    return figure


def _title(end: EnduranceResult) -> str:
    return f"{end.speed:.1f} m/s ({end.commanded_speed:g} commanded)"
