"""The endurance benchmark: how long the motors let a robot hold its speed.

A run ends when a winding is too hot, no torque margin is left, or the robot falls.

The motor is calibrated on the paper's 1.8 K/s over 86 s, in this policy's gait at the
paper's speed: so 86 s are put in there, and not predicted. What is predicted is which
motor gets hottest, how long it lasts at other speeds, and what ends it.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.metric import Row, Table, card_of, rounded, rows_of
from bp2_rl.base.plotting import (
    FAINT,
    FALL,
    INK,
    LEG_COLORS,
    WIDTH,
    mark_level,
    styled,
)
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_rise,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.endurance.heating import (
    EASING,
    MARGIN,
    UPDATE,
    WINDOW,
    EnduranceResult,
    HeatedRun,
    HeatingCourse,
    HeatingTry,
    run_hot,
)
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.paper.benchmarks.speeds import table_over_speed
from bp2_rl.paper.motor_heat import RISE, Temperatures, calibrated, heated
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.robot.bp2 import ENDURANCE_TIME
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.schedule import Ramp

SPEED = bp2.OUTDOOR_TOP_SPEED
LONGEST = 2.0 * bp2.ENDURANCE_TIME + 8.0  # s
# of the accelerated runs: heat over seconds wavers, so a faster pace samples too few of
# them
PACE = 4.0
# s of cold running; a hip's heat wavers by a tenth from one second to the next
CALIBRATION = 12.0
REAR_HIPS = (
    conventions.MOTOR_NAMES.index("RR_hip"),
    conventions.MOTOR_NAMES.index("RL_hip"),
)
TILES = "Lasted", "Ended by", "Hottest motor", "Mean rate"
ENDS = {
    "winding": "{} too hot",
    "torque margin": "{} too weak",
    "fall": "fell",
    "none": "not ended",
}
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


@dataclasses.dataclass(frozen=True)
class HeldSpeed:
    """Results of holding one speed until the motors are too hot or weak, or a fall."""

    # with heat as fast as motion; None in the quick version
    full: EnduranceResult | None
    accelerated: EnduranceResult  # with heat faster than motion
    course: HeatingCourse  # of the full run where there is one

    @property
    def result(self) -> EnduranceResult:
        """Result of the full run or, in the quick version, of the accelerated run."""
        return self.full or self.accelerated


@dataclasses.dataclass(frozen=True)
class EnduranceMetrics:
    """Endurance at each commanded speed, and the motor heat model behind the
    results."""

    heat: MotorHeat  # as calibrated
    is_input: bool  # whether the heating rate at the paper's speed was put in
    # W, of the hottest rear hip's winding at T_0, at the paper's speed: what it was
    # calibrated on
    cold_heat: float
    held: tuple[HeldSpeed, ...]  # the paper's speed, then the top


def endurance(policy: Policy, ramp: Ramp, setup: DeepBenchmarkOptions) -> Evaluation:
    """Calibrate the motor heat model, then measure how long the paper's speed and the
    top speed can be held."""
    robot = robot_of(policy, setup)
    commands = tuple(dict.fromkeys((SPEED, ramp.target[0])))
    gait = HeatingTry(
        robot,
        setup.operator,
        ramp,
        setup.heat,
        longest=0.0,
        pace=1.0,
        cold_window=CALIBRATION,
    )
    (cold,) = run_hot(policy, [gait.at(SPEED)])
    cold_heat = max(cold.endured.first.heat[hip] for hip in REAR_HIPS)
    heat = calibrated(setup.heat, cold_heat)
    full = HeatingTry(robot, setup.operator, ramp, heat, ramp.hold, pace=1.0)
    fast = dataclasses.replace(full, pace=PACE)
    kinds = [fast] if setup.quick else [full, fast]
    ran = run_hot(policy, [kind.at(speed) for kind in kinds for speed in commands])
    runs, accelerated = ran[: len(commands)], ran[-len(commands) :]
    held = tuple(
        HeldSpeed(None if setup.quick else run.endured, quick.endured, run.course)
        for run, quick in zip(runs, accelerated, strict=True)
    )
    metrics = EnduranceMetrics(
        heat, setup.heat.winding_to_case is None, cold_heat, held
    )
    put_in = "put in" if metrics.is_input else "predicted"
    return Evaluation(
        benchmark="endurance",
        subject=describe_subject(policy, setup),
        conditions=conditions(policy, setup, describe_course(ramp, commands))
        | {"motor heat": describe_heat(metrics)},
        verdict=say_endurance(metrics),
        good=all(one.result.cause != "fall" for one in held),
        rows=(
            Row("Paper's 86 s", put_in, "what follows is at 10.74 m/s"),
            *rows_of(held[0].result),
        ),
        tiles=TILES,
        pictures=(
            Picture(
                "temperatures",
                TEMPERATURES,
                draw_temperatures(heat, runs, accelerated),
            ),
            Picture(
                "operating_points",
                OPERATING,
                draw_operating_points(heat, runs, robot),
            ),
        ),
        metrics=metrics,
        results={
            "at_10.74": _card(held[0]),
            "at_top": _card(held[-1]),
            "calibrated_on_86_s": metrics.is_input,
            "winding_capacity": rounded(heat.winding_capacity),
            "winding_to_case": rounded(heat.winding_to_case),
        },
        tables=(speed_table(held), *(motor_table(one.result) for one in held)),
    )


def ramp_to_endurance(policy: Policy, setup: DeepBenchmarkOptions) -> Ramp:
    """Return the command's ramp to the top speed, held until the run ends, at most
    `LONGEST` s by default."""
    return ramp_to_topspeed(policy, setup, hold=LONGEST)


def say_endurance(metrics: EnduranceMetrics) -> str:
    """Return a sentence: how long each speed was held, and what ended the run."""
    results = [held.result for held in metrics.held]
    return "; ".join(
        f"{end.commanded_speed:g} m/s: {end.seconds:.0f} s, {ENDS[end.cause].format(end.motor)}"
        for end in results
    )


def speed_table(held: tuple[HeldSpeed, ...]) -> Table:
    """Return the table of all endurance metrics, with a column for each speed."""
    columns = [
        {row.label: row.value for row in rows_of(one.result)}
        | {"Lasted, accelerated": f"{one.accelerated.seconds:.1f} s"}
        for one in held
    ]
    return table_over_speed(
        "At each speed", [one.result.speed for one in held], columns
    )


def motor_table(end: EnduranceResult) -> Table:
    """Return the table of all motors' heat, torques and temperatures at the end of a
    run."""
    columns = {
        "Heat, cold [W]": end.first.heat,
        "RMS torque [Nm]": end.first.torque,
        "Winding [°C]": end.winding,
        "Case [°C]": end.case,
        "On envelope [%]": [100.0 * share for share in end.first.on_envelope],
        "... at the end [%]": [100.0 * share for share in end.last.on_envelope],
    }
    lines = [
        (motor, *(f"{value:.0f}" for value in values))
        for motor, *values in zip(
            conventions.MOTOR_NAMES, *columns.values(), strict=True
        )
    ]
    title = f"Motors at the end of {end.commanded_speed:g} m/s"
    return Table(title, ("Motor", *columns), lines)


def _card(held: HeldSpeed) -> dict[str, object]:
    accelerated = card_of(held.accelerated)["seconds"]
    return card_of(held.result) | {"accelerated_seconds": accelerated}


# --- How it was done ------------------------------------------------------------------


def describe_course(ramp: Ramp, commands: tuple[float, ...]) -> str:
    """Return a line on the command's schedule and on what ends a run."""
    return (
        f"from a stand to {' and '.join(f'{speed:g}' for speed in commands)} m/s {describe_rise(ramp)}; "
        f"{EASING + WINDOW:g} s later the clock starts with motors as warm as the air, and the command is held until a "
        f"winding is at its limit, or the speed over a second is below {MARGIN:.0%} of the cold one (no torque "
        f"margin), or the robot falls; {ramp.hold:g} s at most"
    )


