"""How the paper's 1.8 K/s over 86 s fix a motor that heats, and how far they do not.

One number cannot fix four. With the case and the way from it to the air ASSUMED, it
leaves a family of pairs: the more copper a winding has, the less heat it may give away.
The paper calls the rise nearly linear, which prefers a pair: the growing resistance
bends the curve up, what is given away bends it down, and for one of the pairs they
balance best.
"""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.motor_heat import Network, Temperatures, advance
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot.bp2 import ENDURANCE_TIME, HEATING_RATE

RISE = HEATING_RATE * ENDURANCE_TIME  # K
STEP = 2.0  # s, at most; shorter for motors whose time constants are
# K/W, between which the way from winding to case is looked for; the last is none
WAYS = 0.05, 1e4
MEMBERS = 24  # of the family
HALVINGS = 30
HOUR = 3600.0  # s: who runs for so long runs for ever

Numbers = Float[np.ndarray, "..."]


@dataclasses.dataclass(frozen=True)
class CalibratedMotor:
    """One pair that heats at the paper's mean rate."""

    winding_capacity: float  # J/K
    winding_to_case: float  # K/W
    # K, root mean square distance of the winding's temperature from the best straight
    # line over the 86 s
    bend: float
    first_rate: float  # K/s, as the clock starts
    last_rate: float  # K/s, after the 86 s
    case: float  # C, after the 86 s
    # s to the limit under the heat of the top speed; None: never within an hour
    at_top: float | None


def calibrated(heat: MotorHeat, cold_heat: float) -> MotorHeat:
    """The motor with a way from winding to case such that it heats at the paper's mean
    rate.

    As it is where that way is given. Where even a winding that gives nothing away heats
    too slowly, its copper is less.

    Args:
        heat: what is known of it.
        cold_heat: W, of the hottest rear hip's winding at T_0, in the gait at the
            paper's speed.
    """
    if heat.winding_to_case is not None:
        return heat
    shut = dataclasses.replace(heat, winding_to_case=WAYS[1])
    if rise(Network.from_spec(shut, WAYS[1]), np.array([cold_heat]))[0] < RISE:
        return dataclasses.replace(shut, winding_capacity=most_copper(heat, cold_heat))
    way = ways(Network.from_spec(heat, 1.0), np.array([cold_heat]))
    return dataclasses.replace(heat, winding_to_case=float(way[0]))


def most_copper(heat: MotorHeat, cold_heat: float) -> float:
    """J/K, of the winding that heats at the paper's rate though it gives nothing away;
    C_w bounds."""
    low, high = np.log(10.0), np.log(1e5)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        network = Network.from_spec(heat, WAYS[1]).replace(
            winding_capacity=float(np.exp(middle))
        )
        low, high = (
            (middle, high)
            if rise(network, np.array([cold_heat]))[0] > RISE
            else (low, middle)
        )
    return float(np.exp(low))


def family(
    heat: MotorHeat, cold_heat: float, top_heat: float
) -> tuple[CalibratedMotor, ...]:
    """Pairs from next to no copper to as much as there can be, all at the paper's mean
    rate."""
    capacity = most_copper(heat, cold_heat) * np.linspace(0.1, 1.0, MEMBERS)
    start = np.full(MEMBERS, cold_heat)
    network = Network.from_spec(heat, 1.0).replace(winding_capacity=capacity)
    network = network.replace(winding_to_case=ways(network, start))
    time, t = course(network, start, ENDURANCE_TIME)
    lines = np.polynomial.polynomial.polyfit(time, t.winding, 1)
    bend = np.sqrt(
        np.mean(
            (t.winding - np.polynomial.polynomial.polyval(time, lines).T) ** 2, axis=0
        )
    )
    rates = np.diff(t.winding, axis=0) / np.diff(time)[:, None]
    at_top = seconds_to(network, np.full(MEMBERS, top_heat), heat.limit)
    return tuple(
        CalibratedMotor(
            *map(float, row[:-1]),
            at_top=float(row[-1]) if np.isfinite(row[-1]) else None,
        )
        for row in zip(
            capacity,
            network.winding_to_case,
            bend,
            rates[0],
            rates[-1],
            t.case[-1],
            at_top,
            strict=True,
        )
    )


def straightest(members: tuple[CalibratedMotor, ...]) -> CalibratedMotor:
    """The pair whose winding heats most nearly at a constant rate."""
    return min(members, key=lambda member: member.bend)


def ways(network: Network, cold_heat: Numbers) -> Numbers:
    """K/W from winding to case for the paper's mean rate, each by bisection; an end of
    `WAYS` where none is."""
    low, high = (np.full(cold_heat.shape, np.log(way)) for way in WAYS)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        too_hot = (
            rise(network.replace(winding_to_case=np.exp(middle)), cold_heat) > RISE
        )
        low, high = np.where(too_hot, low, middle), np.where(too_hot, middle, high)
    return np.exp(0.5 * (low + high))


def rise(network: Network, cold_heat: Numbers) -> Numbers:
    """K, of the windings over the paper's 86 s."""
    return course(network, cold_heat, ENDURANCE_TIME)[1].winding[-1] - network.air


def course(
    network: Network, cold_heat: Numbers, seconds: float
) -> tuple[Float[np.ndarray, " T"], Temperatures]:
    """Times (s) and temperatures ("T ...") under a constant torque, from the air's
    temperature."""
    steps = int(np.ceil(seconds / _step(network)))
    now = [Temperatures.uniform(float(network.air), cold_heat.shape)]
    for _ in range(steps):
        now.append(advance(network, now[-1], cold_heat, seconds / steps))
    return np.linspace(0.0, seconds, steps + 1), Temperatures(
        *(_stacked(now, part) for part in ("winding", "case"))
    )


def seconds_to(network: Network, cold_heat: Numbers, limit: float) -> Numbers:
    """s until each winding is at the limit (C) under a constant torque; inf where it is
    not within an hour."""
    now, found = (
        Temperatures.uniform(float(network.air), cold_heat.shape),
        np.full(cold_heat.shape, np.inf),
    )
    time, step = 0.0, _step(network)
    while time < HOUR and not np.all(np.isfinite(found)):
        after = advance(
            network, now, np.where(np.isfinite(found), 0.0, cold_heat), step
        )
        reached = (after.winding >= limit) & ~np.isfinite(found)
        share = (limit - now.winding) / np.where(
            reached, after.winding - now.winding, 1.0
        )
        found = np.where(reached, time + share * step, found)
        now, time = after, time + step
    return found


def _step(network: Network) -> float:
    """s, half of the shortest time constant or less."""
    n = network
    rate = (
        1.0 / n.winding_capacity + 1.0 / n.case_capacity
    ) / n.winding_to_case + 1.0 / n.case_to_air / n.case_capacity
    return float(min(STEP, np.min(0.5 / rate)))


def _stacked(temperatures: list[Temperatures], part: str) -> Any:
    return np.stack([getattr(each, part) for each in temperatures])
