"""The comparison of force weights (F bar): the right problems are solved, and the
cheapest solutions told."""

import itertools

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser import collocation
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Motion, NotSolved, Solution
from bp2_rl.paper.trajectories.objective import ObjectiveSettings, compare_objectives


def made_up(problem: Problem, motion: Motion, cost: float) -> Solution:
    """Return a solution that satisfies nothing."""
    return Solution(
        problem=problem,
        motion=motion,
        cost=cost,
        violation=0.0,
        iterations=0,
        seconds=0.0,
    )


def test_each_weight_is_solved_from_several_starts_and_the_cheapest_is_told(
    monkeypatch,
):
    """A made-up optimiser answers with its guess; three body weights have no
    trajectory."""
    asked: list[Problem] = []
    costs = itertools.cycle([2.0, 1.0])
    guesses = []

    def answer(problem, start, options):
        asked.append(problem)
        guesses.append(start)
        if problem.weights.force > 1000.0:
            raise NotSolved("not this one")
        return made_up(problem, start, next(costs))

    monkeypatch.setattr(collocation, "solve", answer)
    settings = ObjectiveSettings((10.0,), body_weights=(1.0, 3.0), intervals=4)
    (row,) = compare_objectives(settings)
    # 36 kg x 9.81 m/s2, and three times as much
    assert [problem.weights.force for problem in asked] == [353.0] * 2 + [1059.0] * 2
    assert {(one.speed, one.intervals) for one in asked} == {(10.0, 4)}
    assert (row.speed, row.body_weights) == (10.0, 1.0)
    second = made_up(asked[1], guesses[1], 1.0)
    assert row.period == pytest.approx(second.period)
    with pytest.raises(UserError, match="no trajectory was found"):
        compare_objectives(ObjectiveSettings((10.0,), body_weights=(3.0,)))
    assert row.period != pytest.approx(guesses[0].durations.sum(), rel=1e-6)
