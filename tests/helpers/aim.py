"""An environment whose optimal policy is known, and a small training on it; run as a
program, it trains on all of JAX's devices."""

import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax import envs
from jax.flatten_util import ravel_pytree

from bp2_rl.env.metrics import SPEED_BINS
from bp2_rl.learning.ppo import PPO
from bp2_rl.settings.ppo import PPOConfig

TINY = PPOConfig(
    num_envs=16,
    unroll_length=5,
    num_minibatches=2,
    num_epochs=2,
    episode_length=20,
    policy_layers=(16,),
    value_layers=(16,),
)


def assert_equal(a, b):
    """Compare two trees to the last bit."""
    jax.tree.map(np.testing.assert_array_equal, jax.device_get(a), jax.device_get(b))


class Aim(envs.Env):
    """Environment that shows a target and rewards an action by -(action - target)^2:
    the best return is 0 from every state."""

    def __init__(self, ends_after: int | None = None, reward: float = 0.0):
        self.ends_after, self.bonus = ends_after, reward

    def reset(self, rng):
        rng, key = jax.random.split(rng)
        target = jax.random.uniform(key, (1,), minval=-1.0, maxval=1.0)
        zero: Any = jnp.zeros(())  # also the clock in the place of a Brax physics state
        return envs.State(zero, target, zero, zero, {"miss": zero}, {"rng": rng})

    def step(self, state: Any, action):
        miss = jnp.abs(action - state.obs)[0]
        time = state.pipeline_state + 1.0
        rng, key = jax.random.split(state.info["rng"])
        target = jax.random.uniform(key, (1,), minval=-1.0, maxval=1.0)
        done = (
            jnp.zeros(())
            if self.ends_after is None
            else (time >= self.ends_after).astype(jnp.float32)
        )
        return state.replace(
            pipeline_state=time,
            obs=target,
            reward=self.bonus - jnp.square(miss),
            done=done,
            metrics={"miss": miss},
            info={**state.info, "rng": rng},
        )

    @property
    def observation_size(self):
        return 1

    @property
    def action_size(self):
        return 1

    @property
    def backend(self):
        return "none"


class StandIn(envs.Env):
    """`Aim` in the place of BP2Env, with the observations, actions, metrics and levels
    that a run's files need.

    Args:
        faults: what breaks in one of about `rarity` steps: `physics`, `state`,
            `privileged_state`, `reward` or a new episode's `reset` become NaN, a `huge`
            reward is finite but for its square.
    """

    def __init__(self, *faults: str, rarity: float = 100.0):
        self.faults, self.rarity = faults, rarity

    def reset(self, rng):
        return self._begin(rng, jnp.zeros(()))

    def restart(self, state, rng):
        fresh: Any = self._begin(rng, state.info["curriculum"])
        return fresh.replace(obs=self._break(fresh.obs, "reset", fresh.info["rng"]))

    def _begin(self, rng, level):
        rng, key = jax.random.split(rng)
        zero: Any = jnp.zeros(())
        return envs.State(
            zero,
            self._show(key),
            zero,
            zero,
            self._measure(zero),
            {"rng": rng, "curriculum": level},
        )

    def step(self, state: Any, action):
        rng, key = jax.random.split(state.info["rng"])
        miss = jnp.mean(jnp.square(action - state.obs["state"][:12]))
        obs = {
            name: self._break(value, name, rng)
            for name, value in self._show(key).items()
        }
        huge = jnp.where(self._strikes("huge", rng), -1e30, 0.0)
        return state.replace(
            pipeline_state=self._break(state.pipeline_state + 1.0, "physics", rng),
            obs=obs,
            reward=self._break(-miss, "reward", rng) + huge,
            done=jnp.zeros(()),
            metrics=self._measure(miss),
            info={
                "rng": rng,
                "curriculum": jnp.minimum(state.info["curriculum"] + 0.01, 1.0),
            },
        )

    def _show(self, key):
        target = jax.random.uniform(key, (47,), minval=-1.0, maxval=1.0)
        return {"state": target, "privileged_state": target[:20]}

    def _measure(self, miss):
        bins = {
            f"{kind}/{lower:g}": jnp.float32(lower == 0)
            for kind in ("share", "error")
            for lower in SPEED_BINS
        }
        return {**bins, "speed_error": miss}

    def _strikes(self, fault, rng):
        seed = sum(fault.encode())  # each strikes by itself
        return (
            jax.random.uniform(jax.random.fold_in(rng, seed))
            < (fault in self.faults) / self.rarity
        )

    def _break(self, values, fault, rng):
        return jax.tree.map(
            lambda x: jnp.where(self._strikes(fault, rng), jnp.nan, x), values
        )

    @property
    def observation_size(self):
        return {"state": 47, "privileged_state": 20}

    @property
    def action_size(self):
        return 12

    @property
    def backend(self):
        return "none"


def train(learner: PPO, steps: int, seed: int = 0):
    state, history = learner.init(seed), []
    for _ in range(steps):
        state, metrics = learner.train_step(state)
        history.append(jax.device_get(metrics))
    return state, history


def main(out: str) -> None:
    """Train 20 steps; save the parameters, the robots' states, and the policy gradient
    under rewards that differ by robot."""
    learner = PPO(Aim(), TINY)
    state, _ = train(learner, 20)
    keys = jax.random.split(jax.random.PRNGKey(1), TINY.num_envs)
    _, data, _ = jax.jit(learner.unroll)(
        state.params, state.normalizer, state.fleet, keys
    )
    unequal = data._replace(
        reward=data.reward + 10.0 * jnp.arange(TINY.num_envs)[:, None]
    )
    gradient = jax.jit(
        lambda params, data: learner.differentiate(
            params, state.normalizer, data, state.step
        )[1]
    )

    def policy_gradient(data: Any) -> np.ndarray:
        return np.asarray(ravel_pytree(gradient(state.params, data).policy)[0])

    np.savez(
        out,
        devices=learner.mesh.size,
        params=ravel_pytree(jax.device_get(state.params))[0],
        env_keys=jax.device_get(state.fleet.info["rng"]),
        targets=jax.device_get(data.observation),
        log_prob=jax.device_get(data.extras["policy_extras"]["log_prob"])[:, 0],
        gradient=policy_gradient(unequal),
        gradient_by_quarters=np.mean(
            [
                policy_gradient(jax.tree.map(lambda x, i=i: x[i : i + 4], unequal))
                for i in range(0, 16, 4)
            ],
            axis=0,
        ),
    )


if __name__ == "__main__":
    main(sys.argv[1])
