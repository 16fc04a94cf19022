"""Metrics of a control step, which the learner averages over robots and steps."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.env.observations import TrunkMotion
from bp2_rl.env.physics.interface import Effort
from bp2_rl.env.termination import Fall
from bp2_rl.reference.interface import Reference

SPEED_BINS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0)
"""Lower edges of the bins of commanded speed for which tracking errors are reported,
m/s."""


class StepOutcome(NamedTuple):
    """The outcome of a robot's control step, for its rewards and metrics."""

    command: Float[Array, "3"]  # of this control step
    reference: Reference  # at the end of the step
    effort: Effort
    motion: TrunkMotion  # afterwards
    fall: Fall


def metrics(
    step: StepOutcome, rewards: Mapping[str, Array], level: Float[Array, ""]
) -> dict[str, Array]:
    """Return the metrics of a control step by name, with its rewards by term and the
    curriculum level afterwards.

    `error/A` over `share/A` is the mean speed error at commands from A m/s to the next
    bin. A fall counts once, under the first of its reasons.
    """
    error = jnp.abs(step.motion.velocity[0] - step.command[0])
    speed = jnp.abs(step.command[0])
    named = {f"reward/{name}": value for name, value in rewards.items()}
    uppers = (*SPEED_BINS[1:], np.inf)
    for lower, upper in zip(SPEED_BINS, uppers, strict=True):
        inside = ((speed >= lower) & (speed < upper)).astype(jnp.float32)
        named[f"share/{lower:g}"] = inside
        named[f"error/{lower:g}"] = inside * error
    earlier = jnp.zeros((), bool)
    for name, reason in step.fall.reasons.items():
        named[f"fall/{name}"] = (reason & ~earlier).astype(jnp.float32)
        earlier = earlier | reason
    return named | {
        "speed_error": error,
        "curriculum_level": level,
        "speed": step.motion.velocity[0],
        "power": jnp.sum(jnp.maximum(step.effort.power, 0.0)),
    }
