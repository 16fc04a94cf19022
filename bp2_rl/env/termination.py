"""What a fall is: in training, in the judge's runs, and wherever else a robot may be down."""

from typing import Any, NamedTuple

from jaxtyping import Bool, Float

from bp2_rl.settings.env import TerminationConfig


class Fall(NamedTuple):
    """Why a robot is down, if it is; NumPy or JAX, with the batch axes of the states."""

    exploded: Bool[Any, "..."]  # its state is no longer that of a robot
    too_low: Bool[Any, "..."]
    tilted: Bool[Any, "..."]

    @property
    def happened(self) -> Bool[Any, "..."]:
        """Whether it is down for any reason."""
        return self.exploded | self.too_low | self.tilted


def fall(qpos: Float[Any, "... 23"], qvel: Float[Any, "... 22"], config: TerminationConfig) -> Fall:
    """Judge a state in MuJoCo's coordinates; NumPy and JAX alike."""
    xp = qpos.__array_namespace__()
    # Every comparison is one that NaN fails.
    sound = xp.all(xp.isfinite(qpos), axis=-1) & xp.all(xp.abs(qvel) <= config.max_speed, axis=-1)
    up = 1.0 - 2.0 * (qpos[..., 4] ** 2 + qpos[..., 5] ** 2)  # vertical part of the trunk's z axis
    return Fall(~sound, ~(qpos[..., 2] >= config.min_height), ~(up >= config.min_up))
