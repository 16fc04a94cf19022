"""What a report shows of a single run: rows, tables, pictures and the results for a
card."""

from collections.abc import Sequence
from typing import Any

from bp2_rl.base.plotting import NARROW
from bp2_rl.evaluation.benchmarks.outcome import (
    NOT_MEASURED,
    Picture,
    Row,
    Table,
    rounded,
    show,
    show_fall,
)
from bp2_rl.simulation.account import HARD, PLATE
from bp2_rl.simulation.figures import FIGURES
from bp2_rl.simulation.metrics import Account, RunMetrics
from bp2_rl.simulation.trajectory import Trajectory

ENERGY = {
    "copper": "windings",
    "gears": "gears",
    "joints": "joint friction",
    "slides": "spring slides",
    "dampers": "spring dampers and rebound stops",
    "air": "air",
    "ground": "ground, impacts and slip",
    "stops": "joint limits",
    "legs": "legs against each other",
    "stored": "stored: motion, height, springs",
    "integration": "lost by steps of 1 ms (no loss of the robot's)",
}

OF_SPRINGS = ("slides", "dampers")
"""Causes that a robot with rigid shanks does not have."""


def run_rows(metrics: RunMetrics) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    m = metrics
    return (
        Row(
            "Best speed",
            show(m.best_speed, ".2f", "m/s"),
            "best 1-s mean of forward speed",
        ),
        Row("Best 5 s", show(m.held_speed, ".2f", "m/s"), "best 5-s mean of the hold"),
        Row("Commanded speed", show(m.commanded_speed, ".2f", "m/s"), "at the end"),
        Row(
            "Mean speed",
            show(m.mean_speed, ".2f", "m/s"),
            f"steady window, {m.steady_from:.1f} to {m.steady_to:.1f} s",
        ),
        Row(
            "Slowest second",
            show(m.slowest_held_speed, ".2f", "m/s"),
            "lowest 1-s mean while held",
        ),
        Row(
            "Tracking error",
            show(m.tracking_error, ".2f", "m/s"),
            "mean |speed - command| while held",
        ),
        Row("Fall", show_fall(m.fell_at), f"in {m.duration:.1f} s"),
        Row("Time held", f"{m.hold_time:.1f} s", "at the final command"),
        Row("Distance", f"{m.distance:.1f} m", "straight from start to end"),
        Row(
            "Lateral drift",
            f"{m.lateral_drift:.2f} m",
            "greatest, from the first heading's line",
        ),
        Row(
            "Heading drift",
            f"{m.heading_drift:.2f} rad",
            "greatest, from the first heading",
        ),
        *motor_rows(m),
        Row("Peak foot force", f"{m.peak_foot_force:.0f} N", "impacts included"),
        *spring_rows(m),
        *leg_rows(m),
        Row(
            "Stride frequency",
            show(m.stride_frequency, ".2f", "Hz"),
            "mean of legs, steady window",
        ),
        Row("Duty factor", f"{m.duty_factor:.2f}", "mean of legs, steady window"),
        Row(
            "Off half a cycle",
            show(m.off_half_cycle, ".3f"),
            "cycles, left to right, centroids of force",
        ),
        Row(
            "Left and right", show(m.uneven, ".1%"), "one side has more of the impulse"
        ),
        Row("Trunk height", f"{m.trunk_height:.3f} m", "mean, steady window"),
        Row(
            "Mechanical cost",
            show(m.mechanical_cost_of_transport, ".2f"),
            "positive motor work / (m g distance)",
        ),
        Row(
            "Electrical cost",
            show(m.electrical_cost_of_transport, ".2f"),
            "with copper heat / (m g distance)",
        ),
        Row(
            "Mechanical power",
            f"{m.mechanical_power:.0f} W",
            "positive, mean, steady window",
        ),
        Row(
            "Electrical power",
            f"{m.electrical_power:.0f} W",
            "mean, with copper heat, steady window",
        ),
        *(account_rows(m.account, sprung(m)) if m.account else ()),
        Row(
            "Froude number",
            show(m.froude_number, ".1f"),
            "v\u00b2 / (g h) at top speed, h: standing height",
        ),
        Row(
            "Motor demand",
            show(m.motor_demand, ".2f"),
            "m g v / (peak torque x no-load speed)",
        ),
    )


def sprung(metrics: RunMetrics) -> bool:
    """Return whether the robot has springs: in a run each of them is compressed."""
    return metrics.peak_spring_travel > 0.0


