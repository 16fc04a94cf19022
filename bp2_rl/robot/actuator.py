"""The joint motors: PD law, current loop, torque-speed envelope and the bus they share,
at the joint side of the gear.

Functions are pure, batched over leading axes (joints "... 12") and take arrays of NumPy
or JAX, so that every engine runs the very same motor; nothing here imports JAX. What a
torque loses on its way to the joint is in `robot.losses`.

The envelope (DERIVED from the paper's 120 Nm, 21.4 rad/s and 1765 W, four quadrants) is

    tau_hi(w) = clip(min(tau_s (u - w / w0), tau_max), -tau_max, tau_max),   tau_s = tau_max / (1 - w_c / w0)
    tau_lo(w) = -tau_hi(-w)

flat up to the corner speed w_c, falling to zero at the no-load speed w0, and flat while
braking. u is the bus's voltage over its nominal one, which is 1 where nothing sags.
Driven beyond w0 the back EMF exceeds the voltage and the drive can only brake: tau_hi
is then negative. w_c = 0 is the straight back-EMF line.

Flat braking is what a motor with a resistance alone can do: the back EMF drives the
braking current, up to w0 (1 + tau_max / tau_s) without field weakening. A motor whose
inductance counts brakes less at speed; `braking_speed` is where a line from the corner
ends, on which -tau_lo then stays for w > 0.

The bus feeds all motors. What they draw, sum of tau w and copper loss, sags the
voltage, and is kept between the powers that may flow in and out by one common factor on
all torques, as a drive would. What flows back beyond w0 against the drive's will is not
scaled: a brake resistor burns it.
"""

import dataclasses

import numpy as np

from bp2_rl.base.arrays import Array, ArrayT, Number
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

ENDLESS = 1e9
"""Power limit of a bus without limits, W; computes better than infinity."""
LEAST_VOLTAGE = 0.3
"""Lowest voltage to which a bus sags, as a share of the nominal voltage."""


@dataclasses.dataclass(frozen=True)
class Bus:
    """Power limits and voltage sag of battery and drive; numbers, or arrays over
    robots."""

    power_out: Number  # W
    power_in: Number  # W
    sag: Number  # share of the voltage lost per W out


@dataclasses.dataclass(frozen=True)
class Actuator:
    """Gains and limits of the motors; each a number or an array that broadcasts to
    (..., 12)."""

    stiffness: Number  # Nm/rad
    damping: Number  # Nm s/rad
    peak_torque: Number  # Nm
    corner_speed: Number  # rad/s
    no_load_speed: Number  # rad/s
    braking_speed: Number = float("inf")  # rad/s; see above
    strength: Number = 1.0  # scale on the peak torque
    # s, time constant of the first-order current loop; 0: none
    current_lag: Number = 0.0
    torque_rate: Number = float("inf")  # Nm/s, largest rate of change
    bus: Bus | None = None  # None: it gives and takes everything, at nominal voltage

    @classmethod
    def from_hardware(
        cls,
        hardware: HardwareSpec = IDEAL,
        *,
        stiffness: Number = bp2.LOOP_STIFFNESS,
        damping: Number = bp2.LOOP_DAMPING,
        strength: Number = 1.0,
        torque_rate: Number = float("inf"),
    ) -> "Actuator":
        """Return the joint motors of a robot, with limits at the joint side of the
        gear."""
        losses = hardware.losses
        bus = Bus(
            power_out=min(losses.bus_power_out, ENDLESS),
            power_in=min(losses.bus_power_in, ENDLESS),
            sag=1e-3 * losses.bus_sag,
        )
        return cls(
            stiffness=stiffness,
            damping=damping,
            peak_torque=hardware.joint_peak_torque,
            corner_speed=hardware.joint_corner_speed,
            no_load_speed=hardware.joint_no_load_speed,
            braking_speed=hardware.joint_braking_speed,
            strength=strength,
            current_lag=losses.current_lag,
            torque_rate=torque_rate,
            bus=None if bus == Bus(ENDLESS, ENDLESS, 0.0) else bus,
        )


def of_joint(actuator: Actuator, joint: int) -> Actuator:
    """Return the motor of a joint, by the joint's index from 0 to 11."""
    limits = "peak_torque", "corner_speed", "no_load_speed", "braking_speed"
    own = {
        name: float(np.broadcast_to(getattr(actuator, name), 12)[joint])
        for name in limits
    }
    return dataclasses.replace(actuator, **own)


def copper_loss(torque: Number, no_load: Number, stall: Number) -> Number:
    """Heat of the windings, W, at a torque (Nm): tau^2 omega_0 / tau_s, with no-load
    speed and `stall_torque`.

    CasADi's numbers are welcome as well.
    """
    return torque**2 * (no_load / stall)


