"""Write a reward term, and compare it with the other terms before any training.

    python examples/reward_term.py

A term that is nearly constant teaches nothing; one that outweighs tracking teaches
standing still. Half a second of the reference motion, played without a policy, shows
the size of each term.
"""

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.base.processes import keep_compiled
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.rewards import RewardInputs, Scalar, SharedValues
from bp2_rl.settings.env import Impl, RewardConfig
from bp2_rl.settings.presets import preset
from bp2_rl.settings.task import RewardTerm, Task


def level_trunk(x: RewardInputs, config: RewardConfig, at: SharedValues) -> Scalar:
    """Return 1 for a level trunk, less for a leaning one; e_z is the trunk's vertical
    axis, (0, 0, 1) when level."""
    del config, at  # the same at every command
    return jnp.exp(-20.0 * (1.0 - x.e_z[2]))


TASK = Task(rewards=[RewardTerm("level_trunk", level_trunk, imitation=0.1)])
"""The task of `python train.py --task examples/reward_term.py`."""


def weigh(steps: int, robots: int, impl: Impl = "kernel") -> dict[str, float]:
    """Return the mean of every term over `steps` control steps of `robots` robots, with
    actions of zero."""
    config = preset("imitation", "smoke", task=TASK).env
    env = BP2Env(config, impl=impl, num_robots=robots)
    step = jax.jit(jax.vmap(env.step))
    state = jax.jit(jax.vmap(env.reset))(
        jax.random.split(jax.random.PRNGKey(0), robots)
    )
    # An action is added to the reference motion (`control.mode`), so zeros play the
    # reference.
    zeros = jnp.zeros((robots, env.action_size))
    seen = []
    for _ in range(steps):
        state = step(state, zeros)
        seen.append(
            {
                name: np.asarray(state.metrics[f"reward/{name}"])
                for name in env.reward_terms
            }
        )
    return {
        name: float(np.mean([terms[name] for terms in seen]))
        for name in env.reward_terms
    }


def main() -> None:
    """Print all terms, the heaviest first."""
    keep_compiled()
    for name, mean in sorted(
        weigh(steps=100, robots=32).items(), key=lambda term: -term[1]
    ):
        print(f"{name:16} {mean:7.4f}")


if __name__ == "__main__":
    main()
