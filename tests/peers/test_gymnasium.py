"""BP2 in Gymnasium: registered, checked by Gymnasium itself, and the same MDP as
BP2Env's."""

import os
import re
import subprocess
import sys
from typing import Any

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from bp2_rl.base.errors import UserError
from bp2_rl.peers import GYMNASIUM, register_gymnasium


@pytest.fixture(scope="module", autouse=True)
def registered():
    register_gymnasium()
    register_gymnasium()  # twice does no harm


@pytest.fixture(scope="module")
def env():
    with gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0") as env:
        yield env


def test_every_named_environment_is_registered():
    for name in GYMNASIUM.values():
        assert f"bp2_rl/{name}" in gymnasium.registry


def test_the_module_before_the_name_registers_it_as_it_is_imported():
    program = "import gymnasium, bp2_rl.peers; print(gymnasium.spec('bp2_rl/BP2-v0').vector_entry_point)"
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert shown.stdout == "bp2_rl.peers.gymnasium_vector:BP2VectorEnv\n"


def test_gymnasium_finds_nothing_wrong(env):
    check_env(env.unwrapped, skip_render_check=True)  # pictures have their own test


PICTURES = """
import gymnasium, numpy as np
from gymnasium.utils.passive_env_checker import env_render_passive_checker
with gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0", render_mode="rgb_array") as env:
    env.reset(seed=0)
    env_render_passive_checker(env.unwrapped)
    shown = env.render()
    red, green, blue = (shown[..., k].astype(int) for k in range(3))
    orange = (red > 170) & (green > 60) & (green < 150) & (blue < 110)
    assert (shown.shape, shown.dtype) == ((480, 640, 3), np.uint8)
    assert orange.sum() > 200, "the robot's springs are not to be seen"
robots = gymnasium.make_vec("bp2_rl.peers:bp2_rl/BP2-v0", num_envs=2, render_mode="rgb_array")
robots.reset(seed=0)
first, second = robots.render()
robots.close()
assert abs(first.astype(int) - shown).mean() < 1.0, "not the robot of the single environment"
assert abs(second.astype(int) - shown).mean() > 1.0, "not another robot"
"""


@pytest.mark.parametrize("library", ["egl"])
def test_pictures_are_taken(library):
    """In a process of its own: MuJoCo binds its GL library when it is imported, and a
    wrong one may end the process."""
    command = [sys.executable, "-W", "error::UserWarning", "-c", PICTURES]
    done = subprocess.run(
        command, env=os.environ | {"MUJOCO_GL": library}, capture_output=True, text=True
    )
    if done.returncode and re.search(r"GL library|OpenGL|EGL", done.stderr):
        pytest.skip(f"needs a GL library: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr


def test_without_a_gl_library_pictures_are_refused_in_one_line():
    program = """
from bp2_rl.base.errors import UserError
from bp2_rl.peers.gymnasium_env import open_camera
from bp2_rl.robot.hardware import BUILT
for mode in ("rgb_array", "human"):
    try:
        open_camera(BUILT, mode)
    except UserError as error:
        print(error)
"""
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("DISPLAY", "WAYLAND_DISPLAY")
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment | {"MUJOCO_GL": ""},
        capture_output=True,
        text=True,
    )
    no_library, no_mode = done.stdout.splitlines()
    assert no_library.startswith(
        "MuJoCo finds no GL library for render_mode=rgb_array: set MUJOCO_GL=egl"
    )
    assert no_mode == "render_mode must be rgb_array or None, got human"


def test_it_is_bp2_env(env):
    inner = env.unwrapped
    observation, info = env.reset(seed=3)
    key = jax.random.PRNGKey(
        int(np.random.default_rng(np.random.PCG64(3)).integers(2**31))
    )
    state = jax.jit(inner.env.reset)(key)
    np.testing.assert_array_equal(observation, state.obs["state"])
    limit = inner.env.config.control.action_limit
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (12,), np.float32)
    action = np.full(12, 0.1, np.float32)
    state = jax.jit(inner.env.step)(state, limit * action)
    observation, reward, terminated, truncated, info = env.step(action)
    np.testing.assert_array_equal(observation, state.obs["state"])
    np.testing.assert_array_equal(
        info["privileged_state"], state.obs["privileged_state"]
    )
    assert reward == float(state.reward) != 0.0
    assert (terminated, truncated) == (False, False)
    assert info["speed"] == float(state.metrics["speed"])


# --- Many robots ----------------------------------------------------------------------

LIMIT = 3  # control steps of an episode


@pytest.fixture(scope="module")
def robots():
    return gymnasium.make_vec(
        "bp2_rl.peers:bp2_rl/BP2-v0", num_envs=2, max_episode_steps=LIMIT
    )


def test_robots_side_by_side_run_as_each_does_alone(env, robots):
    """Over two ends of the episodes, of which a fall, provoked by an action that is no
    number, is one."""
    assert robots.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.NEXT_STEP
    actions = (
        np.random.default_rng(0)
        .normal(0.0, 0.1, (2 * LIMIT + 2, 2, 12))
        .astype(np.float32)
    )
    actions[1, 0] = np.nan
    seen, info = robots.reset(seed=5)
    told = [robots.step(action) for action in actions]
    for robot in range(2):
        single = env.unwrapped
        observation, told_alone = single.reset(seed=5 + robot)
        # Another program of the same arithmetic: float32 may round otherwise, and
        # contacts multiply that.
        close: Any = {"rtol": 1e-3, "atol": 1e-3}
        np.testing.assert_allclose(seen[robot], observation, **close)
        np.testing.assert_allclose(
            info["privileged_state"][robot], told_alone["privileged_state"], **close
        )
        age, over = 0, False
        for action, (seen_now, rewards, terminated, truncated, info_now) in zip(
            actions, told, strict=True
        ):
            if over:
                (observation, told_alone), reward, fell, age, over = (
                    single.reset(),
                    0.0,
                    False,
                    0,
                    False,
                )
            else:
                observation, reward, fell, _, told_alone = single.step(action[robot])
                age += 1
                over = fell or age >= LIMIT
            np.testing.assert_allclose(seen_now[robot], observation, **close)
            np.testing.assert_allclose(rewards[robot], reward, **close)
            assert (terminated[robot], truncated[robot]) == (fell, age >= LIMIT)
            assert info_now["speed"][robot] == pytest.approx(
                told_alone["speed"], abs=1e-3
            )
            assert info_now["_speed"].all()
    assert [step[2][0] for step in told].index(True) == 1  # the fall


def test_what_a_vector_environment_gives_is_in_its_spaces(robots):
    seen, _ = robots.reset(seed=[1, 2])
    assert seen in robots.observation_space
    again, *_ = robots.step(robots.action_space.sample())
    assert again in robots.observation_space
    np.testing.assert_array_equal(robots.reset(seed=[1, 2])[0], seen)
    only, _ = robots.reset(seed=[7, 7], options={"reset_mask": np.array([False, True])})
    np.testing.assert_array_equal(only[0], seen[0])
    assert (only[1] != seen[1]).any()
    with pytest.raises(
        UserError, match="one seed and one entry of reset_mask for each of 2 robots"
    ):
        robots.reset(seed=[1])
