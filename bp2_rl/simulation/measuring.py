"""Compute the figures of merit of a run from its samples, and how much of a lane the
robot used."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.base.metric import metric
from bp2_rl.robot import actuator, bp2, conventions
from bp2_rl.robot.building import standing
from bp2_rl.robot.ground import over_ground
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import foot_position
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
from bp2_rl.simulation.trajectory import (
    Trajectory,
    best_window,
    hold_phase,
    steady_window,
    window_means,
)
from bp2_rl.simulation.world import World

LANE_WIDTH = 1.22  # m, of a running track (World Athletics, Technical Rule 14.4)
ROUNDING = 1e-6  # of peak torque: what float32 speeds move the limit by


def run_metrics(run: Trajectory) -> RunMetrics:
    """Compute all figures of merit of a run."""
    end = round(len(run) * run.dt, 6)
    hold = hold_phase(run)
    best = best_window(run, 1.0)
    steady = steady_window(run)
    speed = steady.ground_velocity[:, 0]
    ground = World(terrain=run.terrain).ground
    envelope = envelope_use(run)
    mechanical, electrical = mean_powers(steady)
    travelled = float(np.sum(speed) * run.dt)
    # cost of transport per watt of mean power; None for a robot that does not move
    cost = (
        len(steady) * run.dt / (run.mass * conventions.GRAVITY * travelled)
        if travelled > 0.1
        else None
    )
    motors, legs = motor_metrics(run, envelope), leg_metrics(run, steady)
    off_half_cycle, uneven = evenness(steady, legs)
    room = leg_room(run)
    touching = room.least <= 0.0
    held = None
    slowest = None
    error = None
    if hold is not None:
        held = best_window(hold, HELD)
        forward = hold.ground_velocity[:, 0]
        slowest = float(np.min(window_means(forward, round(1.0 / run.dt))))
        # the speed's ripple within a stride counts
        error = float(np.mean(np.abs(forward - hold.command[:, 0])))
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
        slowest_held_speed=slowest,
        mean_speed=float(np.mean(speed)),
        tracking_error=error,
        distance=float(np.linalg.norm(run.qpos[-1, :2] - run.qpos[0, :2])),
        lateral_drift=lateral_drift(run),
        heading_drift=float(np.max(np.abs(run.heading - run.heading[0]))),
        trunk_height=float(np.mean(over_ground(steady.qpos, ground)[:, 2])),
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


def froude_number(speed: float, height: float = bp2.STANDING_HEIGHT) -> float:
    """Return the Froude number v^2 / (g h), h (m) the trunk's height in a stand: 21.4
    for BP2 at the paper's 10.74 m/s."""
    return speed**2 / (conventions.GRAVITY * height)


def standing_height(hardware: HardwareSpec) -> float:
    """Return the height of the trunk's centre in a stand, m: BP2's published one, else
    computed."""
    if not hardware.is_bp2:
        return float(standing(hardware.anatomy, hardware.spring_stiffness)[2])
    return bp2.STANDING_HEIGHT


def motor_demand(run: Trajectory, speed: float) -> float:
    """Return the `power_demand` of the run's robot at a speed (m/s)."""
    hardware = run.hardware
    power = float(np.mean(hardware.joint_peak_torque * hardware.joint_no_load_speed))
    return power_demand(run.mass, conventions.GRAVITY, speed, power)


# --- Motors ---------------------------------------------------------------------------


class EnvelopeUse(NamedTuple):
    """Flags for each sample and motor: torque near a limit of the envelope, or
    outside."""

    near: Bool[np.ndarray, "N 12"]  # within NEAR_ENVELOPE of a limit, or outside
    outside: Bool[np.ndarray, "N 12"]  # beyond a limit by more than ROUNDING


def envelope_use(
    run: Trajectory, motors: actuator.Actuator | None = None
) -> EnvelopeUse:
    """Return for every sample and motor whether the torque is near the torque-speed
    envelope, or outside.

    `motors` has an entry for each sample if the motors changed with time.
    """
    motors = motors or actuator.Actuator.from_hardware(run.hardware)
    qd = run.joint_velocity
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


def motor_metrics(run: Trajectory, envelope: EnvelopeUse) -> tuple[MotorMetrics, ...]:
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


def power_demand(mass: float, gravity: float, speed: float, envelope: float) -> float:
    """Return m g v / (tau_max omega_max), the demanded power over the power of one
    motor (paper, Fig. 1, inset); `envelope`: a motor's peak torque x no-load speed, W."""
    return mass * gravity * speed / envelope


