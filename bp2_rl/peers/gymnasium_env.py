"""BP2 as a Gymnasium environment: `gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0")`.

The MDP is `BP2Env`'s: observation, reward, randomisation and falls. Actions are those
of `BP2Env` over their limit, `control.action_limit`, so that each is in [-1, 1].
`info["privileged_state"]` is the critic's observation.
"""

from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from gymnasium import Env, spaces

from bp2_rl.base.errors import UserError
from bp2_rl.env.bp2_env import BP2Env, make
from bp2_rl.robot import conventions
from bp2_rl.robot.camera import Camera, Picture
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import load_model
from bp2_rl.settings.env import EnvConfig, Impl

# SI units: beyond `termination.max_speed` the episode has ended
LARGEST_OBSERVATION = 1e3
POLICY, CRITIC = "state", "privileged_state"
Info = dict[str, Any]
"""Gymnasium's type of `info`, `options` and `metadata`."""
METADATA: Info = {
    "render_modes": ["rgb_array"],
    "render_fps": round(conventions.POLICY_RATE),
}
HEIGHT, WIDTH = 480, 640  # pixels
RenderMode = Literal["rgb_array"]


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


def draw_key(draws: np.random.Generator) -> int:
    """Draw the JAX random key of an episode."""
    return int(draws.integers(2**31))


def open_camera(hardware: HardwareSpec, render_mode: str | None) -> Camera | None:
    """Open a camera for a render mode; none without one.

    Raises:
        UserError: there is no such render mode, or no GL library.
    """
    if render_mode is None:
        return None
    if render_mode not in METADATA["render_modes"]:
        raise UserError(f"render_mode must be rgb_array or None, got {render_mode}")
    try:
        return Camera(load_model(hardware), HEIGHT, WIDTH)
    except (mujoco.FatalError, RuntimeError) as error:
        remedy = "set MUJOCO_GL=egl, or osmesa, before Python starts"
        raise UserError(
            f"MuJoCo finds no GL library for render_mode=rgb_array: {remedy} ({error})"
        ) from error


class BP2Peer:
    """Base class with `BP2Env`, its last state and a camera, for one robot or many."""

    def _open(
        self, env: BP2Env, render_mode: RenderMode | None, *, many: bool = False
    ) -> None:
        batched = jax.vmap if many else lambda of_one: of_one
        self.env = env
        self.render_mode = render_mode
        self._camera = open_camera(env.config.hardware, render_mode)
        self._reset = jax.jit(batched(env.reset))
        self._step = jax.jit(batched(env.step))
        self._state: Any = None

    def _act(self, action: np.ndarray) -> None:
        """Take a control step with actions in [-1, 1]."""
        limit = self.env.config.control.action_limit
        self._state = self._step(self._state, limit * jnp.asarray(action, jnp.float32))

    def _observation(self) -> np.ndarray:
        return np.array(self._state.obs[POLICY])

    def _info(self) -> Info:
        """Return the critic's observation and the metrics; for many robots, along the
        first axis."""
        metrics = self._state.metrics
        return {
            CRITIC: np.array(self._state.obs[CRITIC]),
            **{name: np.array(value, float) for name, value in metrics.items()},
        }

    def _pictures(self) -> list[Picture]:
        """Return every robot's picture; none without `render_mode="rgb_array"`."""
        if not self._camera:
            return []
        robots = np.atleast_2d(np.asarray(self._state.pipeline_state.q, float))
        return [self._camera.picture(qpos) for qpos in robots]

    def close_extras(self, **kwargs: object) -> None:
        """Free what pictures needed."""
        del kwargs
        if self._camera:
            self._camera.close()


class BP2GymEnv(BP2Peer, Env[np.ndarray, np.ndarray]):
    """A single robot as a Gymnasium environment.

    Args:
        name: one of `env.named.CONFIGS`.
        config: settings in place of the named ones.
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
        self._open(make(name, config, impl=impl), render_mode)
        self.observation_space, self.action_space = spaces_of(self.env)

    def reset(
        self, *, seed: int | None = None, options: Info | None = None
    ) -> tuple[np.ndarray, Info]:
        """Start an episode with a new robot at curriculum level 0; return the
        observation and `info`."""
        super().reset(seed=seed)
        del options
        self._state = self._reset(jax.random.PRNGKey(draw_key(self.np_random)))
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Info]:
        """Take one control step, 5 ms; time limits are left to Gymnasium's wrapper."""
        self._act(action)
        return (
            self._observation(),
            float(self._state.reward),
            bool(self._state.done),
            False,
            self._info(),
        )

    def render(self) -> Picture | None:  # pyright: ignore[reportIncompatibleMethodOverride]  # Gymnasium's may be lists
        """Return a picture of the robot, with `render_mode="rgb_array"`."""
        return next(iter(self._pictures()), None)

    def close(self) -> None:
        """Free the renderer, if there is one."""
        self.close_extras()

    def _info(self) -> Info:
        """Return the metrics as numbers, and the critic's observation as an array."""
        info = super()._info()
        return {name: x if x.ndim else float(x) for name, x in info.items()}
