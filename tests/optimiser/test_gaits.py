"""Gaits other than the trot, on a mesh that is solved in a moment."""

import numpy as np
import pytest

from bp2_rl.optimiser import collocation
from bp2_rl.optimiser.problem import STRIDES, Problem
from bp2_rl.optimiser.verify import verify


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


@pytest.mark.parametrize("gait", ["half-bound", "pronk"])
def test_a_gait_is_a_trajectory(gait):
    """Judged by the other model, which shares no code: equations of motion, landing and
    periodicity. Not that feet stand still between landings: on so few intervals they do
    not. Each foot's stance counts in the duty."""
    solution = collocation.solve(
        Problem(gait=gait, speed=6.0, intervals=4, pitch_limit=0.6)
    )
    judged = verify(solution)
    limits = {"dynamics_residual": 1e-3, "impact_residual": 1e-5, "position_jump": 1e-6}
    assert all(judged[name] <= limit for name, limit in limits.items()), judged
    assert np.max(np.abs(solution.motion.q[..., 2])) <= 0.6
    if gait == "half-bound":
        hind, _, left, right, _ = solution.motion.durations
        assert solution.duty == pytest.approx(
            (2 * hind + left + right) / 4 / solution.period, rel=1e-12
        )
