"""A single run of the simulator, and policies for it that nobody trained."""

import jax.numpy as jnp

from bp2_rl.simulation.rollout import RunRequest, simulate


def no_action(observation):
    """Hold the standing pose, or follow the reference, as the control mode has it."""
    return 0.0 * observation[..., :12]


def kick(observation):
    """Take the largest action there is, left and right in turn: torques reach every
    limit, and robots fall."""
    return 100.0 * jnp.sign(observation[..., 5:17])


def run_one(policy, schedule, config, **request):
    """Return the trajectory of a single simulated run; `request` are fields of
    `RunRequest`."""
    [run] = simulate(policy, [RunRequest(schedule, **request)], config)
    return run
