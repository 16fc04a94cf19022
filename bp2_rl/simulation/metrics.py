"""Figures of merit of a run: pure functions of a Trajectory, each with its definition.

The paper leaves most definitions open; the ones used here are stated in the docstrings
and repeated in the report.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from bp2_rl.robot import actuator, bp2, conventions
from bp2_rl.robot.building import standing
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.gait import (
    LegMetrics,
    evenness,
    leg_metrics,
    leg_room,
    mean_stride_frequency,
    on_stop,
)
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.windows import (
    best_window,
    hold_phase,
    steady_window,
    window_means,
)

HELD = 5.0  # s: a speed kept for so long is held
RIPPLE = 0.25  # s: a mean over so long takes out the speed's ripple within a stride
NEAR_ENVELOPE = 0.01  # of peak torque: closer to a limit counts as on the envelope
ROUNDING = 1e-6  # of peak torque: what float32 speeds move the limit by


@dataclasses.dataclass(frozen=True)
class MotorMetrics:
    """One motor's extremes over the whole run."""

    name: str
    peak_torque: float  # Nm
    peak_speed: float  # rad/s
    peak_power: float  # W, driving
    on_envelope: float  # share of time within NEAR_ENVELOPE of a torque limit


@dataclasses.dataclass(frozen=True)
class PowerMetrics:
    """The bus, and where its energy went, over the whole of a run or a part of it;
    W."""

    mean: float  # what flowed out, less what flowed back
    peak: float  # in any millisecond
    burst: float  # greatest mean over 50 ms
    second: float | None  # greatest mean over a second; None in a shorter run
    recharge: float  # greatest flow back in any millisecond, as a positive number
    motor_peak: float  # of one motor, mechanical, mean of a millisecond
    # Nm, furthest that any torque was outside the envelope at either end of a
    # millisecond; 0: never
    beyond: float
    beyond_share: float  # of motor samples, by more than 1 Nm
    # of motor samples beyond the no-load speed, where a drive can only brake
    overspeed_share: float
    lost: dict[str, float]  # mean, by cause: see `account.CAUSES`
    stored: float  # mean, in motion, height and springs
    integration: float  # mean, what steps of a millisecond lose or gain by themselves
    # greatest error of the balance in any millisecond, over the greatest term
    closure: float


@dataclasses.dataclass(frozen=True)
class GroundMetrics:
    """What happens under the feet, and at the ends of the springs' and the joints'
    travel."""

    depth: float  # m, deepest that a foot was in the ground
    slip: float | None  # m/s, median of soles in stance; None without a stance
    slip_95: float | None  # m/s, which 95 % of the time is not exceeded
    slip_distance: float | None  # m a stance, mean
    breaks: float | None  # losses of contact within a stance, mean
    # N, greatest vertical mean of a foot over `account.PLATE`: what a force plate shows
    plate_force: float
    landing_down: float | None  # m/s, mean of soles just before they touch
    landing_forward: float | None  # m/s, of soles that land, mean
    # times a second that a spring, all together, comes onto its rebound stop
    top_outs: float
    hard_top_outs: float  # times a second that it does so faster than `account.HARD`
    top_out_mean: float | None  # m/s, mean speed at which it does; None: it never does
    top_out_speed: float  # m/s, greatest
    limit_share: float  # share of time with any joint beyond its range
    limit_depth: float  # rad, furthest


@dataclasses.dataclass(frozen=True)
class Account:
    """What `account` finds: both of the steady window."""

    power: PowerMetrics
    ground: GroundMetrics


