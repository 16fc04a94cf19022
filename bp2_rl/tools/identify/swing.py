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
from jaxtyping import Array, Bool, Float, Int

from bp2_rl.base import arrays
from bp2_rl.robot.actuator import Actuator, pd_torque, torque_limits
from bp2_rl.robot.kernel.arrowhead import GeneralizedVector
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.equations import inertia_matrix, smooth_force
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers
from bp2_rl.robot.kernel.legs import Legs, RobotPose, Rotation
from bp2_rl.robot.kernel.vectors import ZERO, Number, Vector

STEP = 1e-3
"""s, longest integration step, by the midpoint rule."""
LONGEST_DELAY = 0.02  # s, as of `Losses.latency`
STOPPED = 0.7
"""Share of a joint's momentum that Coulomb friction takes in a step near rest: all of it
could turn the motion round."""


class Motors(NamedTuple):
    """Numbers of the motors that a log can tell; arrays (3,) over abad, hip and knee."""

    torque_scale: Float[arrays.Array, "3"]  # of the torque that gains and limits say
    no_load_speed: Float[arrays.Array, "3"]  # rad/s
    friction: Float[arrays.Array, "3"]  # Nm, Coulomb's
    viscosity: Float[arrays.Array, "3"]  # Nm s/rad
    armature: Float[arrays.Array, "3"]  # kg m2, the rotor's inertia at the joint
    corner_share: Float[arrays.Array, "3"]  # corner speed over the no-load speed
    delay: Float[arrays.Array, "1"]  # s, from a target to its torque


class Windows(NamedTuple):
    """Recorded windows of free legs: arrays over rows, legs and windows."""

    step: Float[arrays.Array, ""]  # s, between rows
    q: Float[arrays.Array, "rows+1 4 W 3"]  # rad, from the start on
    q_target: Float[
        arrays.Array, "before+rows 4 W 3"
    ]  # rad, from `before` rows earlier on
    up: Float[arrays.Array, "rows 4 W 3"]
    spin: Float[arrays.Array, "rows 4 W 3"]  # rad/s
    turning: Float[arrays.Array, "rows 4 W 3"]  # rad/s2, the spin's derivative
    start: Float[arrays.Array, "4 W 6"]  # rad and rad/s, estimated angles and rates
    kept: Bool[arrays.Array, "4 W"]  # False of a window that fills up the array
    swing: Int[arrays.Array, "4 W"]  # index of the swing to which a window belongs


class Rig(NamedTuple):
    """A robot as the fit takes it."""

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
        substeps: integration steps between two rows.
    """
    corner = motors.corner_share * motors.no_load_speed
    limits = {"corner_speed": corner, "no_load_speed": motors.no_load_speed}
    drive = dataclasses.replace(rig.drive, **limits)
    springs = rig.design.armature[3:]
    design = dataclasses.replace(rig.design, armature=(*motors.armature, *springs))
    still = [jnp.zeros_like(start[..., 0])] * len(springs)

    def acceleration(q: Array, qd: Array, target: Array, trunk: list[Array]) -> Array:
        asked = pd_torque(drive, q, qd, target, jnp.zeros(()))
        torque = motors.torque_scale * jnp.clip(asked, *torque_limits(drive, qd))
        friction = motors.friction + rig.gear_loss * jnp.abs(torque)
        torque = torque - motors.viscosity * qd
        up, spin, turning = trunk
        return _free_acceleration(
            design,
            _parts(q) + still,
            _parts(qd) + still,
            _parts(torque) + still,
            friction,
            dt,
            up,
            spin,
            turning,
        )

    dt = windows.step / substeps
    rows, targets = len(windows.up), windows.q_target
    integral = jnp.concatenate([jnp.zeros_like(targets[:1]), jnp.cumsum(targets, 0)])

    def held_until(place: Array) -> Array:
        whole = jnp.clip(jnp.floor(place), 0, len(targets) - 1)
        i = whole.astype(int)
        return integral[i] + (place - whole) * targets[i]

    def row(
        state: tuple[Array, Array], now: list[Array]
    ) -> tuple[tuple[Array, Array], Array]:
        (q, qd), (place, *trunk) = state, now
        for i in range(substeps):
            begin = place + i / substeps
            target = substeps * (held_until(begin + 1.0 / substeps) - held_until(begin))
            middle = qd + 0.5 * dt * acceleration(q, qd, target, trunk)
            rate = acceleration(q + 0.5 * dt * qd, middle, target, trunk)
            q = q + dt * middle
            qd = qd + dt * rate
        return (q, qd), q

    late = len(targets) - rows - motors.delay[0] / windows.step
    recorded = [late + jnp.arange(rows), windows.up, windows.spin, windows.turning]
    return jax.lax.scan(row, (start[..., :3], start[..., 3:]), recorded)[1]


def _free_acceleration(
    design: Design,
    q: list[Number],
    qd: list[Number],
    torque: list[Number],
    friction: Array,
    dt: Array,
    up: Array,
    spin: Array,
    turning: Array,
) -> Array:
    """Return the accelerations of abad, hip and knee of legs that touch nothing; Coulomb
    friction does not turn a motion round within a step `dt`."""
    factors = jnp.ones((2 + 4 * len(design.links), 1))
    masses = Masses.of(design, factors, jnp.zeros((3, 1)))
    pose = RobotPose(_rotation(_vector(up)), Legs.of(design, masses, q))
    inertia = inertia_matrix(FusionBarriers(None), Robots(design, masses, 1.0), pose)
    velocity = GeneralizedVector([ZERO, ZERO, ZERO, *_vector(spin)], qd)
    applied = GeneralizedVector([ZERO] * 6, torque)
    force = smooth_force(design, masses, pose, q, velocity, applied).legs
    turned = pose.rotation.to_world(_vector(turning))
    free: list[Number] = []
    for i, row in enumerate(inertia.coupling[:3]):
        stopping = STOPPED * inertia.legs[i][i] * qd[i] / dt
        most = friction[..., i]
        held = most * jnp.tanh(stopping / (most + 1e-6))
        trunk = sum(
            coupled * turn for coupled, turn in zip(row[3:], turned, strict=True)
        )
        free.append(force[i] - held - trunk)
    rows = [
        jnp.stack(
            jnp.broadcast_arrays(
                *(inertia.legs[max(i, j)][min(i, j)] for j in range(3))
            ),
            -1,
        )
        for i in range(3)
    ]
    # LAPACK's solver also keeps XLA from compiling all of the step as one for minutes
    right = jnp.stack(free, -1)[..., None]
    return jnp.linalg.solve(jnp.stack(rows, -2), right)[..., 0]


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
