"""BP2 in Gymnasium: registered, checked by Gymnasium itself, and the same MDP as BP2Env's."""

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from bp2_rl.peers import GYMNASIUM, register_gymnasium


@pytest.fixture(scope="module", autouse=True)
def registered():
    register_gymnasium()
    register_gymnasium()  # twice does no harm


@pytest.fixture(scope="module")
def env():
    with gymnasium.make("bp2_rl/BP2-v0") as env:
        yield env


def test_every_named_environment_is_registered():
    for name in GYMNASIUM.values():
        assert f"bp2_rl/{name}" in gymnasium.registry


# An action is in units of `control.action_scale`, as in training; Gymnasium would rather have it in [-1, 1].
@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_gymnasium_finds_nothing_wrong(env):
    check_env(env.unwrapped, skip_render_check=True)


def test_it_is_bp2_env(env):
    inner = env.unwrapped
    observation, info = env.reset(seed=3)
    key = jax.random.PRNGKey(int(np.random.default_rng(np.random.PCG64(3)).integers(2**31)))
    state = jax.jit(inner.env.reset)(key)
    np.testing.assert_array_equal(observation, state.obs["state"])
    action = np.full(12, 0.1, np.float32)
    state = jax.jit(inner.env.step)(state, action)
    observation, reward, terminated, truncated, info = env.step(action)
    np.testing.assert_array_equal(observation, state.obs["state"])
    np.testing.assert_array_equal(info["privileged_state"], state.obs["privileged_state"])
    assert reward == float(state.reward) != 0.0
    assert (terminated, truncated) == (False, False)
    assert info["speed"] == float(state.metrics["speed"])
