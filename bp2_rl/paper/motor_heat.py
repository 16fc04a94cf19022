"""Heat in the motors: a winding and a case each, and what their temperatures make of
the torque-speed envelope.

Pure and batched; NumPy and JAX arrays alike. Temperatures are in C; T_0 is that of the
published envelope.

    C_w dT_w/dt = P - (T_w - T_c) / R_wc
    C_c dT_c/dt = P_fe + (T_w - T_c) / R_wc - (T_c - T_a) / R_ca
    P = tau^2 (w0 / tau_s) (1 + a (T_w - T_0)) / k^2,   k = 1 - b (T_c - T_0)

The magnets are as warm as the case. Warm magnets give less torque per ampere (k) and
less back EMF per rad/s, warm windings have more resistance, so that the envelope of a
hot motor is

    tau_max' = k tau_max,   w0' = w0 / k,   tau_s' = tau_s k / (1 + a (T_w - T_0))

It loses torque below the corner and on the falling line, but its no-load speed rises:
beyond some speed a hot motor drives harder than a cold one. The drive knows how warm
its motor is: it gives the torque it is asked for, with more current. The end of a
braking line, `Actuator.braking_speed`, stays where it is.
"""

import dataclasses
from typing import Any

import numpy as np
from flax import struct
from jaxtyping import Float

from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.robot.actuator import Actuator

Motors = Float[Any, "..."]  # NumPy or JAX; "... 12" in the robot, but any shape will do
ENVELOPE_TEMPERATURE = AMBIENT
"""T_0, C: that at which a motor has its published envelope."""


class Network(struct.PyTreeNode):
    """The heat's way out of a motor; numbers, or arrays that broadcast against the
    motors."""

    winding_capacity: Any  # J/K
    winding_to_case: Any  # K/W
    case_capacity: Any  # J/K
    case_to_air: Any  # K/W
    air: Any  # C
    copper_growth: Any  # 1/K
    magnet_loss: Any  # 1/K
    iron_loss: Any  # W

    @classmethod
    def from_spec(cls, heat: MotorHeat, winding_to_case: Any) -> "Network":
        """Return the network of a motor with this resistance (K/W) between winding and
        case."""
        return cls(
            winding_capacity=heat.winding_capacity,
            winding_to_case=winding_to_case,
            case_capacity=heat.case_capacity,
            case_to_air=heat.case_to_air,
            air=heat.air,
            copper_growth=heat.copper_growth,
            magnet_loss=heat.magnet_loss,
            iron_loss=heat.iron_loss,
        )


class Temperatures(struct.PyTreeNode):
    """Temperatures of every motor, C."""

    winding: Motors
    case: Motors

    @classmethod
    def uniform(cls, temperature: float, shape: tuple[int, ...]) -> "Temperatures":
        """All as warm."""
        return cls(np.full(shape, temperature), np.full(shape, temperature))


def resistance_ratio(network: Network, temperatures: Temperatures) -> Motors:
    """The windings' resistance over that at T_0."""
    return 1.0 + network.copper_growth * (temperatures.winding - ENVELOPE_TEMPERATURE)


def flux_ratio(network: Network, temperatures: Temperatures) -> Motors:
    """k: torque per ampere and back EMF over those at T_0."""
    return 1.0 - network.magnet_loss * (temperatures.case - ENVELOPE_TEMPERATURE)


def heat_ratio(network: Network, temperatures: Temperatures) -> Motors:
    """The windings' heat at a torque over that at T_0."""
    return (
        resistance_ratio(network, temperatures) / flux_ratio(network, temperatures) ** 2
    )


def heated(
    actuator: Actuator, network: Network, temperatures: Temperatures
) -> Actuator:
    """The motors of that envelope at these temperatures; themselves, to the last bit,
    at T_0.

    `winding_heat` of what is returned is P.
    """
    k, growth = (
        flux_ratio(network, temperatures),
        resistance_ratio(network, temperatures) - 1.0,
    )
    corner, no_load = actuator.corner_speed, actuator.no_load_speed
    return dataclasses.replace(
        actuator,
        peak_torque=k * actuator.peak_torque,
        # where the falling line meets the peak
        corner_speed=(corner - (no_load - corner) * growth) / k,
        no_load_speed=no_load / k,
    )


def warming(
    network: Network, temperatures: Temperatures, cold_heat: Motors
) -> Temperatures:
    """How fast the temperatures rise, K/s, in windings that heat so much (W) at T_0
    under the same torque."""
    n, t = network, temperatures
    out = (t.winding - t.case) / n.winding_to_case
    return Temperatures(
        winding=(cold_heat * heat_ratio(n, t) - out) / n.winding_capacity,
        case=(n.iron_loss + out - (t.case - n.air) / n.case_to_air) / n.case_capacity,
    )


def advance(
    network: Network, temperatures: Temperatures, cold_heat: Motors, seconds: float
) -> Temperatures:
    """The temperatures so many seconds later, by one Runge-Kutta step of the fourth
    order.

    Args:
        network: the motors.
        temperatures: now, C.
        cold_heat: W, of the windings at T_0 under the torque of the meantime:
            `winding_heat` of cold motors, its mean.
        seconds: far below the motor's time constants, which are a minute and more.
    """

    def after(share: float, rate: Temperatures) -> Temperatures:
        step = share * seconds
        return Temperatures(
            temperatures.winding + step * rate.winding,
            temperatures.case + step * rate.case,
        )

    k1 = warming(network, temperatures, cold_heat)
    k2 = warming(network, after(0.5, k1), cold_heat)
    k3 = warming(network, after(0.5, k2), cold_heat)
    k4 = warming(network, after(1.0, k3), cold_heat)
    return after(
        1.0 / 6.0,
        Temperatures(
            k1.winding + 2.0 * (k2.winding + k3.winding) + k4.winding,
            k1.case + 2.0 * (k2.case + k3.case) + k4.case,
        ),
    )
