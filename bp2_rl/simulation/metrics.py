"""The figures of merit of a run: each one's name, unit, format and meaning.

The paper leaves most definitions open; reports print the definitions used here.
`simulation.measuring` and `simulation.account` compute them.
"""

import dataclasses

from bp2_rl.base.metric import metric, show, show_fall

HELD = 5.0  # s: a speed kept for so long is held
RIPPLE = 0.25  # s: a mean over so long takes out the speed's ripple within a stride
NEAR_ENVELOPE = 0.01  # of peak torque: closer to a limit counts as on the envelope
PLATE = 0.005  # s, over which a force plate averages: it follows some 100 Hz
HARD = 5.0  # m/s, above which a spring that tops out does so hard
BURST = 0.05  # s, over which a battery's burst is averaged


@dataclasses.dataclass(frozen=True)
class MotorMetrics:
    """One motor's extremes over the whole run."""

    name: str = metric("Motor", form="s")
    peak_torque: float = metric("Peak torque", "Nm", ".1f")
    peak_speed: float = metric("Peak speed", "rad/s", ".1f")
    peak_power: float = metric("Peak power", "W", ".0f", "driving")
    # share of time within NEAR_ENVELOPE of a torque limit
    on_envelope: float = metric("On the envelope", form=".1%")


def _is_sprung(measured: "LegMetrics | RunMetrics") -> bool:
    """Return whether the robot has springs, which every run compresses."""
    return measured.peak_spring_travel > 0.0


@dataclasses.dataclass(frozen=True)
class LegMetrics:
    """One leg: gait over the steady window, extremes over the whole run."""

    name: str = metric("Leg", form="s")
    duty_factor: float = metric("Duty factor", meaning="stance over stride")
    # None with fewer than two touchdowns
    stride_frequency: float | None = metric("Stride frequency", "Hz")
    peak_foot_force: float = metric("Peak force", "N", ".0f")
    peak_spring_travel: float = metric(
        "Peak spring travel", "mm", ".0f", shown=_is_sprung
    )
    # share of time with the spring on its stop
    on_stop: float = metric("On the stop", form=".1%", shown=_is_sprung)
    stop_hits: int = metric("Stop hits", form="d", shown=_is_sprung)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PowerMetrics:
    """The power drawn from the bus over a run, and the losses that consumed the energy,
    W."""

    # at either end of a millisecond; 0: never
    beyond: float = metric(
        "Beyond the envelope",
        "Nm",
        ".1f",
        "furthest at any time; {m.beyond_share:.1%} of samples by more than 1 Nm",
        card="beyond_envelope",
    )
    beyond_share: float
    overspeed_share: float = metric(
        "Motors beyond no load",
        form=".1%",
        meaning="of their samples: there a drive can only brake",
        card="beyond_no_load_speed",
    )
    motor_peak: float = metric(
        "Peak power in a ms", "W", ".0f", "of one motor, mechanical, mean of a ms"
    )
    # what flowed out, less what flowed back
    mean: float = metric(
        "Bus power",
        "W",
        ".0f",
        f"mean; at most {{m.peak:.0f}} W, {{m.burst:.0f}} W over {1e3 * BURST:.0f} ms",
        card="bus_power",
    )
    # in any millisecond
    peak: float = metric(
        "Peak bus power", "W", ".0f", card="peak_bus_power", shown=False
    )
    burst: float  # greatest mean over BURST
    second: float | None  # greatest mean over a second; None in a shorter run
    # in any millisecond, as a positive number
    recharge: float = metric(
        "Recharging",
        "W",
        ".0f",
        "at most, what a brake resistor burns included",
        card="peak_recharging",
    )
    lost: dict[str, float]  # mean, by cause, as a `Ledger` has them
    stored: float  # mean, in motion, height and springs
    integration: float  # mean, what steps of a millisecond lose or gain by themselves
    # greatest error of the balance in any millisecond, over the greatest term
    closure: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundMetrics:
    """The measurements of contact: of feet with the ground, of springs and joints with
    their stops."""

    plate_force: float = metric(
        "Force plate",
        "N",
        ".0f",
        f"greatest vertical mean of a foot over {1e3 * PLATE:.0f} ms",
        card=True,
    )
    depth: float = metric(
        "Foot depth", "mm", ".1f", "in the ground, at most", card="foot_depth"
    )
    # of soles in stance; None without a stance
    slip: float | None = metric(
        "Slip",
        "m/s",
        meaning=lambda m: (
            f"median in stance; 95 % below {show(m.slip_95, '.1f', 'm/s')}"
        ),
        card=True,
    )
    slip_95: float | None
    slip_distance: float | None  # m a stance, mean
    # losses of contact
    breaks: float | None = metric(
        "Contact breaks", form=".1f", meaning="a stance, mean", card="contact_breaks"
    )
    # of soles just before they touch
    landing_down: float | None = metric(
        "Soles land at",
        "m/s",
        ".1f",
        lambda m: (
            f"down, and {show(m.landing_forward, '.1f', 'm/s')} along the ground, mean"
        ),
        card="landing_speed_down",
    )
    landing_forward: float | None = metric(
        "Soles land along the ground at",
        "m/s",
        ".1f",
        card="landing_speed_forward",
        shown=False,
    )
    # times that a spring, all together, comes onto its rebound stop; None: no springs
    top_outs: float | None = metric(
        "Springs top out",
        "/s",
        form=lambda tops: f"{tops:.0f}/s",
        meaning=lambda m: (
            f"at {show(m.top_out_mean, '.1f', 'm/s')} in the mean; "
            f"{m.hard_top_outs:.0f}/s above {HARD:g} m/s"
        ),
        card="top_outs_per_second",
        shown=lambda m: m.top_outs is not None,
    )
    hard_top_outs: float = metric(
        f"Springs top out above {HARD:g} m/s",
        "/s",
        card="hard_top_outs_per_second",
        shown=False,
    )
    # speed at which a spring does; None: it never does
    top_out_mean: float | None = metric(
        "Mean speed onto the rebound stop",
        "m/s",
        card="top_out_mean_speed",
        shown=False,
    )
    top_out_speed: float = metric(
        "Greatest speed onto the rebound stop", "m/s", card=True, shown=False
    )
    # share of time with any joint beyond its range
    limit_share: float = metric(
        "Beyond joint range",
        form=".1%",
        meaning="of the time, by {m.limit_depth:.3f} rad at most",
        card="beyond_joint_range",
    )
    limit_depth: float