def torque_limits(
    actuator: Actuator, qd: Array, voltage: Number = 1.0
) -> tuple[Array, Array]:
    """Least and greatest torque (Nm, "... 12" each) that the motors can give at joint
    speeds `qd` (rad/s).

    `voltage` of the bus is a share of the nominal one, and broadcasts against the
    joints.
    """
    lower = -_upper_limit(actuator, -qd, voltage)
    upper = _upper_limit(actuator, qd, voltage)
    if isinstance(actuator.braking_speed, float) and actuator.braking_speed == float(
        "inf"
    ):
        return lower, upper
    xp = qd.__array_namespace__()
    braking_down = _braking_limit(actuator, qd)
    braking_up = _braking_limit(actuator, -qd)
    # Beyond the no-load speed the back EMF brakes, whatever the drive can.
    return xp.minimum(xp.maximum(lower, -braking_down), upper), xp.maximum(
        xp.minimum(upper, braking_up), lower
    )


def stall_torque(peak: Number, corner: Number, no_load: Number) -> Number:
    """Return tau_s, Nm, where the falling line of the torque-speed envelope meets
    standstill; takes CasADi's numbers, too."""
    return peak / (1.0 - corner / no_load)


def pd_torque(
    actuator: Actuator, q: Array, qd: Array, q_target: Array, qd_target: Array
) -> Array:
    """Return the torque that the joints' PD law asks for, Nm."""
    return actuator.stiffness * (q_target - q) + actuator.damping * (qd_target - qd)


def joint_torque(
    actuator: Actuator,
    previous_torque: ArrayT,
    q: Array,
    qd: Array,
    q_target: Array,
    qd_target: Array,
    dt: Number,
) -> ArrayT:
    """Return the motors' torque for the next `dt` seconds, Nm, "... 12".

    PD law, then the current loop's lag, then its rate limit, then the envelope and the
    bus: last, so nothing ever leaves them.
    """
    xp = qd.__array_namespace__()
    desired = pd_torque(actuator, q, qd, q_target, qd_target)
    # of the way, by implicit Euler: all of it without a lag
    share = dt / (actuator.current_lag + dt)
    step = share * (desired - previous_torque)
    largest_step = actuator.torque_rate * dt
    torque = previous_torque + xp.clip(step, -largest_step, largest_step)
    limits = torque_limits(actuator, qd, bus_voltage(actuator, previous_torque, qd))
    return share_bus(actuator, xp.clip(torque, *limits), limits, qd)


def winding_heat(actuator: Actuator, torque: Number) -> Number:
    """Return the motors' copper loss at a torque (Nm), W; weak motors lose as much as
    strong ones."""
    stall = stall_torque(
        actuator.peak_torque, actuator.corner_speed, actuator.no_load_speed
    )
    return copper_loss(torque, actuator.no_load_speed, stall)


def bus_power(actuator: Actuator, torque: Array, qd: Array) -> Array:
    """Return the power that all motors together draw from the bus, W: mechanical power
    and copper loss."""
    return (torque * qd + winding_heat(actuator, torque)).sum(-1)


def bus_voltage(actuator: Actuator, torque: Array, qd: Array) -> Number:
    """Return the bus voltage over its nominal value ("... 1") while the motors give
    this torque."""
    if actuator.bus is None:
        return 1.0
    xp = qd.__array_namespace__()
    return xp.clip(
        1.0 - actuator.bus.sag * bus_power(actuator, torque, qd), LEAST_VOLTAGE, 1.0
    )[..., None]


def share_bus(
    actuator: Actuator, torque: ArrayT, limits: tuple[Array, Array], qd: Array
) -> ArrayT:
    """Return the torques (Nm), reduced by one common share so that their power stays
    within the limits of the bus.

    The torques are unchanged where the bus gives and takes everything.
    """
    if actuator.bus is None:
        return torque
    xp, r = qd.__array_namespace__(), winding_heat(actuator, 1.0)
    least = xp.clip(0.0 * qd, *limits)
    way = torque - least
    # The power is p0 + p1 s + p2 s^2 at a share s.
    p0 = bus_power(actuator, least, qd)
    p1, p2 = (way * qd + 2.0 * r * least * way).sum(-1), (r * way**2).sum(-1)
    whole = p0 + p1 + p2

    # a shape would be created at every call
    def share(limit: Number, sign: float) -> Number:
        root = xp.sqrt(xp.maximum(p1 * p1 - 4.0 * p2 * (p0 - limit), 0.0))
        return xp.clip(
            (sign * root - p1) / (2.0 * xp.where(p2 > 0.0, p2, 1.0)), 0.0, 1.0
        )

    out, into = actuator.bus.power_out, -actuator.bus.power_in
    shares = xp.where(
        whole > out, share(out, 1.0), xp.where(whole < into, share(into, -1.0), 1.0)
    )
    return least + shares[..., None] * way


def _upper_limit(actuator: Actuator, qd: Array, voltage: Number) -> Array:
    xp = qd.__array_namespace__()
    peak = actuator.strength * actuator.peak_torque
    stall = stall_torque(peak, actuator.corner_speed, actuator.no_load_speed)
    return xp.clip(stall * (voltage - qd / actuator.no_load_speed), -peak, peak)


def _braking_limit(actuator: Actuator, qd: Array) -> Array:
    """Return the size of the greatest braking torque at a positive speed, Nm."""
    xp = qd.__array_namespace__()
    peak = actuator.strength * actuator.peak_torque
    stall = stall_torque(peak, actuator.corner_speed, actuator.braking_speed)
    return xp.clip(stall * (1.0 - qd / actuator.braking_speed), 0.0, peak)
