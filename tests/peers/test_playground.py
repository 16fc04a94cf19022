"""BP2 in MuJoCo Playground, the real one: in its registry, under its wrapper, and the same MDP as BP2Env's."""

import subprocess

import jax
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.env.bp2_env import make
from bp2_rl.env.named import CONFIGS
from bp2_rl.peers import PLAYGROUND, register_playground


@pytest.fixture(scope="module")
def playground():
    playground = pytest.importorskip("mujoco_playground", reason="Playground is not installed (extra `playground`)")
    from mujoco_playground._src import mjx_env  # pyright: ignore[reportMissingImports]

    with pytest.MonkeyPatch.context() as patch:  # it would fetch its own robots from GitHub, which BP2 does not need
        patch.setattr(mjx_env, "ensure_menagerie_exists", lambda: None)
        register_playground()
        yield playground


def test_offline_one_line_says_what_to_do(playground, monkeypatch):
    from mujoco_playground._src import mjx_env  # pyright: ignore[reportMissingImports]

    def download():  # what it raises without a network
        raise subprocess.CalledProcessError(128, ["git", "clone"])

    monkeypatch.setattr(mjx_env, "ensure_menagerie_exists", download)
    with pytest.raises(UserError) as raised:
        register_playground()
    said = str(raised.value)
    assert "MuJoCo Menagerie" in said
    assert "try again online" in said
    assert said.endswith(str(mjx_env.MENAGERIE_PATH))
    assert "\n" not in said


def test_every_named_environment_is_registered_with_its_settings(playground):
    for name, theirs in PLAYGROUND.items():
        config = playground.registry.get_default_config(theirs)
        assert (config.ctrl_dt, config.sim_dt, config.episode_length) == (0.005, 0.001, 1000)
        if name != "bp2":  # that one is loaded below
            assert playground.registry.load(theirs).env.config == CONFIGS[name]()


def test_under_playgrounds_wrapper_it_is_bp2_env(playground):
    loaded = playground.registry.load("BP2", config_overrides={"impl": "kernel"})
    env = make("bp2", impl="kernel")
    assert loaded.env.config == env.config
    assert loaded.observation_size == {name: (size,) for name, size in env.observation_size.items()}
    wrapped = playground.wrapper.wrap_for_brax_training(loaded, episode_length=3)
    keys = jax.random.split(jax.random.PRNGKey(0), 2)
    theirs = jax.jit(wrapped.reset)(keys)
    ours = jax.jit(jax.vmap(env.reset))(jax.vmap(jax.random.split)(keys)[..., 1])  # as the wrapper takes them
    first = {name: np.array(seen) for name, seen in theirs.obs.items()}
    step, alone, action = jax.jit(wrapped.step), jax.jit(jax.vmap(env.step)), np.full((2, 12), 0.1, np.float32)
    for _ in range(2):
        # The same arithmetic in another program, whose roundings may differ, and contacts multiply them.
        np.testing.assert_allclose(theirs.obs["privileged_state"], ours.obs["privileged_state"], rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(theirs.reward, ours.reward, atol=1e-4)
        theirs, ours = step(theirs, action), alone(ours, action)
    theirs = step(theirs, action)
    assert theirs.done.tolist() == [1.0, 1.0]
    np.testing.assert_array_equal(theirs.obs["state"], first["state"])  # put back by the wrapper


def test_a_setting_is_changed_by_its_dotted_name_and_the_clock_is_not(playground):
    slow = playground.registry.load("BP2Kinematic", config_overrides={"env.commands.max_forward": 2.0})
    assert slow.env.config.commands.max_forward == 2.0
    with pytest.raises(UserError, match=r"ctrl_dt 0.005 and sim_dt 0.001: leave them as they are"):
        playground.registry.load("BP2", config_overrides={"ctrl_dt": 0.02})
