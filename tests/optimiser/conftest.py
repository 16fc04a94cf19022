"""Trajectories on meshes coarse enough to be solved in seconds."""

import pytest

from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Solution

COARSE = 6  # intervals a segment


@pytest.fixture(scope="session")
def trot() -> Solution:
    """A trot at 10 m/s."""
    return solve(Problem(speed=10.0, intervals=COARSE))
