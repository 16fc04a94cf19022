"""Heat in the motors, and the torque-speed envelope of warm motors.

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

The paper's 1.8 K/s over 86 s are one number, and a motor has four: with the winding,
the case and the way from it to the air ASSUMED, `calibrated` finds the way from winding
to case.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from flax import struct
from jaxtyping import Float

from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.bp2 import ENDURANCE_TIME, HEATING_RATE

Motors = Float[Any, "..."]  # NumPy or JAX; "... 12" in the robot, but any shape will do
ENVELOPE_TEMPERATURE = AMBIENT
"""T_0, C: the temperature at which a motor has its published envelope."""
RISE = HEATING_RATE * ENDURANCE_TIME  # K, of a rear hip's winding in the paper's run
STEP = 2.0  # s, at most, of a course
WAYS = 0.05, 1e4  # K/W from winding to case that are looked at; the last is none
CAPACITIES = 10.0, 1e5  # J/K of a winding that are looked at
HALVINGS = 30


class Network(struct.PyTreeNode):
    """Thermal network of a motor: heat flows from the winding through the case to the
    air."""

    winding_capacity: float  # J/K
    winding_to_case: float  # K/W
    case_capacity: float  # J/K
    case_to_air: float  # K/W
    air: float  # C
    copper_growth: float  # 1/K
    magnet_loss: float  # 1/K
    iron_loss: float  # W

    @classmethod
    def from_spec(cls, heat: MotorHeat, winding_to_case: float) -> "Network":
        """Return a motor's thermal network with a resistance, K/W, between winding and
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
    """Temperatures of every motor's winding and case, C."""

    winding: Motors
    case: Motors

    @classmethod
    def uniform(cls, temperature: float, shape: tuple[int, ...]) -> "Temperatures":
        """Return windings and cases all at one temperature, C."""
        return cls(np.full(shape, temperature), np.full(shape, temperature))


def resistance_ratio(network: Network, temperatures: Temperatures) -> Motors:
    """Return the windings' electrical resistance over its value at T_0."""
    return 1.0 + network.copper_growth * (temperatures.winding - ENVELOPE_TEMPERATURE)


def flux_ratio(network: Network, temperatures: Temperatures) -> Motors:
    """Return k, the torque per ampere over its value at T_0; back EMF scales alike."""
    return 1.0 - network.magnet_loss * (temperatures.case - ENVELOPE_TEMPERATURE)


def heat_ratio(network: Network, temperatures: Temperatures) -> Motors:
    """Return the windings' heat under a given torque over its value at T_0."""
    return (
        resistance_ratio(network, temperatures) / flux_ratio(network, temperatures) ** 2
    )


def heated(
    actuator: Actuator, network: Network, temperatures: Temperatures
) -> Actuator:
    """Return motors with the torque-speed envelope of their temperatures; at T_0 the
    cold motors to the last bit.

    `winding_heat` of what is returned is P.
    """
    k = flux_ratio(network, temperatures)
    growth = resistance_ratio(network, temperatures) - 1.0
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
    """Return the rates at which winding and case temperatures rise, K/s.

    `cold_heat` is the windings' heat at T_0 under the same torque, W.
    """
    n, t = network, temperatures
    out = (t.winding - t.case) / n.winding_to_case
    return Temperatures(
        winding=(cold_heat * heat_ratio(n, t) - out) / n.winding_capacity,
        case=(n.iron_loss + out - (t.case - n.air) / n.case_to_air) / n.case_capacity,
    )


def advance(
    network: Network, temperatures: Temperatures, cold_heat: Motors, seconds: float
) -> Temperatures:
    """Return the temperatures `seconds` later, by one Runge-Kutta step of order four.

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


# --- The motor that heats as the paper's ----------------------------------------------


def calibrated(heat: MotorHeat, cold_heat: float) -> MotorHeat:
    """Return `heat` fitted so that a rear hip's winding heats at the paper's mean rate.

    Its way from winding to case is found, unless that is given. Where even a winding
    that gives nothing away heats too slowly, its copper is less.

    Args:
        heat: what is known of the motor.
        cold_heat: W, of the hottest rear hip's winding at T_0, in the gait at the
            paper's speed.
    """
    if heat.winding_to_case is not None:
        return heat

    def too_hot(way: float, capacity: float) -> bool:
        network = Network.from_spec(heat, way).replace(winding_capacity=capacity)
        return bool(rise(network, np.array([cold_heat]))[0] > RISE)

    copper = heat.winding_capacity
    if too_hot(WAYS[1], copper):
        way = _halve(lambda way: not too_hot(way, copper), *WAYS)
        return dataclasses.replace(heat, winding_to_case=way)
    copper = _halve(lambda capacity: too_hot(WAYS[1], capacity), *CAPACITIES)
    return dataclasses.replace(heat, winding_to_case=WAYS[1], winding_capacity=copper)


def _halve(is_below: Callable[[float], bool], low: float, high: float) -> float:
    """Return, by bisection of the logarithm, where `is_below` turns from true to
    false."""
    low, high = np.log(low), np.log(high)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        below = is_below(float(np.exp(middle)))
        low, high = (middle, high) if below else (low, middle)
    return float(np.exp(0.5 * (low + high)))


def rise(network: Network, cold_heat: Motors) -> Motors:
    """Return by how much windings warm in the paper's 86 s, K."""
    return course(network, cold_heat, ENDURANCE_TIME)[1][-1].winding - network.air


def course(
    network: Network, cold_heat: Motors, seconds: float
) -> tuple[Float[np.ndarray, " T"], list[Temperatures]]:
    """Return times (s) and temperatures under a constant torque, starting as warm as
    the air."""
    steps = int(np.ceil(seconds / _course_step(network)))
    now = [Temperatures.uniform(float(network.air), cold_heat.shape)]
    for _ in range(steps):
        now.append(advance(network, now[-1], cold_heat, seconds / steps))
    return np.linspace(0.0, seconds, steps + 1), now


def _course_step(network: Network) -> float:
    """Return the time step of `course`, s: half of the shortest time constant, at most
    `STEP`."""
    n = network
    between = (1.0 / n.winding_capacity + 1.0 / n.case_capacity) / n.winding_to_case
    rate = between + 1.0 / n.case_to_air / n.case_capacity
    return float(min(STEP, 0.5 / rate))
