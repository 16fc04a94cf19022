"""The constraint solver of training: its parts against NumPy and SciPy, its steps against C MuJoCo."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from landing import DT, converged, land_on_mjx, land_on_mujoco, landing, random_states
from mujoco import mjx
from scipy.optimize import minimize_scalar

from bp2_rl.robot import dynamics, specs
from bp2_rl.robot.model import NV, load_model

LEG_OF_DOF = np.array([-1] * 6 + [0] * 4 + [1] * 4 + [2] * 4 + [3] * 4)


def random_arrow(rng: np.random.Generator) -> np.ndarray:
    """A positive definite matrix in which legs meet in the trunk alone."""
    matrix = np.zeros((NV, NV))
    for leg in range(4):
        part = np.flatnonzero((leg == LEG_OF_DOF) | (LEG_OF_DOF < 0))
        root = rng.normal(size=(10, 12))
        matrix[np.ix_(part, part)] += root @ root.T
    return matrix


def test_an_arrow_multiplies_and_solves_as_its_dense_matrix():
    rng = np.random.default_rng(0)
    matrices, vectors = np.stack([random_arrow(rng) for _ in range(50)]), rng.normal(size=(50, NV))
    arrows = jax.vmap(dynamics.arrow)(jnp.asarray(matrices, jnp.float32))
    products = jax.jit(jax.vmap(dynamics.multiply))(arrows, jnp.asarray(vectors, jnp.float32))
    solutions = jax.jit(jax.vmap(dynamics.solve))(arrows, jnp.asarray(vectors, jnp.float32))
    np.testing.assert_allclose(products, np.einsum("nij,nj->ni", matrices, vectors), atol=1e-4)
    # Conditions up to some thousands times float32's 6e-8.
    expected = np.linalg.solve(matrices, vectors[..., None])[..., 0]
    scale = abs(expected).max(axis=1)[:, None]
    np.testing.assert_allclose(solutions / scale, expected / scale, atol=1e-3)
    assert np.median(abs(solutions - expected).max(axis=1) / scale[:, 0]) < 1e-5


def test_the_line_search_finds_the_minimum():
    """Of random piecewise quadratics, with and without kinks on the way, against SciPy's bounded search."""
    rng, beyond = np.random.default_rng(0), []
    search = jax.jit(dynamics.exact_line_search)
    for _ in range(200):
        gap, change, stiffness = rng.normal(size=28), rng.normal(size=28), 10.0 ** rng.uniform(-1, 3, 28)
        change[rng.random(28) < 0.2] = 0.0
        curvature = 10.0 ** rng.uniform(-1, 3)
        slope = -(10.0 ** rng.uniform(-1, 4)) - np.sum(stiffness * change * np.minimum(gap, 0))

        def cost(a, slope=slope, curvature=curvature, gap=gap, change=change, stiffness=stiffness):
            return slope * a + curvature * a * a / 2 + np.sum(stiffness / 2 * np.minimum(gap + a * change, 0) ** 2)

        found = float(search(*(jnp.asarray(x, jnp.float32) for x in (slope, curvature, gap, change, stiffness))))
        best: Any = minimize_scalar(cost, bounds=(0, 1e5), method="bounded", options={"xatol": 1e-9, "maxiter": 1000})
        beyond.append((change != 0) & (-gap / np.where(change == 0, 1, change) > 0) & (-gap < found * change))
        # float32 of sums of thousands; relative to the way down from a = 0.
        assert cost(found) - best.fun <= 1e-4 * (cost(0) - best.fun)
    assert np.mean([kinks.any() for kinks in beyond]) > 0.5


def test_the_line_search_stays_where_there_is_no_way_down():
    nothing = jnp.zeros(28)
    assert float(dynamics.exact_line_search(jnp.zeros(()), jnp.zeros(()), nothing, nothing, nothing)) == 0.0


@pytest.fixture(scope="module")
def states() -> list[np.ndarray]:
    """States (qpos, qvel, torque) with zero to four feet on the ground and joints beyond their limits."""
    return [x.astype(np.float32) for x in random_states(np.random.default_rng(0), 200, thrown=0.0)]


@functools.cache
def stepped(iterations: int):
    """One robot's step on MJX from rest's warm start: (acceleration, velocity after, position after, Jacobian)."""
    mujoco_model = load_model(visual=False, feet_only=True)
    mujoco_model.opt.iterations = iterations
    model = mjx.put_model(mujoco_model)
    blank = mjx.make_data(model)

    @jax.jit
    @jax.vmap
    def run(qpos, qvel, torque):
        data = dynamics.step(model, blank.replace(qpos=qpos, qvel=qvel, ctrl=torque))
        return data.qacc, data.qvel, data.qpos, data._impl.efc_J  # pyright: ignore

    return run


def test_one_step_is_that_of_c_mujoco(states):
    """Accelerations to 1e-4 of each state's largest, C MuJoCo's solver converged in float64; then the step itself."""
    with jax.default_matmul_precision("highest"):
        accelerations, velocities, positions, _ = map(np.asarray, stepped(5)(*states))
    model = converged(load_model(visual=False, feet_only=True))
    data, feet, limits = mujoco.MjData(model), [], []
    for i, (qpos, qvel, torque) in enumerate(zip(*states, strict=True)):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.ctrl = qpos, qvel, torque
        mujoco.mj_step(model, data)
        feet.append(data.ncon)
        limits.append(np.sum(data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT))
        largest = abs(data.qacc).max()
        np.testing.assert_allclose(accelerations[i], data.qacc, rtol=0, atol=1e-4 * largest)
        np.testing.assert_allclose(velocities[i], data.qvel, rtol=0, atol=1e-4 * largest * DT + 1e-5)
        np.testing.assert_allclose(positions[i], data.qpos, rtol=0, atol=1e-6)
    assert all(np.bincount(feet, minlength=5) > 5)
    assert np.sum(limits) > 20


def test_no_constraint_reaches_beyond_its_leg_and_the_trunk(states):
    """All of MJX's Jacobian is in the rows and columns that the solver takes."""
    with jax.default_matmul_precision("highest"):
        jacobian = np.array(stepped(5)(*states)[-1])
    rows = 4 * len(specs.LEGS) + specs.NUM_MOTORS
    assert jacobian.shape[1:] == (rows, NV)
    assert (abs(jacobian).max(axis=(0, 2)) > 0).sum() > rows / 2  # most constraints occur in these states
    for own_rows, own_columns in zip(dynamics.ROWS, dynamics.COLUMNS, strict=True):
        jacobian[:, own_rows[:, None], own_columns] = 0.0
    assert not jacobian.any()


def test_touchdowns_at_10_m_per_s_are_those_of_c_mujoco():
    """Trunk and feet over 150 ms, to 1e-3 m; with the model's own iterations, C MuJoCo converged in float64."""
    start = landing(robots=16)
    on_mjx = land_on_mjx(load_model(visual=False, feet_only=True), start, dynamics.step)
    on_mujoco = land_on_mujoco(converged(load_model(visual=False)), start)
    depth = specs.FOOT_RADIUS - on_mujoco[:, :, 1:, 2]
    assert (depth.max(axis=1) > 0.0).mean() > 0.9
    np.testing.assert_allclose(on_mjx, on_mujoco, atol=1e-3, rtol=0)
