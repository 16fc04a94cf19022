"""Many robots at once: any Brax environment, batched, with time limits and resets that cost nothing in the step.

A reset inside the step would be computed for every robot at every step and thrown away for almost all. So the
learner prepares one fresh episode a robot before each unroll (the bank), and `step` merely selects it.
"""

import dataclasses

import jax
import jax.numpy as jnp
from brax import envs
from jaxtyping import Array, Float

PERSISTENT = ("curriculum",)
"""Entries of `state.info` that outlive an episode."""


class Fleet:
    """A batch of one environment's robots.

    Args:
        env: any `brax.envs.Env`. If it has `restart(state, rng)`, new episodes come from there (BP2Env keeps a
            robot's curriculum level so), otherwise from `reset(rng)`.
        episode_length: time limit in control steps; reaching it truncates the episode (the critic bootstraps).
    """

    def __init__(self, env: envs.Env, episode_length: int):
        self.env = env
        self.episode_length = episode_length

    def reset(self, keys: Array) -> envs.State:
        """First episodes; they start at a random age so that time limits don't strike all robots at once."""
        state = jax.vmap(self.env.reset)(keys)
        age = jax.vmap(lambda key: jax.random.randint(key, (), 0, self.episode_length))(keys)
        return _with_clock(state, age)

    def bank(self, state: envs.State, keys: Array) -> envs.State:
        """One fresh episode for every robot of `state`."""
        if hasattr(self.env, "restart"):
            fresh = jax.vmap(self.env.restart)(state, keys)  # pyright: ignore[reportAttributeAccessIssue]
        else:
            fresh = jax.vmap(self.env.reset)(keys)
        return _with_clock(fresh, jnp.zeros(keys.shape[:1], jnp.int32))

    def step(self, state: envs.State, action: Float[Array, "robots actions"], bank: envs.State) -> envs.State:
        """One control step of every robot. Where an episode ends, the returned state is the bank's.

        `reward`, `done`, `metrics` and `info["truncation"]` are those of the step taken, also for ended episodes.
        """
        after = jax.vmap(self.env.step)(state, action)
        steps = state.info["steps"] + 1
        truncation = jnp.where(steps >= self.episode_length, 1.0 - after.done, 0.0)
        done = jnp.maximum(after.done, truncation)
        info = {**after.info, "steps": steps, "truncation": truncation}
        kept = {name: info[name] for name in PERSISTENT if name in info}

        def select(fresh: Array, current: Array) -> Array:
            return jnp.where(done.reshape((-1,) + (1,) * (current.ndim - 1)) > 0, fresh, current)

        pipeline_state, obs, info = jax.tree.map(
            select, (bank.pipeline_state, bank.obs, bank.info), (after.pipeline_state, after.obs, info)
        )
        info = {**info, **kept, "truncation": truncation}
        return dataclasses.replace(after, pipeline_state=pipeline_state, obs=obs, done=done, info=info)


def _with_clock(state: envs.State, age: Array) -> envs.State:
    clock = {"steps": age, "truncation": jnp.zeros(age.shape)}
    return dataclasses.replace(state, info={**state.info, **clock})
