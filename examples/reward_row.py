"""Write a reward row, and weigh it against the others before any training.

    python examples/reward_row.py

A row that is nearly constant teaches nothing; one that outweighs tracking teaches
standing still. A second of the reference motion, played without a policy, already
tells.
"""

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.base.processes import keep_compiled
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.rewards import ROWS, RewardInputs, Scalar, SharedTerms
from bp2_rl.settings.env import Impl, RewardConfig
from bp2_rl.settings.presets import preset


def level_trunk(x: RewardInputs, config: RewardConfig, at: SharedTerms) -> Scalar:
    """Up to 0.1 for a trunk that does not lean: e_z is its vertical axis, (0, 0, 1)
    when level."""
    del config, at  # the coefficient is ours, and the same at every command
    return 0.1 * jnp.exp(-20.0 * (1.0 - x.e_z[2]))


def weigh(steps: int, robots: int, impl: Impl = "kernel") -> dict[str, float]:
    """The mean of every row over so many control steps of so many robots, with actions
    of zero."""
    config = preset("imitation", "smoke").env
    env = BP2Env(
        config, impl=impl, num_robots=robots, rows={**ROWS, "level_trunk": level_trunk}
    )
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
            {name: np.asarray(state.metrics[f"reward/{name}"]) for name in env.rows}
        )
    return {name: float(np.mean([rows[name] for rows in seen])) for name in env.rows}


def main() -> None:
    """All rows, the heaviest first."""
    keep_compiled()
    for name, mean in sorted(
        weigh(steps=100, robots=32).items(), key=lambda row: -row[1]
    ):
        print(f"{name:16} {mean:7.4f}")


if __name__ == "__main__":
    main()