def describe_heat(metrics: EnduranceMetrics) -> str:
    """Return a line with the parameters of the motor heat model."""
    h = metrics.heat
    how = (
        f"calibrated on {metrics.cold_heat:.0f} W of the hottest rear hip"
        if metrics.is_input
        else "given"
    )
    return (
        f"winding {h.winding_capacity:.4g} J/K, {h.winding_to_case:.3g} K/W to the case ({how}), case "
        f"{h.case_capacity:g} J/K, {h.case_to_air:g} K/W to the air of {h.air:g} °C, copper "
        f"+{h.copper_growth:.2%}/K, magnets -{h.magnet_loss:.2%}/K, iron {h.iron_loss:g} W, limit {h.limit:g} °C; "
        f"the envelope follows the temperatures every {UPDATE} ms of running; accelerated: heat runs faster than motion"
    )


# --- Figures --------------------------------------------------------------------------


@styled
def draw_temperatures(
    heat: MotorHeat, runs: Sequence[HeatedRun], accelerated: Sequence[HeatedRun]
) -> Figure:
    """Draw the temperatures of all windings over time, with a panel for each speed."""
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
        title = f"{end.speed:.1f} m/s ({end.commanded_speed:g} commanded)"
        axes.set(title=f"{title}: {end.seconds:.0f} s", xlabel="Time [s]")
    panels[0].set_ylabel("Winding [°C]")
    legs = [Line2D([], [], color=color, label=leg) for leg, color in LEG_COLORS.items()]
    joints = [Line2D([], [], color=INK, ls=ls, label=j) for j, ls in DASHES.items()]
    figure.legend(handles=legs + joints, loc="outside upper right", ncols=7)
    return figure


@styled
def draw_operating_points(
    heat: MotorHeat, runs: Sequence[HeatedRun], robot: HardwareSpec
) -> Figure:
    """Draw joint torque over joint speed of the leg with the hottest motor, coloured by
    time.

    Rows are speeds, columns the leg's hip and knee.
    """
    count = len(runs)
    figure = Figure(figsize=(WIDTH, 0.6 + 3.3 * count), layout="constrained")
    panels = figure.subplots(count, 2, sharex=True, sharey=True, squeeze=False)
    motors = Actuator.from_hardware(robot)
    fastest = max(float(np.max(np.abs(run.rate), initial=0.0)) for run in runs)
    reach = 1.12 * max(robot.joint_no_load_speed, fastest)
    speeds = np.linspace(-reach, reach, 601)
    cold = torque_limits(motors, speeds)
    for row, run in zip(panels, runs, strict=True):
        end = run.endured
        leg = 3 * (conventions.MOTOR_NAMES.index(end.hottest) // 3)
        for axes, i in zip(row, (leg + 1, leg + 2), strict=True):
            now = Temperatures(np.array([end.winding[i]]), np.array([end.case[i]]))
            hot = torque_limits(heated(motors, heat, now), speeds)
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
