"""Ground that is not flat, in the environment: where episodes start on it, what is
measured from it, and what the critic sees."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.env import observations, randomization
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import SOLE_SITES, load_model
from bp2_rl.settings.env import EnvConfig, Impl, RandomizationConfig
from bp2_rl.settings.terrain import TerrainConfig

KEYS = jax.random.split(jax.random.PRNGKey(0), 64)
NOMINAL = randomization.nominal(18, BUILT)
CALM = RandomizationConfig(enabled=False)


def env_on(kind, size, impl: Impl = "kernel", slope=0.0):
    terrain = TerrainConfig(kind, (size, size), slope=(slope, slope))
    config = EnvConfig(hardware=BUILT, terrain=terrain, randomization=CALM)
    return BP2Env(dataclasses.replace(config, reference="kinematic"), impl=impl)


@pytest.fixture(scope="module")
def rough():
    return env_on("rough", 0.06)


@pytest.fixture(scope="module")
def starts(rough):
    return jax.jit(jax.vmap(rough.reset))(KEYS)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_ground_grows_with_the_curriculum_level(level):
    """A slope by its angle, whichever way it rises."""
    draw = jax.vmap(randomization.with_terrain, (0, None, None, None))
    config = TerrainConfig("rough", (0.1, 0.2), slope=(0.1, 0.2))
    drawn = draw(KEYS, NOMINAL, config, jnp.asarray(level))
    assert drawn.ground is not None
    x, y, z = np.asarray(drawn.gravity).T / -GRAVITY
    for size in (drawn.ground.amplitude, np.arctan2(np.hypot(x, y), z)):
        assert 0.1 - 1e-5 < np.min(size) < 0.1 + 0.02 * level + 1e-5
        assert 0.1 + 0.08 * level - 1e-5 < np.max(size) < 0.1 + 0.1 * level + 1e-5


def test_an_episode_starts_with_its_lowest_sole_where_it_would_be_on_the_flat(
    rough, starts
):
    """By C MuJoCo's places of the soles; a flat start is the same pose, not set down."""
    flat = jax.jit(jax.vmap(env_on("flat", 0.0).reset))(KEYS).pipeline_state.q
    model = load_model(BUILT)
    data, sites = mujoco.MjData(model), [model.site(name).id for name in SOLE_SITES]
    episode = starts.pipeline_state
    raised = np.asarray(episode.q - flat)
    assert not raised[:, :2].any()
    assert not raised[:, 3:].any()
    assert raised[:, 2].min() < -0.01 < 0.02 < raised[:, 2].max()
    for i, poses in enumerate(
        zip(np.asarray(flat), np.asarray(episode.q), strict=True)
    ):
        ground = jax.tree.map(lambda x, i=i: x[i], episode.randomization.ground)
        lowest = []
        for pose, amplitude in zip(poses, (0.0, ground.amplitude), strict=True):
            data.qpos = pose
            mujoco.mj_kinematics(model, data)
            x, y, z = jnp.asarray(data.site_xpos[sites].T)
            below = ground.replace(amplitude=amplitude).below(x, y).height
            lowest.append(float(jnp.min(z - below)))
        assert lowest[0] == pytest.approx(lowest[1], abs=1e-5)


def test_height_and_falls_are_measured_from_the_ground_below(rough, starts):
    state = jax.tree.map(lambda x: x[0], starts)
    episode = state.pipeline_state
    ground = episode.randomization.ground
    below = float(ground.below(*episode.q[:2]).height)
    seen = observations.PRIVILEGED[1].read(
        observations.Unsensed(episode, jnp.zeros(3), jnp.zeros(4), jnp.ones(()))
    )
    assert float(seen) == pytest.approx(float(episode.q[2]) - below, abs=1e-6)
    for over, fallen in ((0.25, 1.0), (0.45, 0.0)):
        physics = episode.physics
        moved = physics.replace(qpos=physics.qpos.at[2].set(below + over))
        there = dataclasses.replace(
            state, pipeline_state=episode.replace(physics=moved)
        )
        assert jax.jit(rough.step)(there, jnp.zeros(12)).done == fallen


def test_the_critic_sees_the_ground_under_and_ahead_of_the_robot(rough, starts):
    """In the mirror image left and right of the ground are exchanged."""
    episode = jax.tree.map(lambda x: x[3], starts.pipeline_state)
    entry = observations.privileged_of(rough.config)[-1]
    seen = np.asarray(starts.obs["privileged_state"][3, -15:])
    ground, (x, y) = episode.randomization.ground, episode.q[:2]
    ahead = ground.below(x + 0.8, y + 0.2).height - ground.below(x, y).height
    assert seen[3 * 3 + 2] == pytest.approx(float(ahead), abs=1e-5)
    image = seen[list(entry.mirror.order)] * entry.mirror.sign
    np.testing.assert_array_equal(image, seen.reshape(5, 3)[:, ::-1].ravel())


def test_on_a_slope_kernel_and_mjx_take_the_same_step():
    """Accelerations to 1e-3: MJX's solver takes few iterations."""
    kernel, mjx = (env_on("flat", 0.0, impl, slope=0.2) for impl in ("kernel", "jax"))
    start = jax.vmap(kernel.reset)(KEYS[:8])
    ours, theirs = (
        jax.jit(jax.vmap(env.step))(start, jnp.zeros((8, 12))) for env in (kernel, mjx)
    )
    np.testing.assert_allclose(
        ours.pipeline_state.qd, theirs.pipeline_state.qd, rtol=0, atol=2e-2
    )
    vertical = np.asarray(ours.obs["privileged_state"])[:, -3:]
    np.testing.assert_allclose(np.linalg.norm(vertical, axis=1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(vertical[:, 2], np.cos(0.2), rtol=1e-5)


def test_stock_mjx_refuses_rough_ground_by_name():
    with pytest.raises(UserError, match=r"terrain\.kind rough use --impl kernel"):
        env_on("rough", 0.02, "jax")
