"""BP2 as a Gymnasium environment: `gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0")`.

The MDP is `BP2Env`'s: observation, action, reward, randomisation and falls. What the critic sees
beyond the policy's observation is in `info["privileged_state"]`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import Env, spaces

from bp2_rl.env.bp2_env import BP2Env, make_env
from bp2_rl.settings.env import EnvConfig, Impl

LARGEST_OBSERVATION = 1e3  # SI units: a state that is faster than `termination.max_speed` has ended its episode
POLICY, CRITIC = "state", "privileged_state"


def spaces_of(env: BP2Env) -> tuple[spaces.Box, spaces.Box]:
    """(Of an observation, of an action)."""
    seen, most = env.observation_size[POLICY], env.config.control.action_limit
    return (
        spaces.Box(-LARGEST_OBSERVATION, LARGEST_OBSERVATION, (seen,), np.float32),
        spaces.Box(-most, most, (env.action_size,), np.float32),
    )


def draw_key(draws: np.random.Generator) -> int:
    """What JAX's random numbers of an episode begin with."""
    return int(draws.integers(2**31))


class BP2GymEnv(Env[np.ndarray, np.ndarray]):
    """One robot.

    Args:
        name: one of `env.named.CONFIGS`.
        config: settings in place of those.
        impl: the physics engine, BP2's own kernel by default.
    """

    metadata = {"render_modes": [], "render_fps": 200}  # noqa: RUF012  # Gymnasium's own

    def __init__(self, name: str = "bp2", config: EnvConfig | None = None, impl: Impl = "kernel"):
        self.env = make_env(name, config, impl=impl)
        self.observation_space, self.action_space = spaces_of(self.env)
        self.render_mode = None
        self._reset, self._step = jax.jit(self.env.reset), jax.jit(self.env.step)
        self._state: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """A new robot; its curriculum starts at the beginning."""
        super().reset(seed=seed)
        del options
        self._state = self._reset(jax.random.PRNGKey(draw_key(self.np_random)))
        return np.array(self._state.obs[POLICY]), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control step, 5 ms; time limits are the wrapper's."""
        self._state = self._step(self._state, jnp.asarray(action, jnp.float32))
        state = self._state
        return np.array(state.obs[POLICY]), float(state.reward), bool(state.done), False, self._info()

    def _info(self) -> dict[str, Any]:
        state = self._state
        return {CRITIC: np.array(state.obs[CRITIC]), **{key: float(value) for key, value in state.metrics.items()}}
