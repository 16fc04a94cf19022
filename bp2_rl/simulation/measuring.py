"""The figures of merit of a run, computed: pure functions of its samples."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from bp2_rl.robot import actuator, bp2, conventions
from bp2_rl.robot.building import standing
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.gait import (
    evenness,
    leg_metrics,
    leg_room,
    mean_stride_frequency,
    on_stop,
)
from bp2_rl.simulation.metrics import (
    HELD,
    NEAR_ENVELOPE,
    MotorMetrics,
    RunMetrics,
)
from bp2_rl.simulation.samples import (
    Samples,
    best_window,
    hold_phase,
    steady_window,
    window_means,
)
from bp2_rl.simulation.track import track_position

ROUNDING = 1e-6  # of peak torque: what float32 speeds move the limit by


def run_metrics(run: Samples) -> RunMetrics:
    """Compute all figures of merit of one run."""
    end = round(len(run) * run.dt, 6)
    hold, best, steady = hold_phase(run), best_window(run, 1.0), steady_window(run)
    speed = steady.ground_velocity[:, 0]
    envelope = envelope_use(run)
    mechanical, electrical = mean_powers(steady)
    travelled = float(np.sum(speed) * run.dt)
    # of a watt; None for a robot that goes nowhere
    cost = (
        len(steady) * run.dt / (run.mass * conventions.GRAVITY * travelled)
        if travelled > 0.1
        else None
    )
    motors, legs = motor_metrics(run, envelope), leg_metrics(run, steady)
    off_half_cycle, uneven = evenness(steady, legs)
    room = leg_room(run)
    touching = room.least <= 0.0
    held = None if hold is None else best_window(hold, HELD)
    return RunMetrics(
        name=run.name,
        backend=run.backend,
        duration=end,
        fell_at=run.fell_at,
        steady_from=float(steady.time[0]),
        steady_to=float(steady.time[-1]) + run.dt,
        hold_time=max(end - run.steady_from, 0.0),
        commanded_speed=float(run.command[-1, 0]),
        best_speed=None if best is None else best.speed,
        held_speed=None if held is None else held.speed,
        slowest_held_speed=None if hold is None else slowest_second(hold),
        mean_speed=float(np.mean(speed)),
        tracking_error=None if hold is None else tracking_error(hold),
        distance=float(np.linalg.norm(run.qpos[-1, :2] - run.qpos[0, :2])),
        lateral_drift=float(np.max(np.abs(track_position(run)[1]))),
        heading_drift=float(np.max(np.abs(run.heading - run.heading[0]))),
        trunk_height=float(np.mean(steady.qpos[:, 2])),
        mechanical_cost_of_transport=None if cost is None else mechanical * cost,
        electrical_cost_of_transport=None if cost is None else electrical * cost,
        mechanical_power=mechanical,
        electrical_power=electrical,
        froude_number=None
        if best is None
        else froude_number(best.speed, standing_height(run.hardware)),
        motor_demand=None if best is None else motor_demand(run, best.speed),
        peak_torque=max(motor.peak_torque for motor in motors),
        peak_joint_speed=max(motor.peak_speed for motor in motors),
        peak_motor_power=max(motor.peak_power for motor in motors),
        peak_foot_force=max(leg.peak_foot_force for leg in legs),
        peak_spring_travel=max(leg.peak_spring_travel for leg in legs),
        on_stop=float(np.mean(on_stop(run).any(axis=-1))),
        stop_hits=sum(leg.stop_hits for leg in legs),
        leg_contact=float(np.mean(touching)),
        leg_contact_time=round(float(np.sum(touching)) * run.dt, 6),
        leg_depth=max(-float(np.min(room.least)), 0.0),
        leg_clearance=float(np.min(room.legs)),
        trunk_clearance=float(np.min(room.trunk)),
        stride_frequency=mean_stride_frequency(legs),
        duty_factor=sum(leg.duty_factor for leg in legs) / len(legs),
        on_envelope=float(np.mean(envelope.near)),
        outside_envelope=int(np.sum(envelope.outside)),
        motors=motors,
        legs=legs,
        off_half_cycle=off_half_cycle,
        uneven=uneven,
    )


# --- Speed ----------------------------------------------------------------------------


def slowest_second(hold: Samples) -> float:
    """Return the lowest 1-s mean of the forward speed, m/s, of a phase of at least
    1 s."""
    return float(np.min(window_means(hold.ground_velocity[:, 0], round(1.0 / hold.dt))))


def tracking_error(hold: Samples) -> float:
    """Return the mean of |forward speed - commanded forward speed|, m/s; the speed's
    ripple within a stride counts."""
    return float(np.mean(np.abs(hold.ground_velocity[:, 0] - hold.command[:, 0])))


def froude_number(speed: float, height: float = bp2.STANDING_HEIGHT) -> float:
    """Return v^2 / (g h) with the height (m) of the trunk's centre in a stand: of BP2 21.4 at
    the paper's 10.74 m/s."""
    return speed**2 / (conventions.GRAVITY * height)


def standing_height(hardware: HardwareSpec) -> float:
    """Return the height of the trunk's centre in a stand, m: BP2's is published."""
    if not hardware.is_bp2:
        return float(standing(hardware.anatomy, hardware.spring_stiffness)[2])
    return bp2.STANDING_HEIGHT


def motor_demand(run: Samples, speed: float) -> float:
    """Return the `power_demand` of the robot that ran."""
    hardware = run.hardware
    power = float(np.mean(hardware.joint_peak_torque * hardware.joint_no_load_speed))
    return power_demand(run.mass, conventions.GRAVITY, speed, power, 1.0)


# --- Motors ---------------------------------------------------------------------------


class EnvelopeUse(NamedTuple):
    """Where the torques lie relative to the limits at their speeds."""

    near: Bool[np.ndarray, "N 12"]  # within NEAR_ENVELOPE of a limit, or outside
    outside: Bool[np.ndarray, "N 12"]  # beyond a limit by more than ROUNDING


def envelope_use(run: Samples, motors: actuator.Actuator | None = None) -> EnvelopeUse:
    """Compare every applied torque with the torque-speed envelope of its instant.

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


def mean_powers(run: Samples) -> tuple[float, float]:
    """Return the mean positive mechanical power of all motors, and the electrical power
    behind it, W.

    Electrical = positive mechanical + copper loss; braking returns nothing.
    """
    mechanical = np.maximum(run.torque * run.joint_velocity, 0.0)
    copper = actuator.winding_heat(
        actuator.Actuator.from_hardware(run.hardware), run.torque
    )
    positive = float(np.mean(np.sum(mechanical, axis=-1)))
    return positive, positive + float(np.mean(np.sum(copper, axis=-1)))


def motor_metrics(run: Samples, envelope: EnvelopeUse) -> tuple[MotorMetrics, ...]:
    """Return each motor's peaks and its share of time on the envelope."""
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
    """Return m g v / (tau_max omega_max), the power asked of the motors over what one can
    give (paper, Fig. 1, inset)."""
    return mass * gravity * speed / (peak_torque * no_load_speed)
