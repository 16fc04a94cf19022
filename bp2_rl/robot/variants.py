"""From one robot to another, a property or a loss at a time."""

import dataclasses
import math
from collections.abc import Iterable

from bp2_rl.robot.hardware import IDEAL, HardwareSpec, Losses

PARTS: dict[str, tuple[str, ...]] = {
    "air": ("losses.drag_area", "losses.headwind"),
    "gears": ("losses.gear_efficiency",),
    "joint friction": ("losses.joint_friction", "losses.joint_viscosity"),
    "spring slides": ("losses.spring_friction",),
    "bus power": ("losses.bus_power_out", "losses.bus_power_in"),
    "bus sag": ("losses.bus_sag",),
    "torque lag": ("losses.current_lag",),
    "latency": ("losses.latency",),
    "envelope throughout": ("envelope",),
    "braking limit": ("braking_speed",),
    "ground friction": ("friction",),
    "ground stiffness": ("contact_time", "contact_damping"),
    "rebound stop": ("rebound_stiffness", "rebound_damping"),
    "joint stops": ("joint_stop_time",),
    "solid legs, tracks": ("solid_legs", "fore_track", "hind_track"),
}
"""What tells a built robot from the ideal one: parameters of a robot that belong
together; `losses.x` is a loss."""


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
    """A robot with some `PARTS` of another."""
    fields = [
        field
        for part in parts
        for field in PARTS[part]
        if "." in field or _has(robot, field)
    ]
    own = {field: other.parameter(field) for field in fields if "." not in field}
    losses = {
        name: getattr(other.losses, name)
        for _, dot, name in (f.partition(".") for f in fields)
        if dot
    }
    return robot.changed(losses=dataclasses.replace(robot.losses, **losses), **own)


def _has(robot: HardwareSpec, field: str) -> bool:
    return hasattr(robot, field) or robot.is_bp2  # what is no field is of BP2's body


def differing(robot: HardwareSpec, other: HardwareSpec) -> tuple[str, ...]:
    """The parts in which two robots differ."""
    return tuple(part for part in PARTS if with_parts(robot, other, [part]) != robot)
