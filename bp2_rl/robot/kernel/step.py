"""One physics step: MuJoCo's semi-implicit Euler, with the joints' and springs' damping
implicit."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bp2_rl.robot.ground import Ground, Plane
from bp2_rl.robot.kernel.arrowhead import ArrowheadMatrix, GeneralizedVector, solve
from bp2_rl.robot.kernel.constraints import (
    Constraints,
    find_constraints,
    solve_constraints,
)
from bp2_rl.robot.kernel.design import TRUNK, Design, Masses, Robots
from bp2_rl.robot.kernel.equations import inertia_matrix, smooth_force
from bp2_rl.robot.kernel.fusion_barriers import FusionBarriers, in_one_kernel
from bp2_rl.robot.kernel.legs import Legs, RobotPose, Rotation
from bp2_rl.robot.kernel.vectors import ZERO, Number, Vector, add

Quaternion = tuple[Number, Number, Number, Number]


class MuJoCoState(NamedTuple):
    """The robots' state in MuJoCo's coordinates."""

    qpos: Float[Array, "nq N"]
    qvel: Float[Array, "nv N"]
    qacc_warmstart: Float[Array, "nv N"]


def step(
    robots: Robots,
    state: MuJoCoState,
    applied: Float[Array, "nv N"],
    ground: Ground | None = None,
) -> tuple[MuJoCoState, Float[Array, "4 N"]]:
    """Advance the robots by one physics step; return the state, and the distances of the
    feet's centres from the ground before the step, m.

    Args:
        robots: those that move.
        state: before the step.
        applied: forces on the coordinates (MuJoCo's `qfrc_applied`), the motors' among
            them, N and Nm.
        ground: that the robots run on, each of its numbers an array over them; None:
            the flat floor. A foot meets one plane of it.
    """
    after, heights = _step(robots, _RobotState.of(state), _split(applied), ground)
    return after.in_mujoco(), heights


class _RobotState(NamedTuple):
    """The robots' place, orientation, leg coordinates and velocities, each an array
    over robots."""

    place: Vector
    quaternion: Quaternion
    legs: list[Number]
    velocity: GeneralizedVector
    warmstart: GeneralizedVector

    @classmethod
    def of(cls, state: MuJoCoState) -> "_RobotState":
        qpos, qvel, warmstart = state
        place = (qpos[0], qpos[1], qpos[2])
        quaternion = (qpos[3], qpos[4], qpos[5], qpos[6])
        return cls(
            place,
            quaternion,
            _by_coordinate(qpos[TRUNK + 1 :]),
            _split(qvel),
            _split(warmstart),
        )

    def in_mujoco(self) -> MuJoCoState:
        qpos = jnp.concatenate(
            [jnp.stack([*self.place, *self.quaternion]), _leg_by_leg(self.legs)]
        )
        return MuJoCoState(qpos, _joined(self.velocity), _joined(self.warmstart))


def _step(
    robots: Robots,
    state: _RobotState,
    applied: GeneralizedVector,
    ground: Ground | None,
) -> tuple[_RobotState, Array]:
    barriers = FusionBarriers.of(robots.friction)
    pose, inertia, feet = in_one_kernel(
        partial(_pose_and_inertia, barriers, ground is not None), robots, state
    )
    # between the kernels, which take no table
    planes = None if ground is None or feet is None else ground.met_at(*feet)
    force, constraints, guess, heights = in_one_kernel(
        partial(_forces_and_constraints, barriers), robots, pose, state, applied, planes
    )
    acceleration = in_one_kernel(
        partial(solve_constraints, barriers), inertia, force, constraints, guess
    )
    after = in_one_kernel(
        partial(_advance, barriers),
        robots.design,
        inertia,
        pose.rotation,
        state,
        acceleration,
    )
    return after, heights


def _pose_and_inertia(
    barriers: FusionBarriers, on_ground: bool, robots: Robots, state: _RobotState
) -> tuple[RobotPose, ArrowheadMatrix, Vector | None]:
    """Return the robots' pose and mass matrix, and the places of their feet's centres
    where the ground asks for them."""
    pose = barriers(
        partial(_pose, robots.design), robots.masses, state.quaternion, state.legs
    )
    feet = None
    if on_ground:
        legs = pose.legs
        foot = add(robots.design.anchor, legs.to_trunk(legs.foot))
        feet = add(state.place, pose.rotation.to_world(foot))
    return pose, inertia_matrix(barriers, robots, pose), feet


def _forces_and_constraints(
    barriers: FusionBarriers,
    robots: Robots,
    pose: RobotPose,
    state: _RobotState,
    applied: GeneralizedVector,
    ground: Plane | None,
) -> tuple[GeneralizedVector, Constraints, GeneralizedVector, Array]:
    """Return the forces, the constraints, a first guess of the accelerations, and the
    distances of the feet's centres from the ground, m."""
    design, masses, friction = robots
    velocity = state.velocity
    height = state.place[2]
    force = barriers(
        partial(smooth_force, design), masses, pose, state.legs, velocity, applied
    )
    constraints, heights = barriers(
        partial(find_constraints, design),
        *(pose, friction, height, state.legs, velocity, ground),
    )
    return force, constraints, state.warmstart.in_world(pose.rotation), heights


def _advance(
    barriers: FusionBarriers,
    design: Design,
    inertia: ArrowheadMatrix,
    rotation: Rotation,
    state: _RobotState,
    acceleration: GeneralizedVector,
) -> _RobotState:
    """Return the state after a step with these accelerations, which are also the next
    step's first guess.

    The force in all, M x, moves M + dt C, for the damping C is implicit: by x - (M + dt
    C)^-1 dt C x.
    """
    steps = [design.timestep * damping for damping in design.damping]
    moved = acceleration
    if any(step is not ZERO for step in steps):
        rows = zip(inertia.legs, steps, strict=True)
        implicit = inertia._replace(
            legs=[[*row[:-1], row[-1] + step] for row, step in rows]
        )
        resisted = [step * x for step, x in zip(steps, acceleration.legs, strict=True)]
        less = solve(barriers, implicit, GeneralizedVector([ZERO] * TRUNK, resisted))
        moved = jax.tree.map(jnp.subtract, acceleration, less)
    after = barriers(
        partial(_integrated, design.timestep), state, moved.in_mujoco(rotation)
    )
    return after._replace(warmstart=acceleration.in_mujoco(rotation))


def _pose(
    design: Design, masses: Masses, quaternion: Quaternion, coordinates: list[Number]
) -> RobotPose:
    return RobotPose(
        Rotation.of(_unit(quaternion)), Legs.of(design, masses, coordinates)
    )


def _integrated(
    dt: Number, state: _RobotState, acceleration: GeneralizedVector
) -> _RobotState:
    """Return the state after a semi-implicit Euler step of `dt` seconds with this
    acceleration."""
    trunk = [
        v + dt * a
        for v, a in zip(state.velocity.trunk, acceleration.trunk, strict=True)
    ]
    legs = [
        v + dt * a for v, a in zip(state.velocity.legs, acceleration.legs, strict=True)
    ]
    (x, y, z), (vx, vy, vz, *spin) = state.place, trunk
    turn = dt * spin[0], dt * spin[1], dt * spin[2]
    return state._replace(
        place=(x + dt * vx, y + dt * vy, z + dt * vz),
        quaternion=_rotated(_unit(state.quaternion), turn),
        legs=[q + dt * v for q, v in zip(state.legs, legs, strict=True)],
        velocity=GeneralizedVector(trunk, legs),
    )


def _rotated(q: Quaternion, by: Vector) -> Quaternion:
    """Return a quaternion after a turn by a rotation vector, rad, in its own axes."""
    w, x, y, z = q
    angle = jnp.sqrt(by[0] * by[0] + by[1] * by[1] + by[2] * by[2])
    share = jnp.where(
        angle > 0.0, jnp.sin(0.5 * angle) / jnp.where(angle > 0.0, angle, 1.0), 0.5
    )
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


def _split(generalized: Float[Array, "nv N"]) -> GeneralizedVector:
    return GeneralizedVector(
        [generalized[i] for i in range(TRUNK)], _by_coordinate(generalized[TRUNK:])
    )


def _joined(x: GeneralizedVector) -> Float[Array, "nv N"]:
    return jnp.concatenate([jnp.stack(x.trunk), _leg_by_leg(x.legs)])


def _by_coordinate(coordinates: Float[Array, "n N"]) -> list[Number]:
    """Split the legs' numbers in MuJoCo's order into abad, hip, knee and, if there is
    one, spring, (4, N) each."""
    legs = coordinates.reshape(4, -1, coordinates.shape[-1])
    return [legs[:, i] for i in range(legs.shape[1])]


def _leg_by_leg(coordinates: list[Number]) -> Float[Array, "n N"]:
    """Join the legs' coordinates, (4, N) each, into one array in MuJoCo's order, leg by
    leg."""
    return jnp.stack(coordinates, axis=1).reshape(4 * len(coordinates), -1)
