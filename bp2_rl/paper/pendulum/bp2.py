"""BP2 as pendulums on a beam: its legs hang from its trunk, so much is left of it here."""

import math

from bp2_rl.robot import specs

LEGS = len(specs.LEGS)
MASS_RATIO = 4.0 * specs.TRUNK_QUARTER_MASS / (specs.THIGH_MASS + specs.SHANK_MASS + specs.TOE_MASS)
"""Trunk over leg."""
LEG_LENGTH = specs.THIGH_LENGTH
"""m, of the pendulum that a leg stands for. ASSUMED: the leg's mass is in its thigh, folded up to its knee."""
STRIDE_FREQUENCY = 3.2
"""Hz, DERIVED: the period of the shipped library's trot at 10 m/s is 0.315 s."""
HIP_AMPLITUDE = 0.6
"""rad, ASSUMED. In that trot a hip swings by 0.75 rad either way; a wider swing gains less."""


def reduced_frequency(frequency: float, length: float) -> float:
    """W: a frequency in Hz over that of a small swing of a pendulum of `length` in m."""
    return 2.0 * math.pi * frequency * math.sqrt(length / specs.GRAVITY)
