"""The step itself: MuJoCo's semi-implicit Euler, with the springs' damping implicit."""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from bp2_rl.robot.kernel.constraints import constraints_of, solve, solve_constraints
from bp2_rl.robot.kernel.design import TRUNK, Design
from bp2_rl.robot.kernel.equations import Accelerations, Arrow, inertia_matrix, smooth_force
from bp2_rl.robot.kernel.legs import Legs, Masses, Rotation
from bp2_rl.robot.kernel.vectors import Number, Pieces

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
    pieces, (qpos, qvel, warmstart) = Pieces.of(friction), state
    rotation, legs = pieces(partial(_pose, design), masses, qpos)
    inertia = inertia_matrix(pieces, design, masses, legs, rotation)
    force = pieces(partial(smooth_force, design), masses, legs, rotation, qpos, qvel, applied)
    constraints, heights = pieces(partial(constraints_of, design), legs, rotation, friction, qpos, qvel)
    start = Accelerations.of(warmstart, rotation)
    acceleration, total = solve_constraints(pieces, inertia, force, constraints, start)
    damped = solve(pieces, _damped(inertia, design), total)
    return pieces(partial(_integrated, design), state, rotation, acceleration, damped), heights


def _pose(design: Design, masses: Masses, qpos: Float[Array, "23 N"]) -> tuple[Rotation, Legs]:
    return Rotation.of(_unit(qpos)), Legs.of(design, masses, qpos[TRUNK + 1 :])


def _damped(inertia: Arrow, design: Design) -> Arrow:
    """The matrix of the implicit step."""
    *others, spring = inertia.legs
    return inertia._replace(legs=[*others, [*spring[:3], spring[3] + design.timestep * design.spring[1]]])


def _integrated(
    design: Design, state: Moving, rotation: Rotation, acceleration: Accelerations, damped: Accelerations
) -> Moving:
    """The state after the step: the solver's `acceleration` is kept to start from, the `damped` one acts."""
    qvel = state.qvel + design.timestep * damped.generalized(rotation)
    place = state.qpos[:3] + design.timestep * qvel[:3]
    joints = state.qpos[TRUNK + 1 :] + design.timestep * qvel[TRUNK:]
    turned = jnp.stack(_turned(_unit(state.qpos), design.timestep * qvel[3:TRUNK]))
    return Moving(jnp.concatenate([place, turned, joints]), qvel, acceleration.generalized(rotation))


def _turned(q: Quaternion, by: Float[Array, "3 N"]) -> Quaternion:
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


def _unit(qpos: Float[Array, "23 N"]) -> Quaternion:
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    scale = 1.0 / jnp.sqrt(w * w + x * x + y * y + z * z)
    return scale * w, scale * x, scale * y, scale * z
