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
from bp2_rl.env.controller import Targets
from bp2_rl.robot.conventions import GRAVITY, LEGS
from bp2_rl.robot.ground import HeightField, Stairs
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import MOTOR_QPOS, SOLE_SITES, load_model
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
    assert isinstance(drawn.ground, HeightField)
    x, y, z = np.asarray(drawn.gravity).T / -GRAVITY
    for size in (drawn.ground.amplitude, np.arctan2(np.hypot(x, y), z)):
        assert 0.1 - 1e-5 < np.min(size) < 0.1 + 0.02 * level + 1e-5
        assert 0.1 + 0.08 * level - 1e-5 < np.max(size) < 0.1 + 0.1 * level + 1e-5


def test_on_stairs_an_episode_starts_in_the_midst_of_a_landing():
    """Even for half a metre around, and stairs up or down within the next two; sizes
    grow with the level as on rough ground."""
    draw = jax.vmap(randomization.with_terrain, (0, None, None, None))
    config = TerrainConfig("stairs", (0.1, 0.2), (0.25, 0.4))
    ground = draw(KEYS, NOMINAL, config, jnp.asarray(0.5)).ground
    assert isinstance(ground, Stairs)
    assert 0.1 <= ground.height.min() < 0.11 < 0.14 < ground.height.max() <= 0.15
    assert 0.25 <= ground.run.min() < 0.27 < 0.38 < ground.run.max() <= 0.4
    x = jnp.linspace(-0.5, 2.0, 26)[:, None] + jnp.zeros(len(KEYS))
    steps = np.asarray(ground.below(x, x).height / ground.height)
    assert np.ptp(steps[:11], axis=0).max() == 0.0
    assert np.ptp(steps, axis=0).min() > 0.9
    low, high = np.sum(steps[0] < 0.1), np.sum(abs(steps[0] - 10.0) < 0.1)
    assert low + high == len(KEYS)
    assert min(low, high) > 20


def test_a_shank_is_in_the_ground_if_its_knee_or_its_middle_is():
    """By C MuJoCo's places; in some poses the edge of a step cuts the middle alone."""
    model = load_model(BUILT)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    stairs = Stairs(0.3, 0.4, 7.0)
    shanks = [model.body(f"{leg}_shank").id for leg in LEGS]
    soles = [model.site(name).id for name in SOLE_SITES]
    found = jax.jit(lambda pose: observations.shank_in_ground(pose, stairs, BUILT))
    middle_alone = 0
    for _ in range(200):
        data.qpos = model.key("stand").qpos
        data.qpos[[0, 2]] += rng.uniform((-1.0, 1.0), (1.0, 3.0))
        data.qpos[MOTOR_QPOS] += rng.normal(size=12) / 4
        mujoco.mj_kinematics(model, data)
        knees, ends = data.xpos[shanks], data.site_xpos[soles]
        knee, middle = (
            np.any(place[:, 2] < stairs.below(*place.T[:2]).height)
            for place in (knees, 0.5 * (knees + ends))
        )
        assert found(jnp.asarray(data.qpos)) == (knee or middle)
        middle_alone += middle and not knee
    assert middle_alone > 5


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
        observations.PrivilegedInputs(episode, jnp.zeros(3), jnp.zeros(4), jnp.ones(()))
    )
    assert float(seen) == pytest.approx(float(episode.q[2]) - below, abs=1e-6)
    step = jax.jit(rough.step)
    physics = episode.physics
    for over, fallen in ((0.25, 1.0), (0.45, 0.0)):
        moved = physics.replace(qpos=physics.qpos.at[2].set(below + over))
        there = dataclasses.replace(
            state, pipeline_state=episode.replace(physics=moved)
        )
        assert step(there, jnp.zeros(12)).done == fallen


def test_the_critic_sees_the_ground_under_and_ahead_of_the_robot(rough, starts):
    """In the mirror image left and right of the ground are exchanged."""
    episode = jax.tree.map(lambda x: x[3], starts.pipeline_state)
    entry = observations.privileged_terms(rough.config)[-1]
    seen = np.asarray(starts.obs["privileged_state"][3, -15:])
    ground, (x, y) = episode.randomization.ground, episode.q[:2]
    ahead = ground.below(x + 0.8, y + 0.2).height - ground.below(x, y).height
    assert seen[3 * 3 + 2] == pytest.approx(float(ahead), abs=1e-5)
    image = seen[list(entry.mirror.order)] * entry.mirror.sign
    np.testing.assert_array_equal(image, seen.reshape(5, 3)[:, ::-1].ravel())


def test_on_a_slope_kernel_and_mjx_take_the_same_step():
    """Accelerations to 1e-3: MJX's solver takes few iterations."""
    kernel, mjx = (env_on("flat", 0.0, impl, slope=0.2) for impl in ("kernel", "jax"))
    start = jax.jit(jax.vmap(kernel.reset))(KEYS[:8])
    episodes = start.pipeline_state

    def speeds(env):
        def step(physics, robot):
            targets = Targets(physics.qpos[MOTOR_QPOS], jnp.zeros(12))
            return env.engine(physics, targets, robot)[0].qvel

        return jax.jit(jax.vmap(step))(episodes.physics, episodes.randomization)

    np.testing.assert_allclose(speeds(kernel), speeds(mjx), rtol=0, atol=2e-2)
    vertical = np.asarray(start.obs["privileged_state"])[:, -3:]
    np.testing.assert_allclose(np.linalg.norm(vertical, axis=1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(vertical[:, 2], np.cos(0.2), rtol=1e-5)


def test_stock_mjx_refuses_rough_ground_by_name():
    with pytest.raises(UserError, match=r"terrain\.kind rough use --impl kernel"):
        env_on("rough", 0.02, "jax")
