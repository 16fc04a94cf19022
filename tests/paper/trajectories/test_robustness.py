"""What the discretisation schemes leave of the energy balance."""

import pytest

from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Motion, Solution
from bp2_rl.paper.trajectories.robustness import SCHEMES, compare_schemes


def test_the_papers_scheme_leaks_energy_where_hermite_simpson_does_not():
    """On 8 intervals at 10 m/s, 13 % and 0.7 % of the motors' work were measured."""
    rows = list(
        compare_schemes(solve, Problem(speed=10.0), (8,), ("hermite-simpson", "paper"))
    )
    assert [(row.scheme, row.intervals) for row in rows] == [
        ("hermite-simpson", 8),
        ("paper", 8),
    ]
    exact, leaky = (row.energy_residual for row in rows)
    assert leaky > 0.05
    assert exact < 0.01


def test_a_finer_mesh_starts_from_the_coarser_one(trot):
    """A solver that knows the trot of any mesh records where it was told to start."""
    starts = []

    def recall(problem: Problem, start: Motion | None) -> Solution:
        starts.append(None if start is None else len(start.q[0]))
        assert problem.intervals == trot.problem.intervals
        return trot

    n = trot.problem.intervals
    rows = list(compare_schemes(recall, trot.problem, (n, n), ("hermite-simpson",)))
    assert starts == [None, 2 * n + 1]
    assert rows[0] == rows[1]
    assert rows[0].period == pytest.approx(trot.period)
    assert set(SCHEMES) == {"hermite-simpson", "trapezoid", "paper"}
