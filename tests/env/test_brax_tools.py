"""Brax's own tools show BP2: its system, and a page in which it can be looked at."""

import json
from typing import Any

import mujoco
import numpy as np
import pytest
from brax import envs
from brax.io import html
from brax.io import json as brax_json

from bp2_rl.env.bp2_env import BP2Env, make
from bp2_rl.env.episode import PipelineState
from bp2_rl.env.named import CONFIGS
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.settings.presets import preset


@pytest.fixture(scope="module")
def env() -> Any:
    return envs.get_environment("bp2")


def test_named_environments_are_those_that_trainings_use(env):
    made: dict[str, Any] = {name: envs.get_environment(name) for name in CONFIGS}
    assert all(isinstance(env, BP2Env) for env in made.values())
    assert [made[name].config.hardware for name in CONFIGS] == [BUILT, IDEAL, BUILT]
    assert [made[name].config.reference for name in CONFIGS] == [
        "collocation",
        "collocation",
        "kinematic",
    ]
    assert env.config == make("bp2").config == preset("imitation", "gpu").env
    assert isinstance(env, envs.Env)


def test_braxs_page_shows_the_robot_where_mujoco_has_it(env):
    model = env.sys.mj_model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:3], data.qpos[3:7] = (1.0, 2.0, 0.6), (0.8, 0.0, 0.6, 0.0)
    data.qpos[7:] = rng.uniform(-0.4, 0.4, 16)
    mujoco.mj_kinematics(model, data)
    still = env.starts.at_rest().replace(qpos=data.qpos.astype(np.float32))
    nothing: Any = None
    state = env.brax_state(PipelineState(still, *[nothing] * 6))
    # float32, a metre or two away
    assert np.asarray(state.x.pos) == pytest.approx(data.xpos[1:], abs=1e-5)
    shown = json.loads(brax_json.dumps(env.sys, [state, state]))
    assert np.asarray(shown["states"]["x"][1]["pos"]).shape == (model.nbody - 1, 3)
    assert sum(len(geoms) for geoms in shown["geoms"].values()) == model.ngeom
    assert "<html" in html.render(env.sys, [state, state])
