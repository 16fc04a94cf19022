"""From one robot to another, a property or a loss at a time."""

import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple, TypeVar

from bp2_rl.robot.bp2_body import BP2Body
from bp2_rl.robot.hardware import IDEAL, HardwareSpec, Losses

Spec = TypeVar("Spec", HardwareSpec, Losses, BP2Body)


class Part(NamedTuple):
    """Parameters of a robot that belong together, by the class that has them."""

    losses: tuple[str, ...] = ()
    hardware: tuple[str, ...] = ()
    body: tuple[str, ...] = ()  # of BP2 alone


PARTS = {
    "air": Part(losses=("drag_area", "headwind")),
    "gears": Part(losses=("gear_efficiency",)),
    "joint friction": Part(losses=("joint_friction", "joint_viscosity")),
    "spring slides": Part(losses=("spring_friction",)),
    "bus power": Part(losses=("bus_power_out", "bus_power_in")),
    "bus sag": Part(losses=("bus_sag",)),
    "torque lag": Part(losses=("current_lag",)),
    "latency": Part(losses=("latency",)),
    "envelope throughout": Part(hardware=("envelope",)),
    "braking limit": Part(hardware=("braking_speed",)),
    "ground friction": Part(hardware=("friction",)),
    "ground stiffness": Part(hardware=("contact_time", "contact_damping")),
    "rebound stop": Part(hardware=("rebound_stiffness", "rebound_damping")),
    "joint stops": Part(hardware=("joint_stop_time",)),
    "solid legs, tracks": Part(
        hardware=("solid_legs",), body=("fore_track", "hind_track")
    ),
}
"""The parts in which a built robot differs from the ideal one."""


def ideal_of(robot: HardwareSpec) -> HardwareSpec:
    """Return the robot that loses nothing: BP2's ideal one, or any other robot on its
    own ground and stops."""
    if robot.is_bp2:
        return IDEAL
    free = {
        "losses": Losses(),
        "envelope": IDEAL.envelope,
        "braking_speed": math.inf,
        "solid_legs": False,
    }
    return dataclasses.replace(robot, **free)


def with_parts(
    robot: HardwareSpec, other: HardwareSpec, parts: Iterable[str]
) -> HardwareSpec:
    """Return the robot with some `PARTS` of another one."""
    for part in (PARTS[name] for name in parts):
        losses = _with_fields(robot.losses, other.losses, part.losses)
        robot = _with_fields(robot, other, part.hardware)
        robot = dataclasses.replace(robot, losses=losses)
        if part.body and robot.is_bp2:
            body = _with_fields(robot.bp2, other.bp2, part.body)
            robot = dataclasses.replace(robot, body=body)
    return robot


def _with_fields(own: Spec, other: Spec, names: Iterable[str]) -> Spec:
    return dataclasses.replace(own, **{name: getattr(other, name) for name in names})


def differing(robot: HardwareSpec, other: HardwareSpec) -> tuple[str, ...]:
    """Return the names of the parts in which two robots differ."""
    return tuple(part for part in PARTS if with_parts(robot, other, [part]) != robot)