# --- Track ---


@dataclasses.dataclass(frozen=True)
class Lane:
    """The part of a lane's width that a run used; its centre line goes through the
    start along the first heading."""

    trunk_offset: float = metric(
        "Trunk off the line", "m", meaning="greatest, of its centre"
    )
    # of the trunk's corners: BP2's is 0.44 m wide, 0.80 m long, at its heading
    trunk_reach: float = metric(
        "Trunk's side", "m", meaning="greatest distance from the line", card=True
    )
    foot_reach: float = metric(
        "Feet's outer edge", "m", meaning="greatest distance from the line", card=True
    )
    used: float = metric(
        "Lane used",
        form=".0%",
        meaning=f"of \u00b1{LANE_WIDTH / 2:.2f} m, by trunk and feet",
    )
    # all of it stayed within half a lane's width to either side
    kept: bool = metric("Lane kept", card="lane_kept", shown=False)


def track_position(
    run: Trajectory,
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return how far the trunk's centre is along the lane's centre line, and to its
    left, m.

    The line goes through the start along the first heading.
    """
    along, left = _on_track(run, run.qpos[:, None, :2])
    return along[:, 0], left[:, 0]


def lateral_drift(run: Trajectory) -> float:
    """Return the greatest distance of the trunk's centre from the track's middle line,
    m."""
    return float(np.max(np.abs(track_position(run)[1])))


def time_at(run: Trajectory, distance: float) -> float | None:
    """Return the time at which the trunk's centre first was `distance` (m) ahead, s.

    The time is interpolated between samples; None if the robot never arrived.
    """
    along = track_position(run)[0]
    arrival = int(np.argmax(along >= distance))
    if along[arrival] < distance:
        return None
    before = max(arrival - 1, 0)
    return float(
        np.interp(distance, along[[before, arrival]], run.time[[before, arrival]])
    )


def measure_lane(run: Trajectory) -> Lane:
    """Measure how far trunk and feet came from the lane's centre line, and the share of
    the lane used."""
    trunk, feet = (
        float(np.max(np.abs(edges))) for edges in (trunk_edges(run), foot_edges(run))
    )
    used = max(trunk, feet) / (LANE_WIDTH / 2)
    return Lane(lateral_drift(run), trunk, feet, used, kept=used <= 1.0)


def trunk_edges(run: Trajectory) -> Float[np.ndarray, "N 2"]:
    """Return the trunk's rightmost and leftmost corners, m to the left of the lane's
    centre line."""
    turned = run.heading - run.heading[0]
    half_length, half_width = run.hardware.anatomy.footprint
    half = half_width * np.abs(np.cos(turned)) + half_length * np.abs(np.sin(turned))
    return track_position(run)[1][:, None] + half[:, None] * np.array([-1.0, 1.0])


def foot_edges(run: Trajectory) -> Float[np.ndarray, "N 2"]:
    """Return the rightmost and leftmost edges of the feet, m to the left of the lane's
    centre line."""
    left = _on_track(run, foot_centres(run)[:, :, :2])[1]
    radius = run.hardware.anatomy.geometry.foot_radius
    return np.stack(
        [np.min(left - radius, axis=1), np.max(left + radius, axis=1)], axis=-1
    )


def foot_centres(run: Trajectory) -> Float[np.ndarray, "N 4 3"]:
    """Return the centres of the feet's spheres in the world, m.

    A centre is a radius above the sole, up the lower leg.
    """
    joints = run.joint_position.reshape(-1, 4, 3)
    feet = foot_position(
        joints,
        run.spring_compression + run.hardware.anatomy.geometry.foot_radius,
        run.hardware,
    )
    w, v = run.qpos[:, None, 3:4], run.qpos[:, None, 4:7]
    turn = 2.0 * np.cross(v, feet)
    return run.qpos[:, None, :3] + feet + w * turn + np.cross(v, turn)


def _on_track(
    run: Trajectory, points: Float[np.ndarray, "N n 2"]
) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, "N n"]]:
    """Return the coordinates of points along the lane's centre line and to its left,
    m."""
    x, y = np.moveaxis(points - run.qpos[0, :2], -1, 0)
    cos, sin = np.cos(run.heading[0]), np.sin(run.heading[0])
    return cos * x + sin * y, cos * y - sin * x
