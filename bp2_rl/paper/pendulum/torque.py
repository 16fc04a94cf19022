"""What it takes to move pendulums as one wants: the motors' torques with the beam free,
and with it fixed.

The motion is the paper's: th_i = A sin(W t + phi_i), W the frequency over w0. It is
looked at over one cycle, in which the beam's momentum stays zero.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.pendulum import beam

SAMPLES = 256
"""Of a cycle. A peak between two of them is found to 1e-7 of it."""


@dataclasses.dataclass(frozen=True)
class PendulumCycle:
    """One cycle of a motion; systems, then time, then pendulums."""

    angle: Float[np.ndarray, " samples"]  # W t, rad
    theta: Float[np.ndarray, "*many samples pendulums"]
    rate: Float[np.ndarray, "*many samples pendulums"]
    # u~, torque with the beam fixed, in m g l
    fixed: Float[np.ndarray, "*many samples pendulums"]
    # u^c, what the free beam adds
    coupled: Float[np.ndarray, "*many samples pendulums"]

    @property
    def free(self) -> Float[np.ndarray, "*many samples pendulums"]:
        """Torque with the beam free, u."""
        return self.fixed + self.coupled


def drive(
    phase: Float[np.ndarray, "*#many pendulums"],
    amplitude: Float[np.ndarray, "*#many"],
    frequency: Float[np.ndarray, "*#many"],
    mass_ratio: Float[np.ndarray, "*#many"],
) -> PendulumCycle:
    """The torques of pendulums that swing alike but for their phases.

    Args:
        phase: of each pendulum, rad.
        amplitude: A, rad.
        frequency: W, over w0.
        mass_ratio: R.
    """
    angle = np.arange(SAMPLES) * (2.0 * np.pi / SAMPLES)
    amplitude, frequency, mass_ratio = (
        np.asarray(values)[..., None] for values in (amplitude, frequency, mass_ratio)
    )
    turned = angle[:, None] + phase[..., None, :]
    swing = amplitude[..., None] * np.sin(turned)
    rate = (amplitude * frequency)[..., None] * np.cos(turned)
    acceleration = -(frequency[..., None] ** 2) * swing
    theta, rate, acceleration = np.broadcast_arrays(swing, rate, acceleration)
    fixed = beam.fixed_torque(theta, acceleration)
    return PendulumCycle(
        angle,
        theta,
        rate,
        fixed,
        beam.coupled_torque(theta, rate, acceleration, mass_ratio),
    )


def peak(
    torque: Float[np.ndarray, "*many samples pendulums"],
) -> Float[np.ndarray, "*many pendulums"]:
    """The greatest magnitude over a cycle, between samples too."""
    at = np.argmax(np.abs(torque), axis=-2, keepdims=True)
    samples = ((at + step) % torque.shape[-2] for step in (-2, -1, 0, 1, 2))
    far, before, here, after, beyond = (
        np.take_along_axis(torque, at, axis=-2)[..., 0, :] for at in samples
    )
    # Derivatives by the sample, right to its fourth power; the third to its second.
    slope = (8.0 * (after - before) - (beyond - far)) / 12.0
    bend = (16.0 * (after + before) - (beyond + far) - 30.0 * here) / 12.0
    third = (beyond - far) / 2.0 - (after - before)
    # where the cubic through them is level; a torque that is the same throughout stays
    # put
    top = np.zeros_like(here)
    for _ in range(2):
        climb = slope + top * (bend + top * third / 2.0)
        fall = bend + top * third
        top -= np.divide(climb, fall, out=np.zeros_like(here), where=fall != 0.0)
    return np.abs(here + top * (slope + top * (bend / 2.0 + top * third / 6.0)))


def root_mean_square(
    torque: Float[np.ndarray, "*many samples pendulums"],
) -> Float[np.ndarray, "*many pendulums"]:
    """Over a cycle."""
    return np.sqrt(np.mean(torque**2, axis=-2))
