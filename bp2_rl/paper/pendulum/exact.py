"""Closed forms of pendulums on a beam: the laws of small swings, and a rule of thumb.

W is a frequency over w0, z pulls of the pendulums on each other, A an amplitude in rad.
Two pendulums unless an argument counts them.
"""

import math

import numpy as np
from jaxtyping import Float


def small_torque_ratio(
    phase: Float[np.ndarray, "*#many"],
    frequency: Float[np.ndarray, "*#many"],
    mass_ratio: Float[np.ndarray, "*#many"],
) -> Float[np.ndarray, "*many"]:
    """Return the ratio of peak torques, beam free over beam fixed, of small swings a
    phase apart.

    Infinite at W = 1, where a fixed beam asks for no torque.
    """
    own = 1.0 - frequency**2
    pull = frequency**2 * (1.0 + np.exp(1j * phase)) / (mass_ratio + 2.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.abs(own + pull) / np.abs(own))


def boundary_frequency(mass_ratio: float) -> float:
    """Return the frequency W above which a free beam lowers the torque of small swings,
    and below which a free beam raises the torque, whatever the phase."""
    return math.sqrt((mass_ratio + 2.0) / (mass_ratio + 1.0))


def small_gait_ratio(
    order: Float[np.ndarray, "*#many"], frequency: float, mass_ratio: float, legs: int
) -> Float[np.ndarray, "*many"]:
    """Return the ratio of root mean square torques (over time and legs), beam free over
    fixed, of many legs' small swings.

    It hangs on the gait by the order parameter alone, |mean e^(i phi)|.
    """
    pull = frequency**2 / (1.0 - frequency**2) * legs / (mass_ratio + legs)
    return np.asarray(np.sqrt(1.0 + order**2 * (2.0 * pull + pull**2)))


def trapping_ratio(amplitude: float) -> float:
    """Return the mass ratio above which a swing stays with its pendulum: 32 / A^2.

    The swing shifts its pendulum's frequency by -A^2 / 16, and the two do not exchange
    if that exceeds twice the splitting of their modes, 1 / R.
    """
    return 32.0 / amplitude**2