def spring_rows(metrics: RunMetrics) -> tuple[Row, ...]:
    """What the springs did; nothing of a robot with rigid shanks."""
    m = metrics
    if not sprung(m):
        return ()
    return (
        Row(
            "Peak spring travel",
            f"{1e3 * m.peak_spring_travel:.0f} mm",
            "of the most compressed spring",
        ),
        Row(
            "Spring-stop hits",
            f"{m.stop_hits}",
            f"a spring is on its stop {m.on_stop:.1%} of the time",
        ),
    )


def motor_rows(metrics: RunMetrics) -> tuple[Row, ...]:
    """What was asked of the motors."""
    strongest = max(metrics.motors, key=lambda motor: motor.peak_torque)
    fastest = max(metrics.motors, key=lambda motor: motor.peak_speed)
    hardest = max(metrics.motors, key=lambda motor: motor.peak_power)
    return (
        Row("Peak torque", f"{strongest.peak_torque:.0f} Nm", strongest.name),
        Row("Peak joint speed", f"{fastest.peak_speed:.1f} rad/s", fastest.name),
        Row(
            "Peak motor power",
            f"{hardest.peak_power:.0f} W",
            f"{hardest.name}, driving",
        ),
        Row(
            "On the envelope",
            f"{metrics.on_envelope:.1%}",
            "motor samples within 1 % of a limit",
        ),
        Row(
            "Outside the envelope",
            f"{metrics.outside_envelope}",
            "samples at the start of each ms; must be 0",
        ),
    )


def account_rows(account: Account, sprung: bool) -> tuple[Row, ...]:
    """The bus, the ground and the stops over the steady window."""
    p, g = account.power, account.ground
    beyond = f"furthest at any time; {p.beyond_share:.1%} of samples by more than 1 Nm"
    tops = f"at {show(g.top_out_mean, '.1f', 'm/s')} in the mean; {g.hard_top_outs:.0f}/s above {HARD:g} m/s"
    landing = (
        f"down, and {show(g.landing_forward, '.1f', 'm/s')} along the ground, mean"
    )
    return (
        Row("Beyond the envelope", f"{p.beyond:.1f} Nm", beyond),
        Row(
            "Motors beyond no load",
            f"{p.overspeed_share:.1%}",
            "of their samples: there a drive can only brake",
        ),
        Row(
            "Peak power in a ms",
            f"{p.motor_peak:.0f} W",
            "of one motor, mechanical, mean of a ms",
        ),
        Row(
            "Bus power",
            f"{p.mean:.0f} W",
            f"mean; at most {p.peak:.0f} W, {p.burst:.0f} W over 50 ms",
        ),
        Row(
            "Recharging",
            f"{p.recharge:.0f} W",
            "at most, what a brake resistor burns included",
        ),
        Row(
            "Force plate",
            f"{g.plate_force:.0f} N",
            f"greatest vertical mean of a foot over {1e3 * PLATE:.0f} ms",
        ),
        Row("Foot depth", f"{1e3 * g.depth:.1f} mm", "in the ground, at most"),
        Row(
            "Slip",
            show(g.slip, ".2f", "m/s"),
            f"median in stance; 95 % below {show(g.slip_95, '.1f', 'm/s')}",
        ),
        Row("Contact breaks", show(g.breaks, ".1f"), "a stance, mean"),
        Row("Soles land at", show(g.landing_down, ".1f", "m/s"), landing),
        *((Row("Springs top out", f"{g.top_outs:.0f}/s", tops),) if sprung else ()),
        Row(
            "Beyond joint range",
            f"{g.limit_share:.1%}",
            f"of the time, by {g.limit_depth:.3f} rad at most",
        ),
    )


def energy_table(account: Account, sprung: bool) -> Table:
    """Where the bus's energy goes."""
    p = account.power
    shares = {**p.lost, "stored": p.stored, "integration": p.integration}
    lines = [
        (
            ENERGY[cause] if sprung else ENERGY[cause].removesuffix(", springs"),
            f"{watts:.0f}",
            f"{watts / p.mean:.1%}" if p.mean > 0.0 else NOT_MEASURED,
        )
        for cause, watts in shares.items()
        if sprung or cause not in OF_SPRINGS
    ]
    return Table(
        "Where the energy goes, steady window",
        ("Cause", "Power [W]", "Share of the bus"),
        lines,
    )


