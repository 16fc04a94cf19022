"""Pendulums that hang from a sliding beam: their equations, their energies, what they keep, the torques that move them.

Everything is dimensionless, as in the paper: time in 1 / w0 = sqrt(l / g), the beam's displacement in l, energy and
torque in m g l. The mass ratio R is the beam's mass over one pendulum's. The last axis of an array counts the
pendulums; the axes before it are whatever there is many of, and so are those of R. The paper has two pendulums; here
there are as many as the arrays say.
"""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

Angles = Float[np.ndarray, "*many pendulums"]
Many = Float[np.ndarray, "*#many"]
"""One number for each system of pendulums."""


@dataclasses.dataclass(frozen=True)
class Energies:
    """Who has how much, in m g l. `pendulums` and `beam` add up to what is kept; `beam_frame` is no part of it."""

    pendulums: Any  # "*many pendulums", as seen from the ground
    beam: Any  # "*many"
    beam_frame: Any  # "*many pendulums", as seen from the beam: th'^2 / 2 + 1 - cos th


def accelerations(
    theta: Angles, rate: Angles, torque: Angles, mass_ratio: Many
) -> tuple[Float[np.ndarray, "*many"], Angles]:
    """The beam's and the pendulums' accelerations under the motors' torques (paper, Eq. dimensionless)."""
    sin, cos = np.sin(theta), np.cos(theta)
    force = np.sum(sin * rate**2 + sin * cos - cos * torque, axis=-1)
    # At least R: the beam always has inertia of its own.
    beam = np.asarray(force / (mass_ratio + theta.shape[-1] - np.sum(cos**2, axis=-1)))
    return beam, torque - sin - cos * beam[..., None]


def fixed_torque(theta: Angles, acceleration: Angles) -> Angles:
    """The torque that a motion takes where the beam cannot move (paper, u~)."""
    return acceleration + np.sin(theta)


def coupled_torque(theta: Angles, rate: Angles, acceleration: Angles, mass_ratio: Many) -> Angles:
    """What a free beam adds to that (paper, u^c in Eq. active torque)."""
    sin, cos = np.sin(theta), np.cos(theta)
    push = np.sum(sin * rate**2 - cos * acceleration, axis=-1) / (mass_ratio + theta.shape[-1])
    return cos * push[..., None]


def momentum(theta: Angles, rate: Angles, beam_rate: Many, mass_ratio: Many) -> Float[np.ndarray, "*many"]:
    """The horizontal momentum, in m l w0: kept, whatever the motors do."""
    return np.asarray((mass_ratio + theta.shape[-1]) * beam_rate + np.sum(np.cos(theta) * rate, axis=-1))


def energies(theta: Angles, rate: Angles, beam_rate: Many, mass_ratio: Many) -> Energies:
    """The energies, of which the pendulums' and the beam's add up to what the motors have put in."""
    sin, cos = np.sin(theta), np.cos(theta)
    kinetic = ((beam_rate[..., None] + cos * rate) ** 2 + (sin * rate) ** 2) / 2.0
    return Energies(kinetic + 1.0 - cos, mass_ratio * beam_rate**2 / 2.0, rate**2 / 2.0 + 1.0 - cos)
