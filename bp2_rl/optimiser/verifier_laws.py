"""Motor and loss laws of the independent verifier: gears, friction, air drag, bus power
and torque envelope. They are written in NumPy from `HardwareSpec` alone and share no
code with `sagittal`, `collocation` and the simulation.

Speeds qd (rad/s) and motor torques tau (Nm, before the gear's loss) are of the joints
with a motor, the last axis; `share` is the share of the robot that the model is.
"""

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.problem import GEAR_ROUNDING, JOINT_ROUNDING, SLIDE_ROUNDING
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import AtJoints, HardwareSpec, at_joints

Motors = Float[np.ndarray, "... motors"]
Each = Float[np.ndarray, "..."]


def joint_torque(hardware: HardwareSpec, qd: Motors, tau: Motors) -> Motors:
    """Return the torque that reaches the joints, Nm: the motors' torque less gear loss,
    dry and viscous friction."""
    losses, size = hardware.losses, hardware.size
    in_gear = (
        tau
        * (1.0 - losses.gear_efficiency)
        * _smooth_sign(tau, GEAR_ROUNDING * size.torque)
    )
    dry = at_motors(at_joints(losses.joint_friction), tau.shape[-1])
    friction = (in_gear + dry) * _smooth_sign(qd, JOINT_ROUNDING * size.rate)
    return (
        tau
        - friction
        - at_motors(at_joints(losses.joint_viscosity), tau.shape[-1]) * qd
    )


def drag(hardware: HardwareSpec, share: float, forward: Each) -> Each:
    """Return the air drag on a trunk that moves at `forward` m/s, N, times the model's
    share of the robot."""
    wind = forward + hardware.losses.headwind
    pressure = 0.5 * conventions.AIR_DENSITY * wind**2
    return -np.sign(wind) * pressure * hardware.losses.drag_area * share


def slide_friction(hardware: HardwareSpec, rate: Each) -> Each:
    """Force of a spring's slide, N, at a rate of compression, m/s."""
    return -hardware.losses.spring_friction * _smooth_sign(
        rate, SLIDE_ROUNDING * hardware.size.speed
    )


def bus_power(hardware: HardwareSpec, qd: Motors, tau: Motors) -> Each:
    """Return the power that motors take from the bus, W: delivered power and windings'
    heat.

    A motor that stalls at full voltage turns all of its power, stall torque times
    no-load speed, into heat; heat goes with the square of torque.
    """
    count = tau.shape[-1]
    no_load = at_motors(hardware.joint_no_load_speed, count)
    stall = _stall(hardware, no_load)
    return np.sum(tau * qd, axis=-1) + np.sum(
        (tau / stall) ** 2 * stall * no_load, axis=-1
    )


def bus_excess(hardware: HardwareSpec, share: float, power: Each) -> float:
    """Largest power beyond what the bus gives or takes back, W; 0 within."""
    losses = hardware.losses
    over = np.maximum(
        power - share * losses.bus_power_out, -power - share * losses.bus_power_in
    )
    return float(np.max(over, initial=0.0))


def torque_excess(
    hardware: HardwareSpec, share: float, qd: Motors, tau: Motors
) -> float:
    """Largest torque beyond the motors' envelope, Nm; 0 within.

    The peak either way; driving, a line from the stall torque to the no-load speed,
    both in proportion to the voltage; braking, a like line to the braking speed, where
    there is one.
    """
    limits = (
        hardware.joint_peak_torque,
        hardware.joint_no_load_speed,
        hardware.joint_braking_speed,
    )
    peak, no_load, brake = (at_motors(limit, tau.shape[-1]) for limit in limits)
    drawn = np.maximum(bus_power(hardware, qd, tau), 0.0) / share  # W, of a whole robot
    voltage = 1.0 - hardware.losses.bus_sag * drawn[..., None] / 1e3
    over = [np.abs(tau) - peak]
    for sense in (-1.0, 1.0):  # torque and speed in this sense of turning
        torque, speed = sense * tau, sense * qd
        driving = _stall(hardware, no_load) * (voltage - speed / no_load)
        over.append(torque - np.maximum(driving, -peak))
        if np.all(np.isfinite(brake)):
            braking = _stall(hardware, brake) * np.maximum(1.0 + speed / brake, 0.0)
            over.append(np.where(speed < 0.0, torque - braking, 0.0))
    return float(max(np.max(excess, initial=0.0) for excess in over))


def _stall(
    hardware: HardwareSpec, zero: Float[np.ndarray, " motors"]
) -> Float[np.ndarray, " motors"]:
    """Torque at standstill of the line that passes the corner of the envelope and is
    zero at the speed `zero`, Nm."""
    peak, corner = (
        at_motors(x, len(zero))
        for x in (hardware.joint_peak_torque, hardware.joint_corner_speed)
    )
    return peak * zero / (zero - corner)


def at_motors(value: AtJoints, count: int) -> Float[np.ndarray, " {count}"]:
    """Return the hips' and knees' entries of a number of the twelve joints, repeated
    for the model's legs."""
    return np.tile(np.broadcast_to(value, 12)[1:3], count // 2)


def _smooth_sign(x: Each, over: float) -> Each:
    """The sign of x, which goes from -1 to 1 mostly within `over` of 0: 1 - 2 / (exp(2
    x / over) + 1)."""
    return 1.0 - 2.0 / (np.exp(np.clip(2.0 * x / over, -50.0, 50.0)) + 1.0)
