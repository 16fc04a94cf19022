"""Motion of a free leg under the motors' law: what a set of motor numbers predicts.

A leg whose foot touches nothing is a chain of three joints on a trunk whose motion was
recorded. Its equations are the kernel's, with the trunk's turning given::

    M_l qdd = torque - bias(q, qd, spin, up) - M_lt dspin/dt - friction

Gravity acts along the recorded `up`; how the trunk's origin accelerates is not recorded
and left out. A spring in the shank stays at rest.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from bp2_rl.robot.actuator import Actuator, pd_torque, torque_limits
from bp2_rl.robot.kernel.arrowhead import GeneralizedVector
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.equations import inertia_matrix, smooth_force
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Legs, RobotPose, Rotation
from bp2_rl.robot.kernel.vectors import ZERO, Number, Vector

STEPS = 2
"""Integration steps between two rows of a log, by the midpoint rule."""
EARLIER = 3
"""Rows before a window whose targets may still act: the greatest delay."""
STICTION = 0.05
"""rad/s, below which Coulomb friction is as viscous."""


class Motors(NamedTuple):
    """Numbers of the motors that a log can tell; arrays (3,) over abad, hip and knee."""

    torque_scale: Float[Array, "3"]  # of the torque that gains and limits say
    no_load_speed: Float[Array, "3"]  # rad/s
    friction: Float[Array, "3"]  # Nm, Coulomb's
    viscosity: Float[Array, "3"]  # Nm s/rad
    armature: Float[Array, "3"]  # kg m2, the rotor's inertia at the joint
    corner_speed: Float[Array, "3"]  # rad/s
    delay: Float[Array, "1"]  # s, from a target to its torque


class Windows(NamedTuple):
    """Recorded windows of free legs: arrays over rows, legs and windows."""

    q: Float[Array, "rows+1 4 W 3"]  # rad, from the start on
    q_target: Float[Array, "rows+3 4 W 3"]  # rad, from `EARLIER` rows before the start
    step: Float[Array, "rows 4 W"]  # s, between rows
    up: Float[Array, "rows 4 W 3"]
    spin: Float[Array, "rows 4 W 3"]  # rad/s
    turning: Float[Array, "rows 4 W 3"]  # rad/s2, the spin's derivative
    start: Float[Array, "4 W 6"]  # rad and rad/s, estimated angles and rates
    weight: Float[Array, "4 W"]  # 1, or 0 for a window that fills up the array
    swing: Int[Array, "4 W"]  # index of the swing to which a window belongs


def predict(
    design: Design,
    drive: Actuator,
    gear_loss: float,
    motors: Motors,
    start: Array,
    windows: Windows,
) -> Float[Array, "rows 4 W 3"]:
    """Predict the angles of free legs after each row of their windows, rad.

    Args:
        design: the robot's, of whose legs the armature is replaced.
        drive: gains and peak torque, each a number or an array (3,).
        gear_loss: share of the torque that the gears take.
        motors: what is tried.
        start: (4, W, 6), angles (rad) and rates (rad/s) at each window's start.
        windows: the recorded ones.
    """
    drive = dataclasses.replace(
        drive, corner_speed=motors.corner_speed, no_load_speed=motors.no_load_speed
    )
    still = [ZERO] * len(design.armature[3:])
    design = dataclasses.replace(
        design, armature=(*motors.armature, *design.armature[3:])
    )

    def acceleration(
        q: Array, qd: Array, target: Array, up: Array, spin: Array, turning: Array
    ) -> Array:
        asked = pd_torque(drive, q, qd, target, jnp.zeros(()))
        torque = motors.torque_scale * jnp.clip(asked, *torque_limits(drive, qd))
        most = motors.friction + gear_loss * jnp.abs(torque)
        torque = torque - most * jnp.tanh(qd / STICTION) - motors.viscosity * qd
        return _free_acceleration(
            design,
            _parts(q) + still,
            _parts(qd) + still,
            _parts(torque) + still,
            up,
            spin,
            turning,
        )

    def row(
        state: tuple[Array, Array], recorded: tuple[Array, ...]
    ) -> tuple[tuple[Array, Array], Array]:
        (q, qd), (targets, step, up, spin, turning) = state, recorded
        dt = step / STEPS
        for i in range(STEPS):
            target = _held(targets, (motors.delay[0] - i * dt) / dt, step / dt)
            half = 0.5 * dt[..., None]
            middle = qd + half * acceleration(q, qd, target, up, spin, turning)
            rate = acceleration(q + half * qd, middle, target, up, spin, turning)
            q = q + 2.0 * half * middle
            qd = qd + 2.0 * half * rate
        return (q, qd), q

    rows = len(windows.step)
    targets = jnp.stack(
        [
            windows.q_target[EARLIER - k : EARLIER - k + rows]
            for k in range(EARLIER + 1)
        ],
        axis=1,
    )
    recorded = targets, windows.step, windows.up, windows.spin, windows.turning
    return jax.lax.scan(row, (start[..., :3], start[..., 3:]), recorded)[1]


def _held(targets: Array, late: Array, row: Array) -> Array:
    """Return the mean target over an integration step: each row's holds until the next
    row's, `late` steps late."""
    mean = targets[0]
    for earlier in range(EARLIER):
        share = jnp.clip(late - earlier * row, 0.0, 1.0)[..., None]
        mean = mean + share * (targets[earlier + 1] - targets[earlier])
    return mean


def _free_acceleration(
    design: Design,
    q: list[Number],
    qd: list[Number],
    torque: list[Number],
    up: Array,
    spin: Array,
    turning: Array,
) -> Array:
    """Return the accelerations of abad, hip and knee of legs that touch nothing."""
    masses = Masses.of(
        design, jnp.ones((2 + 4 * len(design.links), 1)), jnp.zeros((3, 1))
    )
    pose = RobotPose(_rotation(_vector(up)), Legs.of(design, masses, q))
    inertia = inertia_matrix(FusionBarriers(None), Robots(design, masses, 1.0), pose)
    velocity = GeneralizedVector([ZERO, ZERO, ZERO, *_vector(spin)], qd)
    applied = GeneralizedVector([ZERO] * 6, torque)
    force = smooth_force(design, masses, pose, q, velocity, applied).legs
    turned = pose.rotation.to_world(_vector(turning))
    free = [
        own - sum(coupled * turn for coupled, turn in zip(row[3:], turned, strict=True))
        for own, row in zip(force[:3], inertia.coupling[:3], strict=True)
    ]
    lower = [[inertia.legs[max(i, j)][min(i, j)] for j in range(3)] for i in range(3)]
    matrix = jnp.stack(
        [jnp.stack(jnp.broadcast_arrays(*entries), -1) for entries in lower], -2
    )
    return jnp.linalg.solve(matrix, jnp.stack(free, -1)[..., None])[..., 0]


def _rotation(up: Vector) -> Rotation:
    """Return a rotation from the trunk's axes to the world's; its heading is free."""
    x, y, z = up
    across = jax.lax.rsqrt(1.0 - x * x)
    forward = 1.0 / across, -x * y * across, -x * z * across
    return Rotation(forward, (ZERO, z * across, -y * across), up)


def _parts(x: Array) -> list[Number]:
    return [x[..., i] for i in range(3)]


def _vector(x: Array) -> Vector:
    return x[..., 0], x[..., 1], x[..., 2]