def leg_rows(metrics: RunMetrics) -> tuple[Row, ...]:
    """How legs kept clear of each other and of the trunk, solid or not."""
    m = metrics
    lasted, deep = f"{1e3 * m.leg_contact_time:.0f} ms", f"{1e3 * m.leg_depth:.0f} mm"
    return (
        Row(
            "Legs touch",
            f"{m.leg_contact:.1%}",
            f"of the time, {lasted}; {deep} deep at most",
        ),
        Row(
            "Room between legs",
            f"{1e3 * m.leg_clearance:.0f} mm",
            "least; below 0 they overlap",
        ),
        Row(
            "Room at the trunk",
            f"{1e3 * m.trunk_clearance:.0f} mm",
            "least, of a leg; below 0 they overlap",
        ),
    )


def run_tables(metrics: RunMetrics) -> tuple[Table, ...]:
    """Every motor and every leg."""
    motors = [
        (
            m.name,
            f"{m.peak_torque:.1f}",
            f"{m.peak_speed:.1f}",
            f"{m.peak_power:.0f}",
            f"{m.on_envelope:.1%}",
        )
        for m in metrics.motors
    ]
    legs = [
        (
            leg.name,
            f"{leg.duty_factor:.2f}",
            show(leg.stride_frequency, ".2f"),
            f"{leg.peak_foot_force:.0f}",
            f"{1e3 * leg.peak_spring_travel:.0f}",
            f"{leg.on_stop:.1%}",
            f"{leg.stop_hits}",
        )
        for leg in metrics.legs
    ]
    motor_head = (
        "Motor",
        "Peak torque [Nm]",
        "Peak speed [rad/s]",
        "Peak power [W]",
        "On the envelope",
    )
    leg_head = (
        "Leg",
        "Duty factor",
        "Stride frequency [Hz]",
        "Peak force [N]",
        "Peak spring travel [mm]",
        "On the stop",
        "Stop hits",
    )
    springs = sprung(metrics)
    if not springs:  # the springs' columns are the last three
        leg_head, legs = leg_head[:-3], [line[:-3] for line in legs]
    tables = Table("Motors", motor_head, motors), Table("Legs", leg_head, legs)
    return (
        (energy_table(metrics.account, springs), *tables) if metrics.account else tables
    )


def run_pictures(run: Trajectory) -> tuple[Picture, ...]:
    """Every figure of the run."""
    return tuple(
        Picture(name, caption, draw(run), draw(run, NARROW))
        for name, (draw, caption) in FIGURES.items()
    )


RESULTS = (
    "commanded_speed",
    "best_speed",
    "held_speed",
    "mean_speed",
    "slowest_held_speed",
    "hold_time",
    "fell_at",
    "tracking_error",
    "lateral_drift",
    "heading_drift",
    "trunk_height",
    "stride_frequency",
    "duty_factor",
    "off_half_cycle",
    "uneven",
    "peak_torque",
    "peak_joint_speed",
    "peak_motor_power",
    "on_envelope",
    "outside_envelope",
    "peak_foot_force",
    "peak_spring_travel",
    "on_stop",
    "stop_hits",
    "leg_contact",
    "leg_contact_time",
    "leg_depth",
    "leg_clearance",
    "trunk_clearance",
    "mechanical_cost_of_transport",
    "electrical_cost_of_transport",
    "electrical_power",
    "froude_number",
)
"""What a policy's card says of a run: fields and properties of `RunMetrics`."""


def run_results(metrics: RunMetrics, names: Sequence[str] = RESULTS) -> dict[str, Any]:
    """Return the results for a policy's card, rounded."""
    found = {name: getattr(metrics, name) for name in names}
    return rounded(
        found | (_account_results(metrics.account) if metrics.account else {})
    )


def _account_results(account: Account) -> dict[str, Any]:
    p, g = account.power, account.ground
    return {
        "beyond_envelope": p.beyond,
        "beyond_no_load_speed": p.overspeed_share,
        "bus_power": p.mean,
        "peak_bus_power": p.peak,
        "peak_recharging": p.recharge,
        "foot_depth": g.depth,
        "plate_force": g.plate_force,
        "slip": g.slip,
        "contact_breaks": g.breaks,
        "landing_speed_down": g.landing_down,
        "landing_speed_forward": g.landing_forward,
        "top_outs_per_second": g.top_outs,
        "hard_top_outs_per_second": g.hard_top_outs,
        "top_out_mean_speed": g.top_out_mean,
        "top_out_speed": g.top_out_speed,
        "beyond_joint_range": g.limit_share,
    }
