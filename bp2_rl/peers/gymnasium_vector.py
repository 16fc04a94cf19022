"""Many BP2s in one Gymnasium environment:
`gymnasium.make_vec("bp2_rl.peers:bp2_rl/BP2-v0", num_envs=8)`.

All robots are one batch in a single compiled program. Each robot runs as in the single
environment with its seed.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs import State
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float

from bp2_rl.base.errors import UserError
from bp2_rl.env.bp2_env import make
from bp2_rl.peers import EPISODE
from bp2_rl.peers.gymnasium_env import (
    METADATA,
    BP2Peer,
    Info,
    RenderMode,
    draw_key,
    spaces_of,
)
from bp2_rl.robot.camera import Picture
from bp2_rl.settings.env import EnvConfig, Impl

Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]


class BP2VectorEnv(BP2Peer, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many robots side by side as a Gymnasium vector environment, in one compiled
    program.

    A robot whose episode has ended starts a new episode at the next step; that step
    ignores the action and returns the reward 0 (`AutoresetMode.NEXT_STEP`). `info`
    holds an array for each entry of the single environment's, and what is in it is
    there for every robot.

    Args:
        num_envs: robots.
        max_episode_steps: control steps after which an episode is cut off.
        name: one of `env.named.CONFIGS`.
        config: settings in place of those.
        impl: the physics engine, BP2's own kernel by default.
        render_mode: rgb_array lets `render` return pictures.

    Raises:
        UserError: fewer than one robot.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int = EPISODE,
        name: str = "bp2",
        config: EnvConfig | None = None,
        impl: Impl = "kernel",
        render_mode: RenderMode | None = None,
    ):
        if num_envs < 1:
            raise UserError(f"num_envs must be at least 1, got {num_envs}")
        env = make(name, config, impl=impl, num_robots=num_envs)
        self._open(env, render_mode, many=True)
        self.num_envs = num_envs
        self._limit = max_episode_steps
        self.single_observation_space, self.single_action_space = spaces_of(self.env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._choose = jax.jit(jax.vmap(_choose))
        self._draws = [seeding.np_random()[0] for _ in range(num_envs)]
        self._age = np.zeros(num_envs, int)  # control steps of the present episodes
        self._over = np.zeros(num_envs, bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Info | None = None,
    ) -> tuple[np.ndarray, Info]:
        """Start episodes with new robots; with a single seed, robot i takes seed + i.
        `options["reset_mask"]` selects robots.

        Raises:
            UserError: there are not as many seeds, or entries of the mask, as robots.
        """
        if seed is None or isinstance(seed, (int, np.integer)):
            seed = [
                None if seed is None else int(seed) + i for i in range(self.num_envs)
            ]
        which = np.asarray(
            (options or {}).get("reset_mask", np.ones(self.num_envs, bool)), bool
        )
        if len(seed) != self.num_envs or which.shape != (self.num_envs,):
            raise UserError(
                f"reset takes one seed and one entry of reset_mask for each of {self.num_envs} robots"
            )
        for robot in np.flatnonzero(which).tolist():
            if seed[robot] is not None:
                self._draws[robot] = seeding.np_random(seed[robot])[0]
        self._begin(which)
        return self._observation(), self._info()

    def step(self, actions: Float[np.ndarray, "n 12"]) -> Step:
        """Take one control step, 5 ms, with each robot."""
        begins = self._over
        self._act(actions)
        self._age += 1
        rewards = np.array(self._state.reward, float)
        terminated = np.array(self._state.done, bool)
        if begins.any():
            self._begin(begins)
            rewards[begins] = 0.0
            terminated[begins] = False
        truncated = (self._age >= self._limit) & ~begins
        self._over = terminated | truncated
        return self._observation(), rewards, terminated, truncated, self._info()

    def render(self) -> tuple[Picture, ...] | None:
        """Return a picture for each robot, with `render_mode="rgb_array"`."""
        return tuple(self._pictures()) or None

    def _begin(self, which: Bool[np.ndarray, " n"]) -> None:
        """Start new episodes for the robots in `which`; only their random generators
        draw a number."""
        keys = [
            draw_key(draws) if begins else 0
            for draws, begins in zip(self._draws, which, strict=True)
        ]
        fresh = self._reset(jax.vmap(jax.random.PRNGKey)(np.array(keys, np.uint32)))
        self._state = (
            fresh if self._state is None else self._choose(which, fresh, self._state)
        )
        self._age[which] = 0
        self._over = self._over & ~which

    def _info(self) -> Info:
        """Return `info` as Gymnasium's vector environments do: `_NAME` says for which
        robots NAME holds."""
        info = super()._info()
        return info | {f"_{name}": np.ones(self.num_envs, bool) for name in info}


def _choose(which: jax.Array, one: State, other: State) -> State:
    return jax.tree.map(lambda x, y: jnp.where(which, x, y), one, other)
