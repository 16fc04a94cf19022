"""What the endurance benchmark says: in one sentence, in rows and tables, and on a
policy's card."""

from typing import Any

import numpy as np

from bp2_rl.evaluation.benchmarks.conditions import describe_rise
from bp2_rl.evaluation.benchmarks.outcome import NOT_MEASURED, Row, Table, rounded, show
from bp2_rl.paper.benchmarks.endurance.heating import (
    EASING,
    MARGIN,
    UPDATE,
    WINDOW,
    EnduranceResult,
)
from bp2_rl.paper.benchmarks.endurance.measured import (
    EnduranceAtSpeed,
    EnduranceMetrics,
    HeldSpeed,
    joint_of,
)
from bp2_rl.paper.motor_heat import Network, Temperatures, heated
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.simulation.schedule import Ramp

TILES = (
    "At 10.74 m/s",
    "At the top",
    "Speed at the top",
    "Hottest motor",
    "Ended by",
    "Hip to knee",
)
CAUSES = {
    "torque margin": "torque margin",
    "fall": "fall",
    "none": "nothing within the limit",
}


def cause(metrics: EnduranceMetrics, run: EnduranceResult) -> str:
    """What ended a run."""
    if run.cause != "winding":
        return CAUSES[run.cause]
    return (
        "class H, 180 °C"
        if metrics.heat.limit == MotorHeat().limit
        else f"{metrics.heat.limit:g} °C"
    )


def verdict(metrics: EnduranceMetrics) -> str:
    """All runs in one sentence."""
    ends = {
        "winding": "{} too hot",
        "torque margin": "{} too weak",
        "fall": "fell",
        "none": "not ended",
    }
    return "; ".join(
        f"{held.result.commanded_speed:g} m/s: {held.result.seconds:.0f} s, "
        f"{ends[held.result.cause].format(conventions.MOTOR_NAMES[held.motor])}"
        for held in metrics.held
    )


def endurance_rows(metrics: EnduranceMetrics) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    slow, top = metrics.held[0], metrics.held[-1]
    cold = top.result.first
    put_in = (
        "put in: calibrated on the paper's 86 s"
        if metrics.is_input
        else "predicted, with the motor given"
    )
    agreements = [
        abs(held.disagreement) for held in metrics.held if held.disagreement is not None
    ]
    return (
        Row("At 10.74 m/s", f"{slow.result.seconds:.1f} s", put_in),
        Row(
            "At the top",
            f"{top.result.seconds:.1f} s",
            f"predicted; {top.result.commanded_speed:g} m/s commanded",
        ),
        Row(
            "Speed at the top",
            f"{cold.speed:.2f} m/s",
            f"cold; {top.result.last.speed:.2f} m/s at the end",
        ),
        Row(
            "Hottest motor",
            joint_of(slow.hottest),
            f"predicted; at the top {joint_of(top.hottest)}",
        ),
        Row(
            "Ended by",
            cause(metrics, slow.result),
            f"predicted; at the top {cause(metrics, top.result)}",
        ),
        Row(
            "Mean rate",
            f"{mean_rate(metrics, slow):.2f} K/s",
            "of that motor's winding",
        ),
        Row(
            "... at the top",
            f"{mean_rate(metrics, top):.2f} K/s",
            "of the hottest winding there",
        ),
        Row(
            "Hip to knee",
            f"{hip_to_knee(metrics, slow):.2f}",
            "rise of the hottest leg's windings",
        ),
        Row(
            "Magnets",
            f"{max(slow.result.case):.0f} °C",
            "hottest case at the end, at 10.74 m/s",
        ),
        Row(
            "Torque cycle",
            f"x {growth(slow, 'torque'):.3f}",
            "RMS, last seconds over first",
        ),
        Row(
            "Speed cycle",
            f"x {growth(slow, 'rate'):.3f}",
            "RMS of its joint, last over first",
        ),
        Row(
            "On the envelope",
            on_envelope(slow),
            "hottest motor, first and last seconds",
        ),
        Row(
            "... at the top", on_envelope(top), "hottest motor, first and last seconds"
        ),
        Row("Margin, no limit", margin_end(slow), "10.74 m/s, if nothing could burn"),
        Row("... at the top", margin_end(top), "top speed, if nothing could burn"),
        Row(
            "Drawn robots",
            drawn_range(metrics),
            "10.74 m/s; by the heat of the cold gait",
        ),
        Row(
            "Accelerated, full",
            show(max(agreements, default=None), ".1%"),
            "difference of their times, at most",
        ),
        Row(
            "Outside the envelope",
            f"{outside(metrics)}",
            "samples, of the hot one; must be 0",
        ),
    )


