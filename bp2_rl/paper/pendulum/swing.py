"""The free motion of pendulums that are let go at rest: SciPy's DOP853 at tight tolerances."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bp2_rl.paper.pendulum import beam

NATURAL_PERIOD = 2.0 * math.pi
"""T0, of one small swing from a fixed beam."""


@dataclasses.dataclass(frozen=True)
class SwingMotion:
    """Systems of pendulums over time; time first, then the systems, then the pendulums of each."""

    mass_ratio: Float[np.ndarray, "*many"]
    time: Float[np.ndarray, " samples"]  # in 1 / w0
    beam_position: Float[np.ndarray, "samples ..."]  # in l
    beam_rate: Float[np.ndarray, "samples ..."]
    theta: Float[np.ndarray, "samples ... pendulums"]
    rate: Float[np.ndarray, "samples ... pendulums"]

    @property
    def energies(self) -> beam.Energies:
        """At each time."""
        return beam.energies(self.theta, self.rate, self.beam_rate, self.mass_ratio)

    @property
    def accelerations(self) -> tuple[Float[np.ndarray, "samples ..."], Float[np.ndarray, "samples ... pendulums"]]:
        """The beam's and the pendulums', at each time."""
        return beam.accelerations(self.theta, self.rate, np.zeros_like(self.theta), self.mass_ratio)


def swing(
    released: Float[np.ndarray, "*many pendulums"],
    mass_ratio: Float[np.ndarray, "*many"],
    time: Float[np.ndarray, " samples"],
    tolerance: float = 1e-12,
) -> SwingMotion:
    """Let pendulums go at these angles, at rest.

    Args:
        released: angles, rad.
        mass_ratio: R of each system.
        time: when the state is wanted, ascending from 0, in 1 / w0.
        tolerance: of a step, relative to the state and absolute.
    """
    *many, pendulums = released.shape
    shape = (2, *many, 1 + pendulums)  # positions, then rates, each of the beam and then of the pendulums
    start, idle = np.zeros(shape), np.zeros_like(released)
    start[0, ..., 1:] = released

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        position, rate = state.reshape(shape)
        beam_rates, pendulum_rates = beam.accelerations(position[..., 1:], rate[..., 1:], idle, mass_ratio)
        return np.stack((rate, np.concatenate((beam_rates[..., None], pendulum_rates), axis=-1))).ravel()

    solved = solve_ivp(rates, (0.0, time[-1]), start.ravel(), "DOP853", time, rtol=tolerance, atol=tolerance)
    position, rate = np.moveaxis(solved.y.reshape(*shape, len(time)), -1, 1)
    return SwingMotion(mass_ratio, time, position[..., 0], rate[..., 0], position[..., 1:], rate[..., 1:])
