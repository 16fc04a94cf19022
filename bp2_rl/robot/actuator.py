"""The joint motors: PD law, current loop and torque-speed envelope, at the joint side of the gear.

Pure and batched; NumPy and JAX arrays alike, so that MJX and C MuJoCo run the very same motor.

The envelope (DERIVED from the paper's 120 Nm, 21.4 rad/s and 1765 W, four quadrants) is

    tau_hi(w) = clip(min(tau_s (1 - w / w0), tau_max), -tau_max, tau_max),   tau_s = tau_max / (1 - w_c / w0)
    tau_lo(w) = -tau_hi(-w)

flat up to the corner speed w_c, falling to zero at the no-load speed w0, and flat while braking. Driven beyond w0
the supply can only brake: tau_hi is then negative. w_c = 0 is the straight back-EMF line.
"""

from typing import Any

from flax import struct
from jaxtyping import Float

from bp2_rl.robot.specs import IDEAL, HardwareSpec

Parameter = Any  # a number, or an array that broadcasts against the joints, "... 12"
Joints = Float[Any, "..."]  # NumPy or JAX; "... 12" in the robot, but any shape will do


class Actuator(struct.PyTreeNode):
    """Gains and limits of the motors; each a number or an array that broadcasts to (..., 12)."""

    stiffness: Parameter  # Nm/rad
    damping: Parameter  # Nm s/rad
    peak_torque: Parameter  # Nm
    corner_speed: Parameter  # rad/s
    no_load_speed: Parameter  # rad/s
    strength: Parameter = 1.0  # scale on the peak torque
    current_lag: Parameter = 0.0  # s, time constant of the first-order current loop; 0: none
    torque_rate: Parameter = float("inf")  # Nm/s, largest rate of change

    @classmethod
    def from_hardware(
        cls,
        hardware: HardwareSpec = IDEAL,
        *,
        stiffness: Parameter = 250.0,
        damping: Parameter = 3.0,
        strength: Parameter = 1.0,
        current_lag: Parameter = 0.0,
        torque_rate: Parameter = float("inf"),
    ) -> "Actuator":
        """The motors behind this hardware's gear."""
        return cls(
            stiffness=stiffness,
            damping=damping,
            peak_torque=hardware.joint_peak_torque,
            corner_speed=hardware.joint_corner_speed,
            no_load_speed=hardware.joint_no_load_speed,
            strength=strength,
            current_lag=current_lag,
            torque_rate=torque_rate,
        )


def copper_loss(torque: Parameter, no_load: Parameter, stall: Parameter) -> Parameter:
    """Heat of the windings, W, at a torque (Nm): tau^2 omega_0 / tau_s, with no-load speed and `stall_torque`.

    CasADi's numbers are welcome as well.
    """
    return torque**2 * (no_load / stall)


def torque_limits(actuator: Actuator, qd: Joints) -> tuple[Joints, Joints]:
    """Least and greatest torque (Nm, "... 12" each) that the motors can give at joint speeds `qd` (rad/s)."""
    return -_upper_limit(actuator, -qd), _upper_limit(actuator, qd)


def stall_torque(peak: Parameter, corner: Parameter, no_load: Parameter) -> Parameter:
    """tau_s: where the envelope's falling line would be at standstill, Nm; CasADi's numbers are welcome as well."""
    return peak / (1.0 - corner / no_load)


def pd_torque(actuator: Actuator, q: Joints, qd: Joints, q_target: Joints, qd_target: Joints) -> Joints:
    """Torque that the PD law asks for, Nm."""
    return actuator.stiffness * (q_target - q) + actuator.damping * (qd_target - qd)


def joint_torque(
    actuator: Actuator,
    previous_torque: Joints,
    q: Joints,
    qd: Joints,
    q_target: Joints,
    qd_target: Joints,
    dt: float,
) -> Joints:
    """Torque that acts on the joints for the next `dt` seconds, Nm, "... 12".

    PD law, then the current loop's lag, then its rate limit, then the envelope: last, so nothing ever leaves it.
    """
    xp = qd.__array_namespace__()
    desired = pd_torque(actuator, q, qd, q_target, qd_target)
    step = _lag_share(actuator.current_lag, dt) * (desired - previous_torque)
    largest_step = actuator.torque_rate * dt
    torque = previous_torque + xp.clip(step, -largest_step, largest_step)
    lower, upper = torque_limits(actuator, qd)
    return xp.clip(torque, lower, upper)


def _upper_limit(actuator: Actuator, qd: Joints) -> Joints:
    xp = qd.__array_namespace__()
    peak = actuator.strength * actuator.peak_torque
    stall = stall_torque(peak, actuator.corner_speed, actuator.no_load_speed)
    return xp.clip(stall * (1.0 - qd / actuator.no_load_speed), -peak, peak)


def _lag_share(lag: Parameter, dt: float) -> Parameter:
    """Share of the way to the desired torque covered in `dt`: a first-order lag by implicit Euler, all of it for 0."""
    return dt / (lag + dt)