def mean_rate(metrics: EnduranceMetrics, held: HeldSpeed) -> float:
    """K/s, of the hottest winding over the whole run."""
    rise = max(held.result.winding) - metrics.heat.air
    return rise / held.result.seconds if held.result.seconds > 0.0 else 0.0


def hip_to_knee(metrics: EnduranceMetrics, held: HeldSpeed) -> float:
    """How much more the hip of the hottest motor's leg warmed than its knee."""
    leg = 3 * (held.hottest // 3)
    hip, knee = (
        held.result.winding[leg + joint] - metrics.heat.air for joint in (1, 2)
    )
    return hip / knee if knee > 0.0 else 1.0


def growth(held: HeldSpeed, quantity: str) -> float:
    """Return by what factor the hottest motor's torque (root mean square) or joint
    speed grows over the windows."""
    first, last = (
        getattr(window, quantity)[held.hottest]
        for window in (held.result.first, held.result.last)
    )
    return last / first if first > 0.0 else 1.0


def margin_end(held: HeldSpeed) -> str:
    """When and how hot the torque margin would be gone if nothing burnt before."""
    run = held.limitless
    if run is None:
        return NOT_MEASURED
    return (
        f"{run.seconds:.0f} s, {max(run.winding):.0f} °C"
        if run.cause != "none"
        else f"> {run.seconds:.0f} s"
    )


def drawn_range(metrics: EnduranceMetrics) -> str:
    """Shortest and longest time of the drawn robots."""
    times = metrics.drawn_times
    return f"{times[0]:.0f} to {times[-1]:.0f} s" if times else NOT_MEASURED


def on_envelope(held: HeldSpeed) -> str:
    """The hottest motor's share of time on the envelope, cold and hot."""
    first, last = (
        window.on_envelope[held.hottest]
        for window in (held.result.first, held.result.last)
    )
    return f"{first:.1%}, {last:.1%}"


def outside(metrics: EnduranceMetrics) -> int:
    """Samples outside the envelope of the moment, in all runs."""
    runs = (
        run
        for held in metrics.held
        for run in (held.full, held.accelerated, held.limitless)
    )
    return sum(run.outside_envelope for run in runs if run is not None)


def endurance_tables(metrics: EnduranceMetrics) -> tuple[Table, ...]:
    """Beside the paper; every run; every motor; every speed; every motor that would
    heat as the paper's."""
    return (
        paper_table(metrics),
        run_table(metrics),
        *(motor_table(metrics, held) for held in metrics.held),
        speed_table(metrics),
        *((drawn_table(metrics),) if metrics.drawn else ()),
        family_table(metrics),
    )


def paper_table(metrics: EnduranceMetrics) -> Table:
    """What the paper's endurance test found, and what comes out here."""
    slow, bent = metrics.held[0], metrics.straightest
    put_in = "input" if metrics.is_input else "predicted"
    rear_hip = joint_of(slow.hottest).startswith("rear") and joint_of(
        slow.hottest
    ).endswith("hip")
    weak, strong = hot_torque(metrics, slow)
    return Table(
        "Beside the paper's endurance test",
        ("What", "Paper", "Here", "How"),
        [
            (
                "Time above 10 m/s",
                "86 s",
                f"{slow.result.seconds:.0f} s at {slow.result.first.speed:.2f} m/s",
                put_in,
            ),
            (
                "Mean rate of a rear hip",
                "1.8 K/s",
                f"{mean_rate(metrics, slow):.2f} K/s",
                put_in,
            ),
            (
                "Shape of the rise",
                "nearly linear",
                f"straightest with {bent.winding_capacity:.0f} J/K and {bent.winding_to_case:.2g} K/W: "
                f"{bent.first_rate:.2f} to {bent.last_rate:.2f} K/s",
                "input: picks one of the family",
            ),
            (
                "Hottest motor",
                "rear hip",
                joint_of(slow.hottest),
                f"predicted: {'same' if rear_hip else 'differs'}",
            ),
            (
                "What ends it",
                "torque margin, then balance",
                cause(metrics, slow.result),
                "predicted: "
                + ("same" if slow.result.cause == "torque margin" else "differs"),
            ),
            (
                "Torque margin, were there no limit",
                "gone after 86 s",
                margin_end(slow),
                "predicted: compare",
            ),
            (
                "Torque of a hot motor",
                "less",
                f"{weak:+.0%} at the corner, {strong:+.0%} at 95 % of the no-load speed",
                "predicted: "
                + ("same at the corner, more near no load" if strong > 0.0 else "same"),
            ),
            (
                "Operating cycles",
                "expand outwards",
                f"torque x {growth(slow, 'torque'):.3f}, speed x {growth(slow, 'rate'):.3f}",
                "predicted: compare",
            ),
            (
                "Motors close to their envelope",
                "throughout",
                f"hottest motor on it {on_envelope(slow)} of the time, first and last seconds",
                "predicted: compare",
            ),
        ],
        words=True,
    )


def hot_torque(metrics: EnduranceMetrics, held: HeldSpeed) -> tuple[float, float]:
    """Change of the hottest motor's greatest torque at the end of a run, at the corner
    and near the no-load speed."""
    motors = Actuator.from_hardware()
    network = Network.from_spec(metrics.heat, metrics.heat.winding_to_case or 1.0)
    end = Temperatures(
        *(
            np.array([values[held.hottest]])
            for values in (held.result.winding, held.result.case)
        )
    )
    hot, changes = heated(motors, network, end), []
    for speed in (motors.corner_speed, 0.95 * motors.no_load_speed):
        at = np.array([speed])
        changes.append(
            float(torque_limits(hot, at)[1][0] / torque_limits(motors, at)[1][0]) - 1.0
        )
    return changes[0], changes[1]


def run_table(metrics: EnduranceMetrics) -> Table:
    """Every run, and how its accelerated version and the cold gait alone foretell
    it."""
    head = (
        "Command",
        "Cold [m/s]",
        "End [m/s]",
        "Time [s]",
        "Accelerated [s]",
        "By cold gait [s]",
        "Ended by",
        "Motor",
    )
    lines = [
        (
            f"{held.result.commanded_speed:g} m/s",
            f"{held.result.first.speed:.2f}",
            f"{held.result.last.speed:.2f}",
            f"{held.result.seconds:.1f}",
            f"{held.accelerated.seconds:.1f}",
            show(held.by_cold_gait, ".1f"),
            cause(metrics, held.result),
            joint_of(held.motor),
        )
        for held in metrics.held
    ]
    return Table("Runs", head, lines)


def motor_table(metrics: EnduranceMetrics, held: HeldSpeed) -> Table:
    """Every motor of a run."""
    run = held.result
    head = (
        "Motor",
        "Heat, cold [W]",
        "RMS torque [Nm]",
        "Winding [°C]",
        "Case [°C]",
        "On envelope",
        "... at the end",
    )
    lines = [
        (
            name,
            f"{run.first.heat[i]:.0f}",
            f"{run.first.torque[i]:.0f}",
            f"{run.winding[i]:.0f}",
            f"{run.case[i]:.0f}",
            f"{run.first.on_envelope[i]:.1%}",
            f"{run.last.on_envelope[i]:.1%}",
        )
        for i, name in enumerate(conventions.MOTOR_NAMES)
    ]
    return Table(f"Motors at the end of {run.commanded_speed:g} m/s", head, lines)


def speed_table(metrics: EnduranceMetrics) -> Table:
    """How endurance goes with speed."""
    head = (
        "Command",
        "Speed [m/s]",
        "RMS torque [Nm]",
        "Heat [W]",
        "To the limit [s]",
        "Motor",
    )
    lines = [
        (f"{at.commanded_speed:g} m/s", *_of_cold_gait(at)) for at in metrics.speeds
    ]
    return Table("Over speed, by the heat of the cold gait", head, lines)


def drawn_table(metrics: EnduranceMetrics) -> Table:
    """Robots drawn as in training, at the paper's speed."""
    head = (
        "Robot",
        "Friction",
        "Mass x",
        "Strength x",
        "Latency [ms]",
        "Speed [m/s]",
        "RMS torque [Nm]",
        "Heat [W]",
        "To the limit [s]",
        "Motor",
    )
    lines = [
        (
            f"{i}",
            f"{one.friction:.2f}",
            f"{one.mass:.2f}",
            f"{one.strength:.2f}",
            f"{1e3 * one.latency:.1f}",
            *_of_cold_gait(one.ran),
        )
        for i, one in enumerate(metrics.drawn, 1)
    ]
    return Table("Drawn robots at 10.74 m/s, by the heat of the cold gait", head, lines)


def _of_cold_gait(at: EnduranceAtSpeed) -> tuple[str, ...]:
    seconds = "> 3600" if at.seconds is None else f"{at.seconds:.0f}"
    return (
        f"{at.speed:.2f}",
        f"{at.torque:.0f}",
        f"{at.heat:.0f}",
        "fell" if at.fell else seconds,
        at.motor,
    )


def family_table(metrics: EnduranceMetrics) -> Table:
    """Motors that would heat at the paper's mean rate."""
    head = (
        "Winding [J/K]",
        "Copper [kg]",
        "To case [K/W]",
        "First [K/s]",
        "Last [K/s]",
        "Off straight [K]",
        "Case [°C]",
        "At the top [s]",
    )
    lines = [
        (
            f"{m.winding_capacity:.1f}",
            f"{m.winding_capacity / COPPER:.3f}",
            f"{m.winding_to_case:.3g}",
            f"{m.first_rate:.2f}",
            f"{m.last_rate:.2f}",
            f"{m.bend:.2f}",
            f"{m.case:.0f}",
            show(m.at_top, ".1f"),
        )
        for m in metrics.family
    ]
    return Table("Motors that heat at the paper's mean rate over 86 s", head, lines)


COPPER = 385.0  # J/kg/K


def endurance_results(metrics: EnduranceMetrics) -> dict[str, Any]:
    """What a policy's card says."""
    slow, top = metrics.held[0], metrics.held[-1]

    def said(held: HeldSpeed) -> dict[str, Any]:
        return {
            "commanded_speed": held.result.commanded_speed,
            "speed": held.result.first.speed,
            "seconds": held.result.seconds,
            "cause": held.result.cause,
            "motor": conventions.MOTOR_NAMES[held.motor],
            "hottest_winding": max(held.result.winding),
            "hottest_case": max(held.result.case),
            "accelerated_seconds": held.accelerated.seconds,
            "margin_gone_without_limit": held.limitless
            and (held.limitless.seconds, held.limitless.cause),
        }

    return rounded(
        {
            "at_10.74": said(slow),
            "at_top": said(top),
            "drawn_robots": metrics.drawn_times,
            "calibrated_on_86_s": metrics.is_input,
            "winding_capacity": metrics.heat.winding_capacity,
            "winding_to_case": metrics.heat.winding_to_case,
            "straightest_winding_capacity": metrics.straightest.winding_capacity,
            "straightest_winding_to_case": metrics.straightest.winding_to_case,
        }
    )


# --- How it was done ------------------------------------------------------------------


def describe_course(ramp: Ramp, commands: tuple[float, ...]) -> str:
    """The schedules in one line."""
    return (
        f"from a stand to {' and '.join(f'{speed:g}' for speed in commands)} m/s {describe_rise(ramp)}; "
        f"{EASING + WINDOW:g} s later the clock starts with motors as warm as the air, and the command is held until a "
        f"winding is at its limit, or the speed over a second is below {MARGIN:.0%} of the cold one (no torque "
        f"margin), or the robot falls; {ramp.hold:g} s at most"
    )


def describe_heat(metrics: EnduranceMetrics) -> str:
    """The motors' heat in one line."""
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
