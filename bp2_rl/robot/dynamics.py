"""One physics step of BP2 in MJX-JAX, with a constraint solver that knows how the robot is built.

`step` is `mjx.step` but for the solver. Both minimise MuJoCo's convex cost over accelerations by Newton's method,

    1/2 x' M x - x' f + sum over rows D/2 min(J x - aref, 0)^2,

so both end at the same place; two facts make this one cost next to nothing:

- Legs meet in the trunk alone, and a foot's contact with the floor moves its own leg and the trunk. So the Hessian is
  an arrow: four 4 x 4 blocks with a border of the trunk's 6 coordinates, instead of a dense 22 x 22 matrix.
- Along a search direction the slope of the cost is increasing and piecewise linear, so its root is exact: it lies
  between two of the kinks, where a row's force sets in or vanishes. Newton needs fewer and cheaper iterations.

What it saves is in docs/notes/speed.md.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.robot.mjx import mjx
from bp2_rl.robot.specs import LEGS

TRUNK, LEG = 6, 4  # coordinates of the trunk and of a leg: abad, hip, knee, spring
NUM_LEGS = len(LEGS)
LIMITS, EDGES = 3, 4  # constraint rows of a leg: its joint limits, and the edges of its contact's friction pyramid

_leg = np.arange(NUM_LEGS)[:, None]
# MJX puts the joint limits first, in the order of the joints, then the contacts in that of the feet.
ROWS = np.concatenate([LIMITS * _leg + np.arange(LIMITS), LIMITS * NUM_LEGS + EDGES * _leg + np.arange(EDGES)], axis=1)
COLUMNS = np.concatenate([np.tile(np.arange(TRUNK), (NUM_LEGS, 1)), TRUNK + LEG * _leg + np.arange(LEG)], axis=1)


class Arrow(struct.PyTreeNode):
    """A symmetric matrix (22, 22) whose legs are coupled through the trunk alone."""

    trunk: Float[Array, "6 6"]
    coupling: Float[Array, "4 4 6"]  # leg, its coordinate, the trunk's
    legs: Float[Array, "4 4 4"]


class Rows(struct.PyTreeNode):
    """The constraints, leg by leg: each can only push, with the force -D min(J x - aref, 0) at acceleration x."""

    jacobian: Float[Array, "4 7 10"]  # by the trunk's coordinates, then the leg's
    stiffness: Float[Array, "4 7"]  # D
    reference: Float[Array, "4 7"]  # aref


def step(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """One step of `model.opt.timestep` under the torques `data.ctrl`, with MJX's Euler integrator; one robot.

    For BP2 on flat ground with feet as its only contacts (`load_model(feet_only=True)`). Of external forces only those
    in `data.qfrc_applied` count.
    """
    data = mjx.fwd_actuation(model, mjx.fwd_velocity(model, mjx.fwd_position(model, data)))
    inertia, force = arrow(mjx.full_m(model, data)), data.qfrc_passive - data.qfrc_bias + data.qfrc_actuator
    force += data.qfrc_applied
    acceleration, push = newton(inertia, constraint_rows(data), force, data.qacc_warmstart, model.opt.iterations)
    # Damping is integrated implicitly, as by MuJoCo's Euler integrator; only the legs have any.
    damping = model.opt.timestep * model.dof_damping[TRUNK:].reshape(NUM_LEGS, LEG)
    damped = inertia.replace(legs=inertia.legs + damping[..., None] * jnp.eye(LEG))
    no_damping = model.opt.disableflags | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    explicit = model.tree_replace({"opt.disableflags": no_damping})
    data = mjx.euler(explicit, data.replace(qacc=solve(damped, force + push)))
    return data.replace(qacc=acceleration, qacc_warmstart=acceleration, qfrc_constraint=push)


def newton(
    inertia: Arrow, rows: Rows, force: Float[Array, "22"], start: Float[Array, "22"], iterations: int
) -> tuple[Float[Array, "22"], Float[Array, "22"]]:
    """Acceleration under `force` and the constraints, and the constraints' own force on the coordinates.

    `start` is a first guess, say the acceleration of the step before. A few iterations reach what float32 resolves.
    """

    def iterate(_: Array | int, at: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        x, inertial, gap = at  # x, M x and J x - aref
        active = jnp.where(gap < 0, rows.stiffness, 0.0)
        gradient = inertial - force + _transposed(rows, active * gap)
        direction = -solve(_hessian(inertia, rows, active), gradient)
        inertial_step, gap_step = multiply(inertia, direction), _along(rows, direction)
        slope = jnp.sum(direction * (inertial - force)), jnp.sum(direction * inertial_step)
        share = exact_line_search(*slope, gap.ravel(), gap_step.ravel(), rows.stiffness.ravel())
        return x + share * direction, inertial + share * inertial_step, gap + share * gap_step

    first = start, multiply(inertia, start), _along(rows, start) - rows.reference
    x, _, gap = jax.lax.fori_loop(0, iterations, iterate, first)
    return x, _transposed(rows, -rows.stiffness * jnp.minimum(gap, 0.0))


def exact_line_search(
    slope: Float[Array, ""],
    curvature: Float[Array, ""],
    gap: Float[Array, " rows"],
    change: Float[Array, " rows"],
    stiffness: Float[Array, " rows"],
) -> Float[Array, ""]:
    """The a >= 0 that minimises slope a + curvature a^2 / 2 + sum stiffness / 2 min(gap + a change, 0)^2.

    0 where there is no way down: the search is then at its end.
    """

    def slope_at(a: Float[Array, "..."]) -> Float[Array, "..."]:
        gaps = gap + a[..., None] * change
        return slope + curvature * a + jnp.sum(stiffness * change * jnp.minimum(gaps, 0.0), axis=-1)

    kinks = -gap / jnp.where(change == 0, 1.0, change)
    kinks = jnp.where((change != 0) & (kinks > 0), kinks, 0.0)
    before = jnp.max(jnp.where(slope_at(kinks) <= 0, kinks, 0.0))
    after = jnp.min(jnp.where(kinks > before, kinks, jnp.inf))
    within = jnp.where(jnp.isfinite(after), (before + after) / 2, before + 1.0)
    active = jnp.where(gap + within * change < 0, stiffness * change, 0.0)
    downhill, steepening = -slope - jnp.sum(active * gap), curvature + jnp.sum(active * change)
    return jnp.where(steepening > 0, downhill / jnp.where(steepening > 0, steepening, 1.0), 0.0)


# --- Linear algebra of arrows ----------------------------------------------------------------------------------------


def arrow(dense: Float[Array, "22 22"]) -> Arrow:
    """The matrix by its parts; couplings between legs are left out."""
    legs = dense[TRUNK:, TRUNK:].reshape(NUM_LEGS, LEG, NUM_LEGS, LEG)
    return Arrow(
        trunk=dense[:TRUNK, :TRUNK],
        coupling=dense[TRUNK:, :TRUNK].reshape(NUM_LEGS, LEG, TRUNK),
        legs=jnp.stack([legs[leg, :, leg] for leg in range(NUM_LEGS)]),
    )


def multiply(matrix: Arrow, vector: Float[Array, "22"]) -> Float[Array, "22"]:
    """Matrix times vector."""
    trunk, legs = _parts(vector)
    along_trunk = jnp.sum(matrix.trunk * trunk, axis=-1) + jnp.sum(matrix.coupling * legs[..., None], axis=(0, 1))
    along_legs = jnp.sum(matrix.coupling * trunk, axis=-1) + jnp.sum(matrix.legs * legs[:, None], axis=-1)
    return _whole(along_trunk, along_legs)


def solve(matrix: Arrow, vector: Float[Array, "22"]) -> Float[Array, "22"]:
    """x of matrix x = vector, for a positive definite matrix: Cholesky with the legs first, the trunk last.

    Written out over coordinates, which the compiler fuses; batched library calls on such small matrices wait on memory.
    """
    trunk, legs = _parts(vector)
    factor = _cholesky(matrix.legs)
    # Right-hand sides of the legs: the coupling's columns, and the vector.
    border = _forward(factor, list(jnp.moveaxis(jnp.concatenate([matrix.coupling, legs[..., None]], axis=-1), 1, 0)))
    schur = jnp.concatenate([matrix.trunk, trunk[:, None]], axis=-1)
    schur -= jnp.sum(sum(row[:, :TRUNK, None] * row[:, None, :] for row in border), axis=0)  # pyright: ignore
    trunk_factor = _cholesky(schur[:, :TRUNK])
    trunk = jnp.stack(_backward(trunk_factor, _forward(trunk_factor, list(schur[:, TRUNK]))))
    remainder = [row[:, TRUNK] - jnp.sum(row[:, :TRUNK] * trunk, axis=-1) for row in border]
    return _whole(trunk, jnp.stack(_backward(factor, remainder), axis=-1))


def _cholesky(matrix: Float[Array, "*batch n n"]) -> list[list[Array]]:
    """The lower factor by rows of its entries, each over the batch; the diagonal holds the reciprocals."""
    factor: list[list[Array]] = []
    for i in range(matrix.shape[-1]):
        row: list[Array] = []
        for j in range(i):
            rest = matrix[..., i, j] - sum(row[k] * factor[j][k] for k in range(j))
            row.append(rest * factor[j][j])
        row.append(jax.lax.rsqrt(matrix[..., i, i] - sum(entry * entry for entry in row)))
        factor.append(row)
    return factor


def _forward(factor: list[list[Array]], vector: list[Array]) -> list[Array]:
    """y of L y = vector; an entry may have more axes than the batch, which hold several right-hand sides."""
    out: list[Array] = []
    for i, entry in enumerate(vector):
        row = [jnp.expand_dims(x, range(x.ndim, entry.ndim)) for x in factor[i]]
        out.append((entry - sum(row[k] * out[k] for k in range(i))) * row[i])
    return out


def _backward(factor: list[list[Array]], vector: list[Array]) -> list[Array]:
    """x of L' x = vector."""
    out: dict[int, Array] = {}
    for i in reversed(range(len(vector))):
        out[i] = (vector[i] - sum(factor[k][i] * out[k] for k in out)) * factor[i][i]
    return [out[i] for i in range(len(vector))]


