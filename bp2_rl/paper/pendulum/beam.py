"""Pendulums that hang from a sliding beam: equations of motion, energies, momentum,
torques, and their free motion from rest (SciPy's DOP853 at tight tolerances).

Everything is dimensionless, as in the paper: time in 1 / w0 = sqrt(l / g), the beam's
displacement in l, energy and torque in m g l. The mass ratio R is the beam's mass over
one pendulum's. The last axis of an array counts the pendulums; the axes before it are
whatever there is many of, and so are those of R. The paper has two pendulums; here
there are as many as the arrays say.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

Angles = Float[np.ndarray, "*many pendulums"]
Many = Float[np.ndarray, "*#many"]
"""One number for each system of pendulums."""


class Energies(NamedTuple):
    """The energies of the pendulums and the beam, in m g l.

    `pendulums` and `beam` add up to what is kept; `beam_frame` is no part of it.
    """

    pendulums: Float[np.ndarray, "*many pendulums"]  # as seen from the ground
    beam: Float[np.ndarray, "*many"]
    # as seen from the beam: th'^2 / 2 + 1 - cos th
    beam_frame: Float[np.ndarray, "*many pendulums"]


def accelerations(
    theta: Angles, rate: Angles, torque: Angles, mass_ratio: Many
) -> tuple[Float[np.ndarray, "*many"], Angles]:
    """Return the beam's and the pendulums' accelerations under the motors' torques
    (paper, Eq. dimensionless)."""
    sin, cos = np.sin(theta), np.cos(theta)
    force = np.sum(sin * rate**2 + sin * cos - cos * torque, axis=-1)
    # At least R: the beam always has inertia of its own.
    beam = np.asarray(force / (mass_ratio + theta.shape[-1] - np.sum(cos**2, axis=-1)))
    return beam, torque - sin - cos * beam[..., None]


def fixed_torque(theta: Angles, acceleration: Angles) -> Angles:
    """Return the torque that a motion takes where the beam cannot move (paper, u~)."""
    return acceleration + np.sin(theta)


def coupled_torque(
    theta: Angles, rate: Angles, acceleration: Angles, mass_ratio: Many
) -> Angles:
    """Return the torque that a free beam adds to a motion (paper, u^c in Eq. active
    torque)."""
    sin, cos = np.sin(theta), np.cos(theta)
    push = np.sum(sin * rate**2 - cos * acceleration, axis=-1) / (
        mass_ratio + theta.shape[-1]
    )
    return cos * push[..., None]


def momentum(
    theta: Angles, rate: Angles, beam_rate: Many, mass_ratio: Many
) -> Float[np.ndarray, "*many"]:
    """Return the horizontal momentum of beam and pendulums, in m l w0: kept, whatever
    the motors do."""
    return np.asarray(
        (mass_ratio + theta.shape[-1]) * beam_rate
        + np.sum(np.cos(theta) * rate, axis=-1)
    )


def energies(
    theta: Angles, rate: Angles, beam_rate: Many, mass_ratio: Many
) -> Energies:
    """Return the energies of pendulums and beam; they add up to what the motors have
    put in."""
    sin, cos = np.sin(theta), np.cos(theta)
    kinetic = ((beam_rate[..., None] + cos * rate) ** 2 + (sin * rate) ** 2) / 2.0
    return Energies(
        kinetic + 1.0 - cos, mass_ratio * beam_rate**2 / 2.0, rate**2 / 2.0 + 1.0 - cos
    )


# --- Free motion ----------------------------------------------------------------------

NATURAL_PERIOD = 2.0 * math.pi
"""T0, the period of one small swing from a fixed beam."""


@dataclasses.dataclass(frozen=True)
class SwingMotion:
    """Motion of systems of pendulums; axes are time, then systems, then pendulums."""

    mass_ratio: Float[np.ndarray, "*many"]
    time: Float[np.ndarray, " samples"]  # in 1 / w0
    beam_position: Float[np.ndarray, "samples ..."]  # in l
    beam_rate: Float[np.ndarray, "samples ..."]
    theta: Float[np.ndarray, "samples ... pendulums"]
    rate: Float[np.ndarray, "samples ... pendulums"]

    @property
    def energies(self) -> Energies:
        """Energies of pendulums and beam at each time, in m g l."""
        return energies(self.theta, self.rate, self.beam_rate, self.mass_ratio)

    @property
    def accelerations(
        self,
    ) -> tuple[
        Float[np.ndarray, "samples ..."], Float[np.ndarray, "samples ... pendulums"]
    ]:
        """The accelerations of the beam and of the pendulums at each time."""
        return accelerations(
            self.theta, self.rate, np.zeros_like(self.theta), self.mass_ratio
        )


def swing(
    released: Float[np.ndarray, "*many pendulums"],
    mass_ratio: Float[np.ndarray, "*many"],
    time: Float[np.ndarray, " samples"],
    tolerance: float = 1e-12,
) -> SwingMotion:
    """Release pendulums at rest from the angles `released`, and return their free
    motion.

    Args:
        released: angles, rad.
        mass_ratio: R of each system.
        time: when the state is wanted, ascending from 0, in 1 / w0.
        tolerance: of a step, relative to the state and absolute.
    """
    *many, pendulums = released.shape
    # positions, then rates, each of the beam and then of the pendulums
    shape = (2, *many, 1 + pendulums)
    start = np.zeros(shape)
    idle = np.zeros_like(released)
    start[0, ..., 1:] = released

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        position, rate = state.reshape(shape)
        beam_rates, pendulum_rates = accelerations(
            position[..., 1:], rate[..., 1:], idle, mass_ratio
        )
        return np.stack(
            (rate, np.concatenate((beam_rates[..., None], pendulum_rates), axis=-1))
        ).ravel()

    solved = solve_ivp(
        rates,
        (0.0, time[-1]),
        start.ravel(),
        "DOP853",
        time,
        rtol=tolerance,
        atol=tolerance,
    )
    position, rate = np.moveaxis(solved.y.reshape(*shape, len(time)), -1, 1)
    return SwingMotion(
        mass_ratio,
        time,
        position[..., 0],
        rate[..., 0],
        position[..., 1:],
        rate[..., 1:],
    )
