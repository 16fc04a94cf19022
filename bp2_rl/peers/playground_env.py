"""BP2 in MuJoCo Playground: `registry.load("BP2")`, after `bp2_rl.peers.register_playground()`.

The MDP is `BP2Env`'s, its settings are the entry `env` of Playground's config. What Playground calls `data` is all that
begins anew with an episode, not MJX's data alone: so its wrappers, which put the first `data` back, start an episode
as it once began.
"""

import functools
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import jax
import mujoco
import numpy as np
from brax import envs
from ml_collections import config_dict
from mujoco import mjx
from mujoco_playground._src import mjx_env

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.named import CONFIGS
from bp2_rl.peers import EPISODE
from bp2_rl.robot import conventions
from bp2_rl.robot.model import load_model
from bp2_rl.settings.env import EnvConfig


def default_config(name: str) -> config_dict.ConfigDict:
    """Playground's config of the environment of this name; `impl` is the physics, as for train.py."""
    return config_dict.create(
        ctrl_dt=conventions.CONTROL_STEP,
        sim_dt=conventions.PHYSICS_STEP,
        episode_length=EPISODE,
        action_repeat=1,
        impl="jax",
        env=config_dict.ConfigDict(_swap(to_json(CONFIGS[name]()), "inf", math.inf)),
    )


class BP2Playground(mjx_env.MjxEnv):
    """One robot, as `BP2Env`.

    Args:
        config: as `default_config` gives it.
        config_overrides: by dotted names, `{"env.commands.max_forward": 5.0}`.

    Raises:
        UserError: another time step, or a setting that cannot be.
    """

    def __init__(self, config: config_dict.ConfigDict, config_overrides: Mapping[str, Any] | None = None):
        super().__init__(config, dict(config_overrides or {}))
        settings: Any = self._config
        if (settings.ctrl_dt, settings.sim_dt) != (conventions.CONTROL_STEP, conventions.PHYSICS_STEP):
            steps = f"ctrl_dt {conventions.CONTROL_STEP:g} and sim_dt {conventions.PHYSICS_STEP:g}"
            raise UserError(f"BP2's motors and controller are defined at {steps}: leave them as they are")
        self.env = BP2Env(from_json(EnvConfig, _swap(settings.env.to_dict(), math.inf, "inf")), impl=settings.impl)

    def reset(self, rng: jax.Array) -> mjx_env.State:
        """A new robot."""
        return _theirs(self.env.reset(rng))

    def step(self, state: mjx_env.State, action: jax.Array) -> mjx_env.State:
        """One control step, 5 ms."""
        data: Any = state.data
        ours = envs.State(data, state.obs, state.reward, state.done, state.metrics, state.info)
        return _theirs(self.env.step(ours, action))

    @property
    def action_size(self) -> int:
        """12: one target a motor."""
        return self.env.action_size

    @property
    def xml_path(self) -> str:
        """What the robot is made of; `mj_model` is made from it and from `env.hardware`."""
        return str(asset_path("bp2_mjcf/bp2.xml"))

    @property
    def mj_model(self) -> mujoco.MjModel:
        """The robot that is simulated."""
        return self.env.mj_model

    @functools.cached_property
    def mjx_model(self) -> mjx.Model:  # pyright: ignore[reportIncompatibleMethodOverride]  # a property there
        """Return the model for MJX, to look at: `BP2Env` itself draws each robot's friction and masses."""
        return mjx.put_model(self.env.mj_model)

    def render(
        self,
        trajectory: Any,
        height: int = 240,
        width: int = 320,
        camera: str | None = None,
        *options: Any,
        **named: Any,
    ) -> Any:
        """Pictures of states, as Playground's environments make them; needs a GL library."""
        model = load_model(self.env.config.hardware)
        states = [_picture(state) for state in trajectory] if isinstance(trajectory, list) else _picture(trajectory)
        return mjx_env.render_array(model, states, height, width, camera, *options, **named)


def _theirs(state: envs.State) -> mjx_env.State:
    data: Any = state.pipeline_state
    return mjx_env.State(data, state.obs, state.reward, state.done, state.metrics, state.info)


def _picture(state: mjx_env.State) -> Any:
    """What Playground's renderer asks of a state."""
    qpos, qvel = np.asarray(state.data.q), np.asarray(state.data.qd)
    nothing = {"mocap_pos": np.zeros((0, 3)), "mocap_quat": np.zeros((0, 4)), "xfrc_applied": 0.0}
    return SimpleNamespace(data=SimpleNamespace(qpos=qpos, qvel=qvel, **nothing))


def _swap(value: Any, this: Any, that: Any) -> Any:
    """A config's JSON with one value for another: JSON has no infinity, and Playground's config keeps to types."""
    if isinstance(value, dict):
        return {key: _swap(part, this, that) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_swap(part, this, that) for part in value]
    return that if value == this else value