# --- Constraints -----------------------------------------------------------------------------------------------------


def constraint_rows(data: mjx.Data) -> Rows:
    """MJX's constraints at the present state."""
    efc = data._impl
    return Rows(
        jacobian=efc.efc_J[ROWS[:, :, None], COLUMNS[:, None, :]],  # pyright: ignore
        stiffness=efc.efc_D[ROWS],  # pyright: ignore
        reference=efc.efc_aref[ROWS],  # pyright: ignore
    )


def _hessian(inertia: Arrow, rows: Rows, active: Float[Array, "4 7"]) -> Arrow:
    """M + J' diag(active) J."""
    scaled = rows.jacobian * active[..., None]
    outer = jnp.sum(rows.jacobian[..., :, None] * scaled[..., None, :], axis=1)
    return Arrow(
        trunk=inertia.trunk + jnp.sum(outer[:, :TRUNK, :TRUNK], axis=0),
        coupling=inertia.coupling + outer[:, TRUNK:, :TRUNK],
        legs=inertia.legs + outer[:, TRUNK:, TRUNK:],
    )


def _along(rows: Rows, vector: Float[Array, "22"]) -> Float[Array, "4 7"]:
    """J x."""
    trunk, legs = _parts(vector)
    return jnp.sum(rows.jacobian[..., :TRUNK] * trunk, -1) + jnp.sum(rows.jacobian[..., TRUNK:] * legs[:, None], -1)


def _transposed(rows: Rows, forces: Float[Array, "4 7"]) -> Float[Array, "22"]:
    """J' f."""
    pushes = jnp.sum(rows.jacobian * forces[..., None], axis=1)
    return _whole(jnp.sum(pushes[:, :TRUNK], axis=0), pushes[:, TRUNK:])


def _parts(vector: Float[Array, "22"]) -> tuple[Float[Array, "6"], Float[Array, "4 4"]]:
    return vector[:TRUNK], vector[TRUNK:].reshape(NUM_LEGS, LEG)


def _whole(trunk: Float[Array, "6"], legs: Float[Array, "4 4"]) -> Float[Array, "22"]:
    return jnp.concatenate([trunk, legs.ravel()])
