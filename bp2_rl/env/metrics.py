"""What a control step says of itself, for the log: numbers that the learner averages over robots and steps."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.env.observations import TrunkMotion
from bp2_rl.env.physics.interface import Effort
from bp2_rl.env.termination import Fall

SPEED_BINS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0)
"""Lower edges of the bins of commanded speed for which tracking errors are reported, m/s."""


class StepOutcome(NamedTuple):
    """One control step of one robot."""

    rewards: dict[str, Array]  # by row of Table S4
    command: Float[Array, "3"]  # that it was under
    motion: TrunkMotion  # afterwards
    effort: Effort
    level: Float[Array, ""]  # of the curriculum, afterwards
    fall: Fall


def metrics(step: StepOutcome) -> dict[str, Array]:
    """The numbers by name. `error/A` over `share/A` is the mean speed error at commands from A m/s to the next bin."""
    error = jnp.abs(step.motion.velocity[0] - step.command[0])
    speed = jnp.abs(step.command[0])
    named = {f"reward/{name}": value for name, value in step.rewards.items()}
    uppers = (*SPEED_BINS[1:], np.inf)
    for lower, upper in zip(SPEED_BINS, uppers, strict=True):
        inside = ((speed >= lower) & (speed < upper)).astype(jnp.float32)
        named[f"share/{lower:g}"] = inside
        named[f"error/{lower:g}"] = inside * error
    exploded, too_low, tilted, self_collision = step.fall
    if self_collision is not None:
        named["fall/self_collision"] = (self_collision & ~tilted & ~too_low & ~exploded).astype(jnp.float32)
    return named | {
        "speed_error": error,
        "curriculum_level": step.level,
        "speed": step.motion.velocity[0],
        "power": jnp.sum(jnp.maximum(step.effort.power, 0.0)),
        "fall/exploded": exploded.astype(jnp.float32),
        "fall/too_low": (too_low & ~exploded).astype(jnp.float32),
        "fall/tilted": (tilted & ~too_low & ~exploded).astype(jnp.float32),
    }