@dataclasses.dataclass(frozen=True)
class Account:
    """The power balance and the ground contact of a run over its steady window."""

    power: PowerMetrics
    ground: GroundMetrics


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunMetrics:
    """All figures of merit of a run, as the table and metrics.json show them.

    The steady window is the schedule's hold phase; for a run that saw less than a
    second of it, the best second (the whole run, if that is shorter still).
    """

    name: str
    backend: str
    duration: float  # s, to the end or the fall
    steady_from: float  # s
    steady_to: float  # s
    # None for a run shorter than 1 s
    best_speed: float | None = metric(
        "Best speed", "m/s", meaning="best 1-s mean of forward speed", card=True
    )
    # None where the hold is shorter
    held_speed: float | None = metric(
        f"Best {HELD:g} s",
        "m/s",
        meaning=f"best {HELD:g}-s mean of the hold",
        card=True,
    )
    commanded_speed: float = metric(
        "Commanded speed", "m/s", meaning="at the end", card=True
    )
    mean_speed: float = metric(
        "Mean speed",
        "m/s",
        meaning="steady window, {m.steady_from:.1f} to {m.steady_to:.1f} s",
        card=True,
    )
    # None unless the hold lasted 1 s, as the tracking error
    slowest_held_speed: float | None = metric(
        "Slowest second", "m/s", meaning="lowest 1-s mean while held", card=True
    )
    tracking_error: float | None = metric(
        "Tracking error", "m/s", meaning="mean |speed - command| while held", card=True
    )
    fell_at: float | None = metric(
        "Fall", "s", show_fall, "in {m.duration:.1f} s", card=True
    )
    hold_time: float = metric(
        "Time held", "s", ".1f", "at the final command", card=True
    )
    distance: float = metric("Distance", "m", ".1f", "straight from start to end")
    lateral_drift: float = metric(
        "Lateral drift",
        "m",
        meaning="greatest, from the first heading's line",
        card=True,
    )
    heading_drift: float = metric(
        "Heading drift", "rad", meaning="greatest, from the first heading", card=True
    )
    peak_torque: float = metric(
        "Peak torque",
        "Nm",
        ".0f",
        lambda m: m.motor_with_most("peak_torque"),
        card=True,
    )
    peak_joint_speed: float = metric(
        "Peak joint speed",
        "rad/s",
        ".1f",
        lambda m: m.motor_with_most("peak_speed"),
        card=True,
    )
    peak_motor_power: float = metric(
        "Peak motor power",
        "W",
        ".0f",
        lambda m: f"{m.motor_with_most('peak_power')}, driving",
        card=True,
    )
    # share of all motors' samples
    on_envelope: float = metric(
        "On the envelope",
        form=".1%",
        meaning=f"motor samples within {100 * NEAR_ENVELOPE:g} % of a limit",
        card=True,
    )
    # samples of any motor
    outside_envelope: int = metric(
        "Outside the envelope",
        form="d",
        meaning="samples at the start of each ms; must be 0",
        card=True,
    )
    # of the hardest foot
    peak_foot_force: float = metric(
        "Peak foot force", "N", ".0f", "impacts included", card=True
    )
    peak_spring_travel: float = metric(
        "Peak spring travel",
        "mm",
        ".0f",
        "of the most compressed spring",
        card=True,
        shown=_is_sprung,
    )
    # times that a spring came onto its stop, all springs together
    stop_hits: int = metric(
        "Spring-stop hits",
        form="d",
        meaning="a spring is on its stop {m.on_stop:.1%} of the time",
        card=True,
        shown=_is_sprung,
    )
    on_stop: float = metric(
        "Time on a spring's stop", form=".1%", card=True, shown=False
    )
    # with a leg at or in another leg or the trunk, whether legs are solid or not
    leg_contact: float = metric(
        "Legs touch",
        form=".1%",
        meaning=lambda m: (
            f"of the time, {1e3 * m.leg_contact_time:.0f} ms; "
            f"{1e3 * m.leg_depth:.0f} mm deep at most"
        ),
        card=True,
    )
    leg_contact_time: float = metric("Legs touch", "ms", ".0f", card=True, shown=False)
    # of a leg in another leg or the trunk
    leg_depth: float = metric("Depth", "mm", ".0f", card=True, shown=False)
    leg_clearance: float = metric(
        "Room between legs", "mm", ".0f", "least; below 0 they overlap", card=True
    )
    trunk_clearance: float = metric(
        "Room at the trunk",
        "mm",
        ".0f",
        "least, of a leg; below 0 they overlap",
        card=True,
    )
    # of the legs that made a stride; None where none did
    stride_frequency: float | None = metric(
        "Stride frequency", "Hz", meaning="mean of legs, steady window", card=True
    )
    duty_factor: float = metric(
        "Duty factor", meaning="mean of legs, steady window", card=True
    )
    # of left legs after right ones; None: no stride
    off_half_cycle: float | None = metric(
        "Off half a cycle",
        form=".3f",
        meaning="cycles, left to right, centroids of force",
        card=True,
        default=None,
    )
    # share of the vertical impulse that one side has more than the other
    uneven: float | None = metric(
        "Left and right",
        form=".1%",
        meaning="one side has more of the impulse",
        card=True,
        default=None,
    )
    # of the trunk's centre
    trunk_height: float = metric(
        "Trunk height", "m", ".3f", "mean, steady window", card=True
    )
    mechanical_cost_of_transport: float | None = metric(
        "Mechanical cost", meaning="positive motor work / (m g distance)", card=True
    )
    # no credit for braking
    electrical_cost_of_transport: float | None = metric(
        "Electrical cost", meaning="with copper heat / (m g distance)", card=True
    )
    mechanical_power: float = metric(
        "Mechanical power", "W", ".0f", "positive, mean, steady window"
    )
    electrical_power: float = metric(
        "Electrical power",
        "W",
        ".0f",
        "mean, with copper heat, steady window",
        card=True,
    )
    account: Account | None = None  # where it was asked for
    froude_number: float | None = metric(
        "Froude number",
        form=".1f",
        meaning="v\u00b2 / (g h) at top speed, h: standing height",
        card=True,
    )
    motor_demand: float | None = metric(
        "Motor demand", meaning="m g v / (peak torque x no-load speed)"
    )
    motors: tuple[MotorMetrics, ...]
    legs: tuple[LegMetrics, ...]

    def motor_with_most(self, quality: str) -> str:
        """Return the name of the motor with the greatest `quality`, a field of
        `MotorMetrics`."""
        return max(self.motors, key=lambda motor: getattr(motor, quality)).name
