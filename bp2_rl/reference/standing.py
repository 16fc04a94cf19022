"""A reference motion that stands still under every command, for learning without a
gait."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from bp2_rl.reference.interface import Reference
from bp2_rl.reference.kinematic_trot import KinematicGait
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

# of the phase clock that the policy sees; a trot at 10 m/s takes about a third of a
# second
CYCLES_PER_SECOND = 3.0


@dataclasses.dataclass(frozen=True)
class Standing:
    """The `ReferenceMotion` that stands."""

    hardware: HardwareSpec = IDEAL

    @property
    def height(self) -> float:
        """Height of the trunk's centre above the ground, m."""
        return KinematicGait(hardware=self.hardware).height

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Cycles per second."""
        return jnp.full(command.shape[:-1], CYCLES_PER_SECOND)

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return 1 for every command, so that a policy that is to find steps of its own
        sees the clock."""
        return jnp.ones(command.shape[:-1])

    def __call__(
        self, command: Float[Array, "... 3"], phase: Float[Array, "..."]
    ) -> Reference:
        """The standing pose, with the velocity that is commanded."""
        pose = KinematicGait(hardware=self.hardware)(jnp.zeros_like(command), phase)
        planar = jnp.concatenate(
            [command[..., :2], jnp.zeros_like(command[..., :1])], axis=-1
        )
        return pose.replace(velocity=planar)
