"""BP2 as a Gymnasium environment: `gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0")`.

The MDP is `BP2Env`'s: observation, reward, randomisation and falls. Actions are those
of `BP2Env` over their limit, `control.action_limit`, so that each is in [-1, 1]. What
the critic sees beyond the policy's observation is in `info["privileged_state"]`.
"""

from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from gymnasium import Env, spaces
from jaxtyping import Float, UInt8

from bp2_rl.base.errors import UserError
from bp2_rl.env.bp2_env import BP2Env, make
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import load_model
from bp2_rl.settings.env import EnvConfig, Impl

# SI units: a state that is faster than `termination.max_speed` has ended its episode
LARGEST_OBSERVATION = 1e3
POLICY, CRITIC = "state", "privileged_state"
METADATA: dict[str, Any] = {
    "render_modes": ["rgb_array"],
    "render_fps": round(conventions.POLICY_RATE),
}
HEIGHT, WIDTH, CAMERA = 480, 640, "track"  # pixels, and the model's camera
RenderMode = Literal["rgb_array"]
Picture = UInt8[np.ndarray, "height width 3"]


def spaces_of(env: BP2Env) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of observations and of actions of an environment."""
    return (
        spaces.Box(
            -LARGEST_OBSERVATION,
            LARGEST_OBSERVATION,
            (env.observation_size[POLICY],),
            np.float32,
        ),
        spaces.Box(-1.0, 1.0, (env.action_size,), np.float32),
    )


def scaled(action: np.ndarray, env: BP2Env) -> jax.Array:
    """Return actions as `BP2Env` takes them, from actions in [-1, 1]."""
    return env.config.control.action_limit * jnp.asarray(action, jnp.float32)


def draw_key(draws: np.random.Generator) -> int:
    """Draw the seed of JAX's random numbers in an episode."""
    return int(draws.integers(2**31))


class Photographer:
    """Takes pictures of the robot from a camera that follows it.

    Raises:
        UserError: there is no such render mode, or no GL library.
    """

    def __init__(self, hardware: HardwareSpec, render_mode: str):
        if render_mode not in METADATA["render_modes"]:
            raise UserError(f"render_mode must be rgb_array or None, got {render_mode}")
        self._model = load_model(hardware)
        self._data = mujoco.MjData(self._model)
        try:
            self._renderer = mujoco.Renderer(self._model, HEIGHT, WIDTH)
        except (mujoco.FatalError, RuntimeError) as error:
            remedy = "set MUJOCO_GL=egl, or osmesa, before Python starts"
            raise UserError(
                f"MuJoCo finds no GL library for render_mode=rgb_array: {remedy} ({error})"
            ) from error

    def picture(self, qpos: Float[np.ndarray, " nq"]) -> Picture:
        """Return the robot in a state, as rows and columns of red, green and blue."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, CAMERA)
        return self._renderer.render()

    def close(self) -> None:
        """Free the GL library's memory."""
        self._renderer.close()


class BP2GymEnv(Env[np.ndarray, np.ndarray]):
    """A single robot as a Gymnasium environment.

    Args:
        name: one of `env.named.CONFIGS`.
        config: settings in place of those.
        impl: the physics engine, BP2's own kernel by default.
        render_mode: rgb_array lets `render` return pictures.
    """

    metadata = METADATA

    def __init__(
        self,
        name: str = "bp2",
        config: EnvConfig | None = None,
        impl: Impl = "kernel",
        render_mode: RenderMode | None = None,
    ):
        self.env = make(name, config, impl=impl)
        self.observation_space, self.action_space = spaces_of(self.env)
        self.render_mode = render_mode
        self._photographer = render_mode and Photographer(
            self.env.config.hardware, render_mode
        )
        self._reset, self._step = jax.jit(self.env.reset), jax.jit(self.env.step)
        self._state: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode with a new robot, whose curriculum is at its beginning;
        return the observation and `info`."""
        super().reset(seed=seed)
        del options
        self._state = self._reset(jax.random.PRNGKey(draw_key(self.np_random)))
        return np.array(self._state.obs[POLICY]), self._info()

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take one control step, 5 ms; time limits are left to Gymnasium's wrapper."""
        self._state = self._step(self._state, scaled(action, self.env))
        state = self._state
        return (
            np.array(state.obs[POLICY]),
            float(state.reward),
            bool(state.done),
            False,
            self._info(),
        )

    def render(self) -> Picture | None:  # pyright: ignore[reportIncompatibleMethodOverride]  # Gymnasium's may be lists
        """Return a picture of the robot, with `render_mode="rgb_array"`."""
        return self._photographer and self._photographer.picture(
            np.asarray(self._state.pipeline_state.q, float)
        )

    def close(self) -> None:
        """Free the renderer, if there is one."""
        if self._photographer:
            self._photographer.close()

    def _info(self) -> dict[str, Any]:
        state = self._state
        return {
            CRITIC: np.array(state.obs[CRITIC]),
            **{key: float(value) for key, value in state.metrics.items()},
        }