@dataclasses.dataclass(frozen=True)
class RunMetrics:
    """Everything the table shows and metrics.json holds.

    The steady window is the schedule's hold phase; for a run that saw less than a
    second of it, the best second (the whole run, if that is shorter still).
    """

    name: str
    backend: str
    duration: float  # s, to the end or the fall
    fell_at: float | None  # s
    steady_from: float  # s
    steady_to: float  # s
    hold_time: float  # s of the hold phase run without a fall
    commanded_speed: float  # m/s, forward, at the end
    best_speed: float | None  # m/s, best 1-s mean; None for a run shorter than 1 s
    # m/s, best 5-s mean of the hold phase; None where that is shorter
    held_speed: float | None
    # m/s, slowest 1-s mean of the hold phase; None unless that lasted 1 s
    slowest_held_speed: float | None
    mean_speed: float  # m/s, over the steady window
    # m/s, mean of |forward speed - command| over the hold phase
    tracking_error: float | None
    distance: float  # m, straight from start to end
    lateral_drift: float  # m, greatest distance from the line it set out on
    heading_drift: float  # rad, greatest deviation from the heading it set out on
    trunk_height: float  # m, of the trunk's centre over the steady window
    # positive mechanical work / (m g distance), steady window
    mechanical_cost_of_transport: float | None
    # with copper losses, no credit for braking
    electrical_cost_of_transport: float | None
    mechanical_power: float  # W, mean positive, steady window
    electrical_power: float  # W, mean, with copper losses
    froude_number: float | None  # best_speed^2 / (g h), h = standing height
    motor_demand: float | None  # m g best_speed / (tau_max omega_max)
    peak_foot_force: float  # N, of the hardest foot
    peak_spring_travel: float  # m, of the most compressed spring
    on_stop: float  # share of time with any spring on its stop
    stop_hits: int  # times that a spring came onto its stop, all springs together
    # share of time with a leg at or in another leg or the trunk, whether legs are solid
    # or not
    leg_contact: float
    leg_contact_time: float  # s, in all
    leg_depth: float  # m, greatest, of a leg in another leg or the trunk
    leg_clearance: float  # m, least, between legs; below 0 they overlap
    trunk_clearance: float  # m, least between legs and trunk
    on_envelope: float  # share of all motors' samples
    outside_envelope: int  # samples of any motor outside its limits: must be 0
    motors: tuple[MotorMetrics, ...]
    legs: tuple[LegMetrics, ...]
    account: Account | None = None  # where it was asked for
    # cycles, of left legs from half a cycle after right ones; None: no stride
    off_half_cycle: float | None = None
    # share of the vertical impulse that one side has more than the other
    uneven: float | None = None

    @property
    def stride_frequency(self) -> float | None:
        """Hz, mean of the legs that made a stride; None where none did."""
        return mean_stride_frequency(self.legs)

    @property
    def duty_factor(self) -> float:
        """Stance over stride, mean of the legs."""
        return sum(leg.duty_factor for leg in self.legs) / len(self.legs)

    @property
    def peak_torque(self) -> float:
        """Nm, of the motor with the greatest."""
        return max(motor.peak_torque for motor in self.motors)

    @property
    def peak_joint_speed(self) -> float:
        """Speed of the fastest joint, rad/s."""
        return max(motor.peak_speed for motor in self.motors)

    @property
    def peak_motor_power(self) -> float:
        """Greatest driving power of any motor, W."""
        return max(motor.peak_power for motor in self.motors)


def measure(run: Trajectory) -> RunMetrics:
    """All figures of merit of one run."""
    end = round(len(run) * run.dt, 6)
    hold = hold_phase(run)
    best = best_window(run, 1.0)
    steady = steady_window(run)
    envelope = envelope_use(run)
    mechanical, electrical = mean_powers(steady)
    weight = run.mass * conventions.GRAVITY
    travelled = float(np.sum(steady.ground_velocity[:, 0]) * run.dt)
    joules_per_watt = (
        len(steady) * run.dt / (weight * travelled) if travelled > 0.1 else None
    )
    legs = leg_metrics(run, steady)
    off_half_cycle, uneven = evenness(steady, legs)
    room = leg_room(run)
    touching = room.least <= 0.0
    return RunMetrics(
        name=run.name,
        backend=run.backend,
        duration=end,
        fell_at=run.fell_at,
        steady_from=float(steady.time[0]),
        steady_to=float(steady.time[-1]) + run.dt,
        hold_time=max(end - run.steady_from, 0.0),
        commanded_speed=float(run.command[-1, 0]),
        best_speed=best.speed if best is not None else None,
        held_speed=held_speed(hold) if hold is not None else None,
        slowest_held_speed=slowest_second(hold) if hold is not None else None,
        mean_speed=float(np.mean(steady.ground_velocity[:, 0])),
        tracking_error=tracking_error(hold) if hold is not None else None,
        distance=float(np.linalg.norm(run.qpos[-1, :2] - run.qpos[0, :2])),
        lateral_drift=lateral_drift(run),
        heading_drift=float(np.max(np.abs(run.heading - run.heading[0]))),
        trunk_height=float(np.mean(steady.qpos[:, 2])),
        mechanical_cost_of_transport=mechanical * joules_per_watt
        if joules_per_watt is not None
        else None,
        electrical_cost_of_transport=electrical * joules_per_watt
        if joules_per_watt is not None
        else None,
        mechanical_power=mechanical,
        electrical_power=electrical,
        froude_number=froude_number(best.speed, standing_height(run.hardware))
        if best is not None
        else None,
        motor_demand=motor_demand(run, best.speed) if best is not None else None,
        peak_foot_force=max(leg.peak_foot_force for leg in legs),
        peak_spring_travel=max(leg.peak_spring_travel for leg in legs),
        on_stop=float(np.mean(on_stop(run).any(axis=-1))),
        stop_hits=sum(leg.stop_hits for leg in legs),
        leg_contact=float(np.mean(touching)),
        leg_contact_time=round(float(np.sum(touching)) * run.dt, 6),
        leg_depth=max(-float(np.min(room.least)), 0.0),
        leg_clearance=float(np.min(room.legs)),
        trunk_clearance=float(np.min(room.trunk)),
        on_envelope=float(np.mean(envelope.near)),
        outside_envelope=int(np.sum(envelope.outside)),
        motors=motor_metrics(run, envelope),
        legs=legs,
        off_half_cycle=off_half_cycle,
        uneven=uneven,
    )


