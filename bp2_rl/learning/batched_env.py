"""Batches of any Brax environment, with time limits, and with resets outside the step.

A reset inside the step would be computed for every robot at every step and thrown away
for almost all. So the learner prepares one fresh episode a robot before each unroll,
and `step` merely selects it. A robot that falls twice in an unroll begins both episodes
alike, but explores differently in each; only untrained robots fall that often.

A number that is not finite ends the episode of its robot alone, and is counted under
its cause.
"""

import dataclasses
import functools
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from brax import envs
from jaxtyping import Array, Bool, Float

Tree = TypeVar("Tree")
PERSISTENT = ("curriculum",)
"""Entries of `state.info` that outlive an episode."""

FAULTS = ("fault/physics", "fault/observation", "fault/reward", "fault/reset")
"""Metrics of steps that are not finite, by the first value that was not; and of a fresh
episode that could not be used."""


class BatchedEnv:
    """A batch of robots, each in its own episode.

    Args:
        env: any `brax.envs.Env`. If it has `restart(state, rng)`, new episodes come
            from there (BP2Env keeps a robot's curriculum level so), otherwise from
            `reset(rng)`.
        episode_length: time limit in control steps; reaching it truncates the episode
            (the critic bootstraps).
    """

    def __init__(self, env: envs.Env, episode_length: int):
        self.env = env
        self.episode_length = episode_length

    def reset(self, keys: Array) -> envs.State:
        """Return first episodes, at random ages, so that time limits don't strike all
        robots at once."""
        state = jax.vmap(self.env.reset)(keys)
        age = jax.vmap(lambda key: jax.random.randint(key, (), 0, self.episode_length))(
            keys
        )
        faults = dict.fromkeys(FAULTS, jnp.zeros(age.shape))
        return dataclasses.replace(
            _with_clock(state, age), metrics={**state.metrics, **faults}
        )

    def fresh_episodes(self, state: envs.State, keys: Array) -> envs.State:
        """Return a fresh episode for every robot; if it is not finite, the robot's
        `state` takes its place."""
        restart = getattr(self.env, "restart", None)
        fresh = (
            jax.vmap(self.env.reset)(keys)
            if restart is None
            else jax.vmap(restart)(state, keys)
        )
        fresh = _with_clock(fresh, jnp.zeros(keys.shape[:1], jnp.int32))
        sound = _finite(_episode(fresh))
        pipeline_state, obs, info = _where(sound, _episode(fresh), _episode(state))
        info = {**info, "steps": fresh.info["steps"]}
        metrics = {**fresh.metrics, "fault/reset": 1.0 - sound}
        return dataclasses.replace(
            fresh, pipeline_state=pipeline_state, obs=obs, info=info, metrics=metrics
        )

    def step(
        self,
        state: envs.State,
        action: Float[Array, "robots actions"],
        fresh: envs.State,
    ) -> envs.State:
        """Take one control step with every robot. Where an episode ends, the returned
        state is the fresh episode's.

        `reward`, `done`, `metrics` and `info["truncation"]` are those of the step
        taken, also for ended episodes. A step that is not finite ends the episode as a
        fall does, with reward 0.
        """
        after, sound = _end_faults(jax.vmap(self.env.step)(state, action))
        steps = state.info["steps"] + 1
        truncation = jnp.where(steps >= self.episode_length, 1.0 - after.done, 0.0)
        done = jnp.maximum(after.done, truncation)
        info = {**after.info, "steps": steps, "truncation": truncation}
        kept = {
            name: _where(sound, info[name], state.info[name])
            for name in PERSISTENT
            if name in info
        }
        pipeline_state, obs, info = _where(
            done > 0, _episode(fresh), (after.pipeline_state, after.obs, info)
        )
        return dataclasses.replace(
            after,
            pipeline_state=pipeline_state,
            obs=obs,
            done=done,
            metrics={
                **after.metrics,
                "fault/reset": done * fresh.metrics["fault/reset"],
            },
            info={**info, **kept, "truncation": truncation},
        )


def _with_clock(state: envs.State, age: Array) -> envs.State:
    clock = {"steps": age, "truncation": jnp.zeros(age.shape)}
    return dataclasses.replace(state, info={**state.info, **clock})


def _episode(state: envs.State) -> tuple[Any, Any, dict[str, Any]]:
    """Return all that a robot's next step depends on."""
    return state.pipeline_state, state.obs, state.info


def _end_faults(after: envs.State) -> tuple[envs.State, Bool[Array, " robots"]]:
    """End the episodes of steps that were not finite, counted by their first cause;
    return the state, and which steps were finite.

    Their numbers are those of a fall with reward 0; physics and observation are still
    to be replaced.
    """
    parts = {
        "fault/physics": (after.pipeline_state, after.info),
        "fault/observation": after.obs,
        "fault/reward": (after.reward, after.done),
    }
    sound = jnp.ones(after.done.shape, bool)
    faults = {}
    for name, part in parts.items():
        faults[name] = (sound & ~_finite(part)).astype(jnp.float32)
        sound &= faults[name] == 0

    def clean(value: Array) -> Array:
        return jnp.where(sound | jnp.isfinite(value), value, 0.0)

    metrics = {**jax.tree.map(clean, after.metrics), **faults}
    reward = jnp.where(sound, after.reward, 0.0)
    done = jnp.where(sound, after.done, 1.0)
    return dataclasses.replace(after, reward=reward, done=done, metrics=metrics), sound


def _finite(tree: object) -> Bool[Array, " robots"]:
    """Return for each robot whether all its numbers are finite."""
    leaves = [
        jnp.isfinite(leaf).all(axis=tuple(range(1, leaf.ndim)))
        for leaf in jax.tree.leaves(tree)
    ]
    return functools.reduce(jnp.logical_and, leaves)


def _where(choose: Bool[Array, " robots"], these: Tree, those: Tree) -> Tree:
    """Return a tree with each robot's rows from `these` where chosen, else `those`."""

    def select(this: Array, that: Array) -> Array:
        return jnp.where(choose.reshape((-1,) + (1,) * (that.ndim - 1)), this, that)

    return jax.tree.map(select, these, those)
