"""Warnings about a training that goes wrong, from its metrics."""

from collections.abc import Iterator, Mapping

import jax
import numpy as np

from bp2_rl.learning.batched_env import FAULTS
from bp2_rl.learning.checkpoint import leaves_by_path
from bp2_rl.learning.ppo import PPO, TrainState
from bp2_rl.settings.ppo import PPOConfig

COLLAPSED_STD = 0.05
"""Share of the initial standard deviation below which the policy explores too
little."""
EXPLODED_KL = 10.0
"""Multiple of the desired KL divergence that is warned about at the least learning
rate. From twice on the rate is lowered, which takes a few train steps: a training's
first ones may be far off, and this ends by itself."""
LEAST_RATE = 1e-5
"""Least learning rate to which Brax's `adaptive_kl_learning_rate` goes."""
BLOWN_VALUE = 10.0
"""Multiple of the square of the largest return the rewards allow, above which the value
loss is warned about. A critic that says 0 stands at 1/2 at most."""
FALLING = 0.05
"""Falls per robot and control step above which a warning is given: episodes of 0.1 s,
which teach nothing but how to start."""
EXPLODING = 1e-3
"""Falls by exploding physics per robot and control step above which a warning is given:
each robot every 5 s. A correct simulation has none."""

LOSS_TERMS = ("policy_loss", "v_loss", "entropy_loss", "kl_mean")
"""The terms of the loss, and the divergence that sets the learning rate."""


def warnings(metrics: Mapping[str, float], config: PPOConfig) -> dict[str, str]:
    """Return signs of a training that goes wrong, in words by their names, from the
    metrics' means over a logging interval."""
    std, kl = metrics["loss/policy_dist_mean_std"], metrics["loss/kl_mean"]
    rate = metrics["loss/learning_rate"]
    horizon = min(1.0 / max(1.0 - config.discounting, 1e-9), config.episode_length)
    largest = metrics["reward_square"] * (config.reward_scaling * horizon) ** 2
    value_loss = metrics["loss/v_loss"] / (config.value_coefficient or 1.0)
    falls, exploded = metrics["falls"], metrics.get("fall/exploded", 0.0)
    faults = [f"{name} {metrics[name]:.1g}" for name in FAULTS if metrics[name] > 0]
    signs = {
        "entropy": (
            std < COLLAPSED_STD * config.initial_std,
            f"the policy hardly explores any more: standard deviation {std:.2g}; raise ppo.entropy_cost",
        ),
        "kl": (
            config.desired_kl is not None
            and kl > EXPLODED_KL * config.desired_kl
            and rate < 2.0 * LEAST_RATE,
            f"the policy jumps at the least learning rate: mean KL {kl:.2g}, desired {config.desired_kl}; "
            "take fewer ppo.num_epochs",
        ),
        "value": (
            value_loss > BLOWN_VALUE * largest,
            f"the critic blows up: value loss {value_loss:.2g}, returns of {largest**0.5:.2g} at most; "
            "lower ppo.learning_rate",
        ),
        "falls": (
            falls > FALLING,
            f"the robots fall at once: {falls:.2g} falls a control step",
        ),
        "exploded": (
            exploded > EXPLODING,
            f"the physics explodes: {exploded:.2g} times a robot a control step",
        ),
        "faults": (
            bool(faults),
            f"steps that are not finite (a robot a control step): {', '.join(faults)}",
        ),
    }
    return {name: words for name, (present, words) in signs.items() if present}


def explain(learner: PPO, state: TrainState) -> str:
    """Repeat a train step that was not finite, from `state`, piece by piece; return
    what was not finite first, in words."""
    for place, piece in _train_step_in_pieces(learner, state):
        if found := _not_finite(piece):
            return f"{place}: {found}"
    return "nothing: done piece by piece, this train step is finite; was it trained on another machine or version?"


def _train_step_in_pieces(
    learner: PPO, state: TrainState
) -> Iterator[tuple[str, object]]:
    """Yield what a train step computes from `state`, in its order, each with its place
    in words."""
    yield "before the train step", state
    config = learner.config
    _, keys, key_sgd = learner.draw_keys(state)
    _, data, _ = jax.jit(learner.unroll)(
        state.params, state.normalizer, state.fleet, keys
    )
    yield "in the batch (of robots and times)", data
    differentiate = jax.jit(learner.differentiate)
    shuffle = jax.jit(learner.shuffle)
    gradient_step = jax.jit(learner.gradient_step)
    for epoch, key in enumerate(jax.random.split(key_sgd, config.num_epochs), start=1):
        batches = shuffle(data, key)
        for i in range(config.num_minibatches):
            place = f"in minibatch {i + 1} of {config.num_minibatches}, epoch {epoch} of {config.num_epochs}"
            minibatch = jax.tree.map(lambda x, i=i: x[i], batches)
            terms, gradient = differentiate(
                state.params, state.normalizer, minibatch, state.step
            )
            yield place, {"loss": {name: terms[name] for name in LOSS_TERMS}}
            yield place, {"gradient": gradient}
            (params, optimizer), terms = gradient_step(state, minibatch)
            yield place, {"loss": terms, "params": params, "optimizer": optimizer}
            state = state.replace(params=params, optimizer=optimizer)
    normalizer = learner.update_normalizer(state.normalizer, data.observation)
    yield "after the gradient steps", {"normalizer": normalizer}


def _not_finite(piece: object) -> str | None:
    """Return the first leaf that is not finite, in words."""
    for path, leaf in leaves_by_path(piece).items():
        bad = ~np.isfinite(np.asarray(leaf))
        if bad.any():
            first = [int(i) for i in np.argwhere(bad)[0]]
            where = (
                f": {bad.sum()} of {bad.size} numbers, the first at {first}"
                if first
                else ""
            )
            return f"{path} is not finite{where}"
    return None
