"""The equations of motors and losses compiled for many different robots at once, in
float64.

Every robot is a row of numbers. A part that a robot lacks gets the strength 0, so that
one program serves all robots.
"""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bp2_rl.robot import conventions, losses
from bp2_rl.robot.actuator import (
    ENDLESS,
    Actuator,
    Bus,
    bus_voltage,
    joint_torque,
    share_bus,
    stall_torque,
    torque_limits,
)
from bp2_rl.robot.coordinates import joint_positions, joint_velocities
from bp2_rl.robot.losses import Resistance

SIZES = 4, 24, 50, 100
"""Batch sizes for which programs are compiled; a smaller batch is filled with copies of
its last robot."""
RobotNumbers = Float[np.ndarray, " _"]
JOINT = [
    "stiffness",
    "damping",
    "peak_torque",
    "corner_speed",
    "no_load_speed",
    "braking_speed",
    "strength",
    "current_lag",
    "torque_rate",
]
"""Motor parameters that have one number for each joint, as motors of different
temperatures need."""
JOINT_LOSSES = ["joint_friction", "joint_viscosity"]
"""Loss parameters that have one number for each joint."""
NO_BUS = Bus(ENDLESS, ENDLESS, 0.0)
NO_RESISTANCE = Resistance(*[0.0] * len(Resistance.__dataclass_fields__))


def numbers_of(
    motors: Actuator, resistance: Resistance | None, seconds: float
) -> RobotNumbers:
    """Return a robot's motors and losses as one row of numbers; `seconds` pass between
    torque updates."""
    resisting = dict(vars(resistance or NO_RESISTANCE))
    values = [
        *(getattr(motors, name) for name in JOINT),
        *(resisting.pop(name) for name in JOINT_LOSSES),
    ]
    by_joint = [
        np.broadcast_to(np.float64(value), conventions.NUM_MOTORS) for value in values
    ]
    rest = (*vars(motors.bus or NO_BUS).values(), *resisting.values(), seconds)
    return np.concatenate([*by_joint, *(np.ravel(np.float64(x)) for x in rest)])


def stacked(rows: Sequence[RobotNumbers]) -> Float[Array, "P _"]:
    """Stack the parameter rows of N robots, filled up to a compiled batch size, on the
    CPU."""
    with jax.enable_x64(True):
        return jax.device_put(np.stack(rows)[filled(len(rows))], jax.devices("cpu")[0])


@functools.cache
def filled(robots: int) -> Int[np.ndarray, " P"]:
    """Return the index of the robot at each place of a compiled batch."""
    places = next((size for size in SIZES if robots <= size), robots)
    return np.minimum(np.arange(places), robots - 1)


def apply(
    law: Callable[..., tuple[Array, ...]],
    rows: Float[Array, "P _"],
    *arrays: Float[np.ndarray, "N _"],
) -> Float[np.ndarray, "N _"]:
    """Return the outputs of a law for each robot, joined along the last axis.

    Args:
        law: `forces` or `correct`.
        rows: the robots' numbers, from `stacked`.
        arrays: the law's other arguments, in its order.
    """
    robots = len(arrays[0])
    values = np.concatenate(arrays, axis=-1)
    if robots < len(rows):
        values = values[filled(robots)]
    compiled = _compiled(law, tuple(x.shape[-1] for x in arrays))
    with jax.enable_x64(True):
        return np.asarray(compiled(rows, values))[:robots]


@functools.cache
def _compiled(
    law: Callable[..., tuple[Array, ...]], sizes: tuple[int, ...]
) -> Callable[..., Array]:
    """Compile a law for a batch of robots, with two packed input arrays and one output
    array for speed."""
    at = np.cumsum(sizes)[:-1].tolist()

    def packed(row: Array, values: Array) -> Array:
        return jnp.concatenate(law(*_read(row), *jnp.split(values, at)))

    return jax.jit(jax.vmap(packed))


def _read(row: Array) -> tuple[Actuator, Resistance, Array]:
    names = JOINT + JOINT_LOSSES
    joints, rest = jnp.split(row, [len(names) * conventions.NUM_MOTORS])
    named = dict(
        zip(names, joints.reshape(len(names), conventions.NUM_MOTORS), strict=True)
    )
    resisting = {name: named.pop(name) for name in JOINT_LOSSES}
    other_losses = [name for name in vars(NO_RESISTANCE) if name not in JOINT_LOSSES]
    bus = len(vars(NO_BUS))
    resistance = Resistance(
        **resisting, **dict(zip(other_losses, rest[bus:-1], strict=True))
    )
    return Actuator(**named, bus=Bus(*rest[:bus])), resistance, rest[-1]


def forces(
    motors: Actuator,
    resistance: Resistance,
    seconds: Array,
    before: Array,
    qpos: Array,
    qvel: Array,
    q_target: Array,
    qd_target: Array,
) -> tuple[Array, ...]:
    """Return the motors' torques (12, Nm) and the losses' generalised forces (nv)."""
    q, qd = joint_positions(qpos), joint_velocities(qvel)
    torque = joint_torque(motors, before, q, qd, q_target, qd_target, seconds)
    return torque, losses.generalized(losses.loss(resistance, qpos, qvel, torque), qvel)


def correct(
    motors: Actuator,
    resistance: Resistance,
    seconds: Array,
    torque: Array,
    before: Array,
    qpos: Array,
    qvel: Array,
    qvel_after: Array,
    mobility: Array,
) -> tuple[Array, ...]:
    """Return torques (12) and forces (nv) for a step's next trial, and the largest
    torque beyond the envelope at the step's end (1), Nm.

    Less torque changes the speed at the end, too, and the limit with it: this is
    Newton's step, joint by joint.
    """
    qd = joint_velocities(qvel)
    voltage = bus_voltage(motors, before, qd)
    lower, upper = torque_limits(motors, joint_velocities(qvel_after), voltage)
    outside = torque - jnp.clip(torque, lower, upper)
    slope = (
        stall_torque(motors.peak_torque, motors.corner_speed, motors.no_load_speed)
        / motors.no_load_speed
    )
    less = torque - outside / (1.0 + slope * seconds * mobility)
    # with less torque more flows back
    next_torque = share_bus(motors, less, torque_limits(motors, qd, voltage), qd)
    forces = losses.generalized(losses.loss(resistance, qpos, qvel, next_torque), qvel)
    return next_torque, forces, jnp.max(jnp.abs(outside), keepdims=True)
