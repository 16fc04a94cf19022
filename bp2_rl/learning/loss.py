"""PPO's loss: the same function as Brax's, to rounding, in a form that a GPU computes
in few pieces."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from brax.training.acme.running_statistics import RunningStatisticsState
from brax.training.agents.ppo import networks
from brax.training.agents.ppo.losses import PPONetworkParams
from brax.training.types import Transition
from jaxtyping import Array, Float

from bp2_rl.settings.ppo import PPOConfig


def ppo_loss(
    network: networks.PPONetworks,
    config: PPOConfig,
    params: PPONetworkParams,
    normalizer: RunningStatisticsState,
    data: Transition,
    entropy_cost: Array | float,
    mean: Callable[[Array], Array] = jnp.mean,
) -> tuple[Array, dict[str, Array]]:
    """Return the loss of a minibatch, and its terms.

    With rewards r, values V, episodes that ended (e = 1; 0 else) and log probabilities
    l and l_old of the actions under the policy and under the one that acted, going
    backwards in time,

        delta_t = r_t + gamma (1 - e_t) V_t+1 - V_t
        v_t - V_t = delta_t + gamma lambda (1 - e_t) (v_t+1 - V_t+1)          the critic's targets (GAE)
        A_t = r_t + gamma (1 - e_t) v_t+1 - V_t                               normalised over a minibatch
        rho_t = exp(l_t - l_old_t)
        loss = -mean min(rho A, clip(rho, 1 - epsilon, 1 + epsilon) A) + c_v/2 mean (v - V)^2 - c_e mean entropy

    v - V, delta and A are 0 at a step at which the time limit cut an episode short.
    gamma is `discounting`, lambda `gae_lambda`, epsilon `clipping`, c_v
    `value_coefficient` and c_e `entropy_cost`.

    Args:
        network: actor and critic; the actor's distribution is normal.
        config: hyperparameters.
        params: of the networks; the gradient is by these.
        normalizer: statistics of the observations.
        data: axes (robot, time); of `next_observation` the last one in time alone.
        entropy_cost: c_e.
        mean: over the whole minibatch, for the advantages; `data`, and the loss, may be
            one device's part.
    """
    values = _values(network, params, normalizer, data)
    targets, advantages = targets_and_advantages(values, data, config)
    distribution: Any = network.parametric_action_distribution
    acted = data.extras["policy_extras"]
    output = network.policy_network.apply(normalizer, params.policy, data.observation)
    ratio = jnp.exp(
        distribution.log_prob(output, acted["raw_action"]) - acted["log_prob"]
    )
    clipped = jnp.clip(ratio, 1.0 - config.clipping, 1.0 + config.clipping)
    advantages -= mean(advantages)
    advantages /= jnp.sqrt(mean(jnp.square(advantages))) + 1e-8
    now, then = (
        distribution.create_dist(parameters)
        for parameters in (output, acted["distribution_params"])
    )
    terms = {
        "policy_loss": -jnp.mean(jnp.minimum(ratio * advantages, clipped * advantages)),
        "v_loss": 0.5
        * config.value_coefficient
        * jnp.mean(jnp.square(targets - values[:, :-1])),
        "entropy_loss": -entropy_cost * jnp.mean(jnp.sum(now.entropy(), axis=-1)),
    }
    total = terms["policy_loss"] + terms["v_loss"] + terms["entropy_loss"]
    terms |= {
        "kl_mean": jnp.mean(now.kl_divergence(then)),
        "policy_dist_mean_std": jnp.mean(now.scale),
    }
    return total, {"total_loss": total, **terms}


def _values(
    network: networks.PPONetworks,
    params: PPONetworkParams,
    normalizer: RunningStatisticsState,
    data: Transition,
) -> Float[Array, "robots values"]:
    """Return the critic's values of all observations, including the observation after
    the last step."""
    apply = network.value_network.apply
    present, last = (
        apply(normalizer, params.value, seen)
        for seen in (data.observation, data.next_observation)
    )
    return jnp.concatenate([present, last], axis=1)


def targets_and_advantages(
    values: Float[Array, "robots values"], data: Transition, config: PPOConfig
) -> tuple[Float[Array, "robots times"], Float[Array, "robots times"]]:
    """Return the critic's targets v and the advantages A, through which no gradient
    flows.

    As Brax's `compute_gae`, but without its loop, which launches several kernels for
    each time step of each minibatch: on a GPU that took a sixth of a training.
    """
    values = jax.lax.stop_gradient(values)
    truncation = data.extras["state_extras"]["truncation"]
    goes_on = 1.0 - (1.0 - data.discount) * (1.0 - truncation)
    counts = 1.0 - truncation
    rewards = config.reward_scaling * data.reward
    discount = config.discounting * goes_on
    present, following = values[:, :-1], values[:, 1:]
    delta = counts * (rewards + discount * following - present)
    keep = counts * config.gae_lambda * discount
    beyond = jnp.zeros_like(delta[:, 0])
    backwards = []
    for time in reversed(range(delta.shape[1])):
        beyond = delta[:, time] + keep[:, time] * beyond
        backwards.append(beyond)
    targets = present + jnp.stack(backwards[::-1], axis=1)
    later = jnp.concatenate([targets[:, 1:], values[:, -1:]], axis=1)
    return targets, counts * (rewards + discount * later - present)
