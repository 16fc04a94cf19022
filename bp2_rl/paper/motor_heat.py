"""Heat in the motors, and the torque-speed envelope of warm motors.

Pure and batched. Temperatures are in C; T_0 is that of the published envelope.

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
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.bp2 import ENDURANCE_TIME, HEATING_RATE

Motors = Float[np.ndarray, "..."]  # "... 12" in the robot, but any shape will do
ENVELOPE_TEMPERATURE = AMBIENT
"""T_0, C: the temperature at which a motor has its published envelope."""
RISE = HEATING_RATE * ENDURANCE_TIME  # K, of a rear hip's winding in the paper's run
STEP = 2.0  # s, at most, of a course
WAYS = 0.05, 1e4  # K/W from winding to case that are looked at; the last is none
CAPACITIES = 10.0, 1e5  # J/K of a winding that are looked at
HALVINGS = 30


class Temperatures(NamedTuple):
    """Temperatures of every motor's winding and case, C."""

    winding: Motors
    case: Motors

    @classmethod
    def uniform(cls, temperature: float, shape: tuple[int, ...]) -> "Temperatures":
        """Return windings and cases all at one temperature, C."""
        return cls(np.full(shape, temperature), np.full(shape, temperature))


def resistance_ratio(motor: MotorHeat, temperatures: Temperatures) -> Motors:
    """Return the windings' electrical resistance over its value at T_0."""
    return 1.0 + motor.copper_growth * (temperatures.winding - ENVELOPE_TEMPERATURE)


def flux_ratio(motor: MotorHeat, temperatures: Temperatures) -> Motors:
    """Return k, the torque per ampere over its value at T_0; back EMF scales alike."""
    return 1.0 - motor.magnet_loss * (temperatures.case - ENVELOPE_TEMPERATURE)


def heat_ratio(motor: MotorHeat, temperatures: Temperatures) -> Motors:
    """Return the windings' heat under a given torque over its value at T_0."""
    return resistance_ratio(motor, temperatures) / flux_ratio(motor, temperatures) ** 2


def heated(
    actuator: Actuator, motor: MotorHeat, temperatures: Temperatures
) -> Actuator:
    """Return motors with the torque-speed envelope of their temperatures; at T_0 the
    cold motors to the last bit.

    `winding_heat` of what is returned is P.
    """
    k = flux_ratio(motor, temperatures)
    growth = resistance_ratio(motor, temperatures) - 1.0
    corner, no_load = actuator.corner_speed, actuator.no_load_speed
    return dataclasses.replace(
        actuator,
        peak_torque=k * actuator.peak_torque,
        # where the falling line meets the peak
        corner_speed=(corner - (no_load - corner) * growth) / k,
        no_load_speed=no_load / k,
    )


def warming(
    motor: MotorHeat, temperatures: Temperatures, cold_heat: Motors
) -> Temperatures:
    """Return the rates at which winding and case temperatures rise, K/s.

    `cold_heat` is the windings' heat at T_0 under the same torque, W.
    """
    m, t = motor, temperatures
    out = (t.winding - t.case) / m.to_case
    return Temperatures(
        winding=(cold_heat * heat_ratio(m, t) - out) / m.winding_capacity,
        case=(m.iron_loss + out - (t.case - m.air) / m.case_to_air) / m.case_capacity,
    )


def advance(
    motor: MotorHeat, temperatures: Temperatures, cold_heat: Motors, seconds: float
) -> Temperatures:
    """Return the temperatures `seconds` later, by one Runge-Kutta step of order four.

    Args:
        motor: all twelve are alike.
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

    k1 = warming(motor, temperatures, cold_heat)
    k2 = warming(motor, after(0.5, k1), cold_heat)
    k3 = warming(motor, after(0.5, k2), cold_heat)
    k4 = warming(motor, after(1.0, k3), cold_heat)
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
        motor = dataclasses.replace(
            heat, winding_to_case=way, winding_capacity=capacity
        )
        return bool(rise(motor, np.array([cold_heat]))[0] > RISE)

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


def rise(motor: MotorHeat, cold_heat: Motors) -> Motors:
    """Return by how much windings warm in the paper's 86 s, K."""
    return course(motor, cold_heat, ENDURANCE_TIME)[1][-1].winding - motor.air


def course(
    motor: MotorHeat, cold_heat: Motors, seconds: float
) -> tuple[Float[np.ndarray, " T"], list[Temperatures]]:
    """Return times (s) and temperatures under a constant torque, starting as warm as
    the air; a step is half of the shortest time constant, at most `STEP`."""
    m = motor
    between = (1.0 / m.winding_capacity + 1.0 / m.case_capacity) / m.to_case
    rate = between + 1.0 / m.case_to_air / m.case_capacity
    steps = int(np.ceil(seconds / min(STEP, 0.5 / rate)))
    now = [Temperatures.uniform(motor.air, cold_heat.shape)]
    for _ in range(steps):
        now.append(advance(motor, now[-1], cold_heat, seconds / steps))
    return np.linspace(0.0, seconds, steps + 1), now
