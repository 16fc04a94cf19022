"""Motion of a free leg under the motors' law: what a set of motor numbers predicts.

A leg whose foot touches nothing is a chain of three joints on a trunk whose motion was
recorded. Its equations are the kernel's, with the trunk's turning given::

    M_l qdd = torque - bias(q, qd, spin, f) - M_lt dspin/dt - friction

f is the specific force at the trunk's origin, which an accelerometer measures; where
none was recorded, it is gravity's alone. A spring in the shank stays at rest.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bp2_rl.base import arrays
from bp2_rl.robot.actuator import Actuator, pd_torque, torque_limits
from bp2_rl.robot.kernel.arrowhead import GeneralizedVector
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.equations import inertia_matrix, smooth_force
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Legs, RobotPose, Rotation
from bp2_rl.robot.kernel.vectors import ZERO, Number, Vector, scaled

STEP = 1e-3
"""s, longest integration step, by the midpoint rule."""
LONGEST_DELAY = 0.02  # s, as of `Losses.latency`
STOPPED = 0.7
"""Share of a joint's momentum that Coulomb friction takes in a step near rest: all of it
could turn the motion round."""


TRUNK_AXES = Rotation((1.0, ZERO, ZERO), (ZERO, 1.0, ZERO), (ZERO, ZERO, 1.0))
"""The equations are written in the trunk's axes: nothing depends on its attitude but the
specific force."""


class Motors(NamedTuple):
    """Numbers that a log can tell of motors and links; arrays (3,) over abad, hip and
    knee."""

    torque_scale: Float[arrays.Array, "3"]  # of the torque that gains and limits say
    no_load_speed: Float[arrays.Array, "3"]  # rad/s
    friction: Float[arrays.Array, "3"]  # Nm, Coulomb's
    viscosity: Float[arrays.Array, "3"]  # Nm s/rad
    armature: Float[arrays.Array, "3"]  # kg m2, the rotor's inertia at the joint
    corner_share: Float[arrays.Array, "3"]  # corner speed over the no-load speed
    delay: Float[arrays.Array, "1"]  # s, from a target to its torque
    inertia: Float[arrays.Array, "4 3"]  # of each leg's links, times the robot file's


class Windows(NamedTuple):
    """Recorded windows of free legs: arrays over rows, legs and windows."""

    step: Float[arrays.Array, ""]  # s, between rows
    q: Float[arrays.Array, "rows+1 4 W 3"]  # rad, from the start on
    q_target: Float[
        arrays.Array, "before+rows 4 W 3"
    ]  # rad, from `before` rows earlier on
    acceleration: Float[arrays.Array, "rows 4 W 3"]  # m/s2, specific force
    spin: Float[arrays.Array, "rows 4 W 3"]  # rad/s
    turning: Float[arrays.Array, "rows 4 W 3"]  # rad/s2, the spin's derivative
    start: Float[arrays.Array, "4 W 6"]  # rad and rad/s, estimated angles and rates
    kept: Bool[arrays.Array, "4 W"]  # False of a window that fills up the array
    swing: Int[arrays.Array, "4 W"]  # index of the swing to which a window belongs


class Rig(NamedTuple):
    """A robot's legs and drives, and the motors' numbers with which a fit begins."""

    design: Design
    drive: Actuator  # gains and limits, (3,) over abad, hip and knee
    gear_loss: float  # share of the torque that the gears take
    configured: Motors
    guess: Motors  # positive, where the fit begins


def predict(
    rig: Rig, motors: Motors, start: Array, windows: Windows, substeps: int
) -> Float[Array, "rows 4 W 3"]:
    """Predict the angles of free legs after each row of their windows, rad.

    Args:
        rig: the robot, whose motors' numbers are replaced.
        motors: the numbers that are tried.
        start: (4, W, 6), angles (rad) and rates (rad/s) at each window's start.
        windows: the recorded ones.
        substeps: integration steps before a row's target changes, and as many after it.
    """
    corner = motors.corner_share * motors.no_load_speed
    limits = {"corner_speed": corner, "no_load_speed": motors.no_load_speed}
    drive = dataclasses.replace(rig.drive, **limits)
    springs = rig.design.armature[3:]
    design = dataclasses.replace(rig.design, armature=(*motors.armature, *springs))
    still = [jnp.zeros_like(start[..., 0])] * len(springs)
    links = motors.inertia[:, np.minimum(np.arange(len(design.links)), 2)]
    factors = jnp.concatenate([jnp.ones(2), jnp.ravel(links)])[:, None]
    masses = Masses.of(design, factors, jnp.zeros((3, 1)))

    def acceleration(q: Array, qd: Array, target: Array, trunk: list[Array]) -> Array:
        asked = pd_torque(drive, q, qd, target, jnp.zeros(()))
        torque = motors.torque_scale * jnp.clip(asked, *torque_limits(drive, qd))
        friction = motors.friction + rig.gear_loss * jnp.abs(torque)
        torque = torque - motors.viscosity * qd
        force, spin, turning = trunk
        return _free_acceleration(
            Robots(design, masses, 1.0),
            _parts(q) + still,
            _parts(qd) + still,
            _parts(torque) + still,
            friction,
            longest,
            force,
            spin,
            turning,
        )

    longest = windows.step / substeps
    rows, targets = len(windows.spin), windows.q_target
    late = len(targets) - rows - motors.delay[0] / windows.step
    first = jnp.clip(jnp.floor(late), 0, len(targets) - rows - 1)
    spans = jnp.stack([1.0 - (late - first), late - first]) * longest

    def advance(
        state: tuple[Array, Array], now: list[Array]
    ) -> tuple[tuple[Array, Array], Array]:
        (q, qd), (dt, target, *trunk) = state, now
        middle = qd + 0.5 * dt * acceleration(q, qd, target, trunk)
        rate = acceleration(q + 0.5 * dt * qd, middle, target, trunk)
        return (q + dt * middle, qd + dt * rate), q + dt * middle

    def each(x: Array) -> Array:
        return jnp.repeat(x, 2 * substeps, axis=0)

    place = first.astype(int) + jnp.arange(rows)
    held = jnp.stack([targets[place], targets[place + 1]], axis=1)
    held = held.reshape(2 * rows, *targets.shape[1:])
    recorded = [
        jnp.tile(jnp.repeat(spans, substeps), rows),
        jnp.repeat(held, substeps, axis=0),
        *(each(x) for x in (windows.acceleration, windows.spin, windows.turning)),
    ]
    begun = start[..., :3], start[..., 3:]
    return jax.lax.scan(advance, begun, recorded)[1][2 * substeps - 1 :: 2 * substeps]


def _free_acceleration(
    robots: Robots,
    q: list[Number],
    qd: list[Number],
    torque: list[Number],
    friction: Array,
    dt: Array,
    specific: Array,
    spin: Array,
    turning: Array,
) -> Array:
    """Return the accelerations of abad, hip and knee of legs that touch nothing; Coulomb
    friction does not turn a motion round within a step `dt`."""
    gravity = scaled(-1.0, _vector(specific))
    design, masses = dataclasses.replace(robots.design, gravity=gravity), robots.masses
    pose = RobotPose(TRUNK_AXES, Legs.of(design, masses, q))
    inertia = inertia_matrix(FusionBarriers(None), robots, pose)
    velocity = GeneralizedVector([ZERO, ZERO, ZERO, *_vector(spin)], qd)
    applied = GeneralizedVector([ZERO] * 6, torque)
    force = smooth_force(design, masses, pose, q, velocity, applied).legs
    free: list[Number] = []
    for i, row in enumerate(inertia.coupling[:3]):
        stopping = STOPPED * inertia.legs[i][i] * qd[i] / dt
        most = friction[..., i]
        held = most * jnp.tanh(stopping / (most + 1e-6))
        trunk = sum(
            coupled * turn
            for coupled, turn in zip(row[3:], _vector(turning), strict=True)
        )
        free.append(force[i] - held - trunk)
    # Cholesky's solution written out: LAPACK's, called from many threads, may wait for ever
    m = inertia.legs
    across = [m[1][0] / m[0][0], m[2][0] / m[0][0]]
    second = m[1][1] - across[0] * m[1][0]
    turn = (m[2][1] - across[1] * m[1][0]) / second
    third = m[2][2] - across[1] * m[2][0] - turn * turn * second
    y = free[1] - across[0] * free[0]
    knee = (free[2] - across[1] * free[0] - turn * y) / third
    hip = y / second - turn * knee
    abad = free[0] / m[0][0] - across[0] * hip - across[1] * knee
    return jnp.stack(jnp.broadcast_arrays(abad, hip, knee), -1)


def _parts(x: Array) -> list[Number]:
    return [x[..., i] for i in range(3)]


def _vector(x: Array) -> Vector:
    return x[..., 0], x[..., 1], x[..., 2]
