"""The step itself: MuJoCo's semi-implicit Euler, with the springs' damping implicit."""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from bp2_rl.robot.kernel.constraints import Constraints, constraints_of, solve, solve_constraints
from bp2_rl.robot.kernel.design import LEG, TRUNK, Design
from bp2_rl.robot.kernel.equations import Accelerations, Arrow, inertia_matrix, smooth_force
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers, in_one_kernel
from bp2_rl.robot.kernel.legs import Legs, Masses, Rotation
from bp2_rl.robot.kernel.vectors import Number, Vector

Quaternion = tuple[Number, Number, Number, Number]


class Moving(NamedTuple):
    """The robots' state in MuJoCo's coordinates."""

    qpos: Float[Array, "23 N"]
    qvel: Float[Array, "22 N"]
    qacc_warmstart: Float[Array, "22 N"]


def step(
    design: Design, masses: Masses, friction: Float[Array, " N"], state: Moving, applied: Float[Array, "22 N"]
) -> tuple[Moving, Float[Array, "4 N"]]:
    """One step of `design.timestep`: (the state after it, the heights of the feet's centres before it, m).

    Args:
        design: BP2.
        masses: of these robots.
        friction: of the floor under them.
        state: before the step.
        applied: forces on the coordinates (MuJoCo's `qfrc_applied`), the motors' among them, N and Nm.
    """
    after, heights = _step(design, masses, friction, _RobotState.of(state), _split(applied))
    return after.moving(), heights


class _RobotState(NamedTuple):
    """The state of the robots, number by number."""

    place: Vector
    quaternion: Quaternion
    legs: list[Number]
    velocity: Accelerations
    warmstart: Accelerations

    @classmethod
    def of(cls, moving: Moving) -> "_RobotState":
        qpos, qvel, warmstart = moving
        place, quaternion = (qpos[0], qpos[1], qpos[2]), (qpos[3], qpos[4], qpos[5], qpos[6])
        return cls(place, quaternion, _of_legs(qpos[TRUNK + 1 :]), _split(qvel), _split(warmstart))

    def moving(self) -> Moving:
        qpos = jnp.concatenate([jnp.stack([*self.place, *self.quaternion]), _leg_by_leg(self.legs)])
        return Moving(qpos, _joined(self.velocity), _joined(self.warmstart))


def _step(
    design: Design, masses: Masses, friction: Number, state: _RobotState, applied: Accelerations
) -> tuple[_RobotState, Array]:
    barriers = FusionBarriers.of(friction)
    rotation, legs, inertia = in_one_kernel(partial(_posed, barriers), design, masses, state)
    force, constraints, start, heights = in_one_kernel(
        partial(_acted_on, barriers), design, masses, friction, legs, rotation, state, applied
    )
    acceleration, total = in_one_kernel(partial(solve_constraints, barriers), inertia, force, constraints, start)
    after = in_one_kernel(partial(_moved, barriers), design, inertia, rotation, state, acceleration, total)
    return after, heights


def _posed(
    barriers: FusionBarriers, design: Design, masses: Masses, state: _RobotState
) -> tuple[Rotation, Legs, Arrow]:
    """Where everything is, and its inertia."""
    rotation, legs = barriers(partial(_pose, design), masses, state.quaternion, state.legs)
    return rotation, legs, inertia_matrix(barriers, design, masses, legs, rotation)


def _acted_on(
    barriers: FusionBarriers,
    design: Design,
    masses: Masses,
    friction: Number,
    legs: Legs,
    rotation: Rotation,
    state: _RobotState,
    applied: Accelerations,
) -> tuple[Accelerations, Constraints, Accelerations, Array]:
    """The forces, the constraints, a first guess of the accelerations, and the heights of the feet."""
    velocity = state.velocity
    force = barriers(partial(smooth_force, design), masses, legs, rotation, state.legs[3], velocity, applied)
    constraints, heights = barriers(
        partial(constraints_of, design), legs, rotation, friction, state.place[2], state.legs, velocity
    )
    return force, constraints, state.warmstart.in_world(rotation), heights