# --- Speed ----------------------------------------------------------------------------


def held_speed(hold: Trajectory) -> float | None:
    """The best mean forward speed over `HELD` seconds of a hold phase, m/s; None where
    it is shorter."""
    best = best_window(hold, HELD)
    return best.speed if best is not None else None


def slowest_second(hold: Trajectory) -> float:
    """The lowest 1-s mean of the forward speed, m/s, of a phase of at least 1 s."""
    return float(np.min(window_means(hold.ground_velocity[:, 0], round(1.0 / hold.dt))))


def tracking_error(hold: Trajectory) -> float:
    """Mean of |forward speed - commanded forward speed|, m/s; the speed's ripple within
    a stride counts."""
    return float(np.mean(np.abs(hold.ground_velocity[:, 0] - hold.command[:, 0])))


def lateral_drift(run: Trajectory) -> float:
    """Greatest distance of the trunk from the straight line through its start along its
    first heading, m."""
    yaw = run.heading[0]
    offset = run.qpos[:, :2] - run.qpos[0, :2]
    return float(
        np.max(np.abs(np.cos(yaw) * offset[:, 1] - np.sin(yaw) * offset[:, 0]))
    )


def froude_number(speed: float, height: float = bp2.STANDING_HEIGHT) -> float:
    """v^2 / (g h) with the height (m) of the trunk's centre in a stand: of BP2 21.4 at
    the paper's 10.74 m/s."""
    return speed**2 / (conventions.GRAVITY * height)


def standing_height(hardware: HardwareSpec) -> float:
    """Return the height of the trunk's centre in a stand, m: BP2's is published."""
    if not hardware.is_bp2:
        return float(standing(hardware.anatomy, hardware.spring_stiffness)[2])
    return bp2.STANDING_HEIGHT


def motor_demand(run: Trajectory, speed: float) -> float:
    """The `power_demand` of the robot that ran."""
    hardware = run.hardware
    power = float(np.mean(hardware.joint_peak_torque * hardware.joint_no_load_speed))
    return power_demand(run.mass, conventions.GRAVITY, speed, power, 1.0)


# --- Motors ---------------------------------------------------------------------------


class EnvelopeUse(NamedTuple):
    """Where the torques lie relative to the limits at their speeds."""

    near: Bool[np.ndarray, "N 12"]  # within NEAR_ENVELOPE of a limit, or outside
    outside: Bool[np.ndarray, "N 12"]  # beyond a limit by more than ROUNDING


def envelope_use(
    run: Trajectory, motors: actuator.Actuator | None = None
) -> EnvelopeUse:
    """Compare every applied torque with the torque-speed envelope at the same instant.

    `motors` are those of each sample where they changed with time.
    """
    motors, qd = (
        motors or actuator.Actuator.from_hardware(run.hardware),
        run.joint_velocity,
    )
    before = np.concatenate([run.torque[:1], run.torque[:-1]])
    low, high = actuator.torque_limits(
        motors, qd, actuator.bus_voltage(motors, before, qd)
    )
    margin = np.minimum(high - run.torque, run.torque - low)
    peak = run.hardware.joint_peak_torque
    return EnvelopeUse(
        near=margin <= NEAR_ENVELOPE * peak, outside=margin < -ROUNDING * peak
    )


def mean_powers(run: Trajectory) -> tuple[float, float]:
    """Mean positive mechanical power of all motors, and the electrical power behind it,
    W.

    Electrical = positive mechanical + copper loss; braking returns nothing.
    """
    mechanical = np.maximum(run.torque * run.joint_velocity, 0.0)
    copper = actuator.winding_heat(
        actuator.Actuator.from_hardware(run.hardware), run.torque
    )
    positive = float(np.mean(np.sum(mechanical, axis=-1)))
    return positive, positive + float(np.mean(np.sum(copper, axis=-1)))


def motor_metrics(run: Trajectory, envelope: EnvelopeUse) -> tuple[MotorMetrics, ...]:
    """Each motor's peaks and its share of time on the envelope."""
    torque = np.max(np.abs(run.torque), axis=0)
    speed = np.max(np.abs(run.joint_velocity), axis=0)
    power = np.maximum(np.max(run.torque * run.joint_velocity, axis=0), 0.0)
    near = np.mean(envelope.near, axis=0)
    return tuple(
        MotorMetrics(
            name, float(torque[i]), float(speed[i]), float(power[i]), float(near[i])
        )
        for i, name in enumerate(conventions.MOTOR_NAMES)
    )


def power_demand(
    mass: float, gravity: float, speed: float, peak_torque: float, no_load_speed: float
) -> float:
    """m g v / (tau_max omega_max): what is asked of the motors over what one can give
    (paper, Fig. 1, inset)."""
    return mass * gravity * speed / (peak_torque * no_load_speed)
