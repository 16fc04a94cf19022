"""BP2 as pendulums on a beam: its legs hang from its trunk, so much is left of it
here."""

import math

from bp2_rl.robot import bp2, conventions

LEGS = len(conventions.LEGS)
MASS_RATIO = (
    4.0 * bp2.TRUNK_QUARTER_MASS / (bp2.THIGH_MASS + bp2.SHANK_MASS + bp2.TOE_MASS)
)
"""Trunk over leg."""
LEG_LENGTH = bp2.THIGH_LENGTH
"""m, of the pendulum that a leg stands for. ASSUMED: the leg's mass is in its thigh,
folded up to its knee."""
STRIDE_FREQUENCY = 3.2
"""Hz, DERIVED: the period of the shipped library's trot at 10 m/s is 0.315 s."""
HIP_AMPLITUDE = 0.6
"""rad, ASSUMED. In that trot a hip swings by 0.75 rad either way; a wider swing gains
less."""


def reduced_frequency(frequency: float, length: float) -> float:
    """W: a frequency in Hz over that of a small swing of a pendulum of `length` in
    m."""
    return 2.0 * math.pi * frequency * math.sqrt(length / conventions.GRAVITY)