def _moved(
    barriers: FusionBarriers,
    design: Design,
    inertia: Arrow,
    rotation: Rotation,
    state: _RobotState,
    acceleration: Accelerations,
    total: Accelerations,
) -> _RobotState:
    """The state after the step under these forces in all; the next starts from these accelerations."""
    damped = solve(barriers, _damped(inertia, design), total)
    after = barriers(partial(_integrated, design.timestep), state, damped.in_mujoco(rotation))
    return after._replace(warmstart=acceleration.in_mujoco(rotation))


def _pose(design: Design, masses: Masses, quaternion: Quaternion, coordinates: list[Number]) -> tuple[Rotation, Legs]:
    return Rotation.of(_unit(quaternion)), Legs.of(design, masses, coordinates)


def _damped(inertia: Arrow, design: Design) -> Arrow:
    """The matrix of the implicit step."""
    *others, spring = inertia.legs
    return inertia._replace(legs=[*others, [*spring[:3], spring[3] + design.timestep * design.spring[1]]])


def _integrated(dt: float, state: _RobotState, acceleration: Accelerations) -> _RobotState:
    """The state after the step."""
    trunk = [v + dt * a for v, a in zip(state.velocity.trunk, acceleration.trunk, strict=True)]
    legs = [v + dt * a for v, a in zip(state.velocity.legs, acceleration.legs, strict=True)]
    (x, y, z), (vx, vy, vz, *spin) = state.place, trunk
    turn = dt * spin[0], dt * spin[1], dt * spin[2]
    return state._replace(
        place=(x + dt * vx, y + dt * vy, z + dt * vz),
        quaternion=_turned(_unit(state.quaternion), turn),
        legs=[q + dt * v for q, v in zip(state.legs, legs, strict=True)],
        velocity=Accelerations(trunk, legs),
    )


def _turned(q: Quaternion, by: Vector) -> Quaternion:
    """The orientation after a turn by a vector, rad, in its own axes."""
    w, x, y, z = q
    angle = jnp.sqrt(by[0] * by[0] + by[1] * by[1] + by[2] * by[2])
    share = jnp.where(angle > 0.0, jnp.sin(0.5 * angle) / jnp.where(angle > 0.0, angle, 1.0), 0.5)
    c, i, j, k = jnp.cos(0.5 * angle), share * by[0], share * by[1], share * by[2]
    return (
        w * c - x * i - y * j - z * k,
        w * i + x * c + y * k - z * j,
        w * j - x * k + y * c + z * i,
        w * k + x * j - y * i + z * c,
    )


def _unit(quaternion: Quaternion) -> Quaternion:
    w, x, y, z = quaternion
    scale = 1.0 / jnp.sqrt(w * w + x * x + y * y + z * z)
    return scale * w, scale * x, scale * y, scale * z


def _split(generalized: Float[Array, "22 N"]) -> Accelerations:
    return Accelerations([generalized[i] for i in range(TRUNK)], _of_legs(generalized[TRUNK:]))


def _joined(x: Accelerations) -> Float[Array, "22 N"]:
    return jnp.concatenate([jnp.stack(x.trunk), _leg_by_leg(x.legs)])


def _of_legs(coordinates: Float[Array, "16 N"]) -> list[Number]:
    """Abduction, hip, knee and spring of all legs, (4, N) each, from MuJoCo's order."""
    legs = coordinates.reshape(LEG, LEG, -1)
    return [legs[:, i] for i in range(LEG)]


def _leg_by_leg(coordinates: list[Number]) -> Float[Array, "16 N"]:
    """Return coordinates given number by number as one array, leg by leg."""
    return jnp.stack(coordinates, axis=1).reshape(LEG * LEG, -1)
