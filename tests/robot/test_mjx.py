"""MJX's step beside C MuJoCo's, on the model of training."""

import functools

import jax
import mujoco
import numpy as np
import pytest
from landing import DT, converged, random_states
from mujoco import mjx

from bp2_rl.robot.model import SPRING_QPOS, load_model


@pytest.fixture(scope="module")
def states() -> list[np.ndarray]:
    """Return states (qpos, qvel, torque) with zero to four feet on the ground and
    joints beyond their limits."""
    return [
        x.astype(np.float32)
        for x in random_states(np.random.default_rng(0), 200, thrown=0.0)
    ]


@functools.cache
def stepped():
    """One robot's step on MJX from rest's warm start: (acceleration, velocity after,
    position after, passive force)."""
    model = mjx.put_model(load_model(visual=False, feet_only=True))
    blank = mjx.make_data(model)

    @jax.jit
    @jax.vmap
    def run(qpos, qvel, torque):
        data = mjx.step(model, blank.replace(qpos=qpos, qvel=qvel, ctrl=torque))
        return data.qacc, data.qvel, data.qpos, data.qfrc_passive

    return run


def test_one_step_is_that_of_c_mujoco(states):
    """Accelerations to 1e-4 of each state's largest, then the step, with the model's
    own few iterations."""
    with jax.default_matmul_precision("highest"):
        found = map(np.asarray, stepped()(*states))
    accelerations, velocities, positions, passive = found
    model = converged(load_model(visual=False, feet_only=True))
    data, feet, limits = mujoco.MjData(model), [], []
    for i, (qpos, qvel, torque) in enumerate(zip(*states, strict=True)):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.ctrl = qpos, qvel, torque
        mujoco.mj_step(model, data)
        feet.append(data.ncon)
        limits.append(np.sum(data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT))
        largest = abs(data.qacc).max()
        np.testing.assert_allclose(
            accelerations[i], data.qacc, rtol=0, atol=1e-4 * largest
        )
        np.testing.assert_allclose(
            velocities[i], data.qvel, rtol=0, atol=1e-4 * largest * DT + 1e-5
        )
        np.testing.assert_allclose(positions[i], data.qpos, rtol=0, atol=1e-6)
        # 36 kN/m x float32's 1e-8 m, damping's 1e-6
        np.testing.assert_allclose(passive[i], data.qfrc_passive, rtol=0, atol=0.02)
    assert all(np.bincount(feet, minlength=5) > 5)
    assert np.sum(limits) > 20
    compressions = states[0][:, SPRING_QPOS]  # beyond both stops
    assert np.min(compressions) < 0.0 < 0.13 < np.max(compressions)
