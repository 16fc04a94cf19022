"""Trajectories on meshes coarse enough to be solved in seconds."""

import functools

from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Solution

COARSE = 6  # intervals a segment


@functools.cache
def coarse_trot() -> Solution:
    """Return a trot at 10 m/s."""
    return solve(Problem(speed=10.0, intervals=COARSE))
