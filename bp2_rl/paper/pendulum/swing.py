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
    system = _System(released, mass_ratio)
    solved = solve_ivp(system.rates, (0.0, time[-1]), system.start, "DOP853", time, rtol=tolerance, atol=tolerance)
    position, rate = np.moveaxis(solved.y.reshape(*system.shape, len(time)), -1, 1)
    return SwingMotion(mass_ratio, time, position[..., 0], rate[..., 0], position[..., 1:], rate[..., 1:])


class _System:
    """Pendulums as SciPy sees them: one vector of positions, then rates, each of the beam and then of the pendulums."""

    def __init__(self, released: Float[np.ndarray, "*many pendulums"], mass_ratio: Float[np.ndarray, "*many"]):
        self.mass_ratio = mass_ratio
        *many, pendulums = released.shape
        self.shape = (2, *many, 1 + pendulums)
        start = np.zeros(self.shape)
        start[0, ..., 1:] = released
        self.start = start.ravel()
        self._idle = np.zeros_like(released)

    def rates(self, _: float, state: np.ndarray) -> np.ndarray:
        """How fast a state changes."""
        position, rate = state.reshape(self.shape)
        changes = np.empty(self.shape)
        changes[0] = rate
        changes[1, ..., 0], changes[1, ..., 1:] = beam.accelerations(
            position[..., 1:], rate[..., 1:], self._idle, self.mass_ratio
        )
        return changes.ravel()
