"""Gaits beside each other, on a mesh that is solved in a moment."""

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser import collocation
from bp2_rl.optimiser.problem import STRIDES, Problem
from bp2_rl.optimiser.solution import load_solution, speed_name
from bp2_rl.optimiser.verify import verify
from bp2_rl.paper.trajectories import variants
from bp2_rl.paper.trajectories.comparison import compare_variants
from bp2_rl.paper.trajectories.variants import gait_variants


def test_a_pronk_lands_and_lifts_on_all_legs_at_once():
    stride = STRIDES["pronk"]
    assert stride.touchdowns(0) == stride.liftoffs(0) == ("F", "H")
    assert stride.touchdowns(1) == stride.liftoffs(1) == ()
    assert stride.cycles == 1.0
    # Nobody stands in the flight, and everybody in the stance: the other half of the
    # robot does the same.
    assert [len(feet) for feet in stride.standing] == [2, 0]


@pytest.mark.parametrize(
    ("gait", "landing", "lifting"),
    [
        ("half-bound", ("RL RR", "", "FL", "FR", ""), ("RL RR", "", "FL", "FR", "")),
        ("gallop", ("RL", "RR", "", "FL", "FR", ""), ("RL", "RR", "", "FL", "FR", "")),
    ],
)
def test_a_foot_takes_over_as_another_leaves(gait, landing, lifting):
    stride = STRIDES[gait]
    segments = range(len(stride.standing))
    assert tuple(" ".join(stride.touchdowns(i)) for i in segments) == landing
    assert tuple(" ".join(stride.liftoffs(i)) for i in segments) == lifting
    assert stride.cycles == 1.0
    assert {foot for feet in stride.standing for foot in feet} == set(stride.legs)


def test_a_half_bound_is_a_trajectory():
    """Of the whole robot, judged by the other model; each foot's stance counts."""
    solution = collocation.solve(
        Problem(gait="half-bound", speed=6.0, intervals=4, pitch_limit=0.6)
    )
    judged = verify(solution)
    limits = {"dynamics_residual": 1e-3, "impact_residual": 1e-5, "position_jump": 1e-6}
    assert all(judged[name] <= limit for name, limit in limits.items()), judged
    hind, _, left, right, _ = solution.motion.durations
    assert solution.duty == pytest.approx(
        (2 * hind + left + right) / 4 / solution.period, rel=1e-12
    )


def test_gaits_are_solved_once_and_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(variants, "GAITS", {"pronk": "pronk"})
    problem = Problem(intervals=4, pitch_limit=0.6)

    def compared(problem):
        variants = gait_variants(problem)
        found = compare_variants(problem, variants, (6.0,), tmp_path, what="gaits")
        return [row for rows in found for row in rows]

    rows = compared(problem)
    assert [row.greatest for row in rows] == [False, True]
    six, top = rows
    assert six.gait is not None
    assert six.speed == 6.0
    assert (top.speed or 0.0) > 6.0
    assert np.max(np.abs(six.pitch or ())) <= 0.6
    solution = load_solution(tmp_path / "pronk" / speed_name(6.0))
    # The judge's model, which shares no code: equations of motion, landing and
    # periodicity. Not that feet stand still between landings: on so few intervals they
    # do not.
    judged = verify(solution)
    limits = {"dynamics_residual": 1e-3, "impact_residual": 1e-5, "position_jump": 1e-6}
    assert all(judged[name] <= limit for name, limit in limits.items()), judged
    monkeypatch.setattr(collocation, "solve", None)
    assert compared(problem) == rows
    with pytest.raises(UserError, match="gaits"):
        compared(Problem(intervals=5))
