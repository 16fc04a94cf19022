"""The comparison of force weights (F bar): the right problems are solved once, and the
cheapest solutions kept."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.optimiser import collocation
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.paper.trajectories.codesign import PARAMETERS
from bp2_rl.paper.trajectories.objective import (
    ROBOTS,
    Objective,
    ObjectiveRow,
    ObjectiveSettings,
    compare_objectives,
)

SETTINGS = ObjectiveSettings(speeds=(10.0,), body_weights=(1.0, 3.0), intervals=4)


@pytest.fixture(scope="module")
def asked() -> Iterator[list[tuple[Problem, tuple[str, ...]]]]:
    """Replace the optimiser by one that answers with its guess, without IPOPT; return
    the problems that are asked."""
    asked = []
    costs = itertools.cycle([2.0, 1.0, 1.5])

    def answer(problem, start, options):
        asked.append((problem, tuple(options.free)))
        if options.free and problem.weights.force > 1000.0:
            raise NotSolved("not this one")
        return Solution(
            problem=problem,
            motion=start,
            cost=next(costs),
            violation=0.0,
            iterations=0,
            seconds=0.0,
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collocation, "solve", answer)
        yield asked


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("objective")


@pytest.fixture(scope="module")
def rows(asked, folder) -> list[ObjectiveRow]:
    return compare_objectives(SETTINGS, folder)


def test_the_right_problems_are_asked_for(rows, asked):
    # 36 kg x 9.81 m/s2, and three times as much
    assert {problem.weights.force for problem, _ in asked} == {353.0, 1059.0}
    assert {problem.speed for problem, _ in asked} == {10.0}
    # BP2 as it is and with the library's reserve
    assert {
        (problem.hardware.peak_torque, problem.hardware.friction, problem.speed_margin)
        for problem, free in asked
        if not free
    } == {(120.0, 0.9, 1.0), (108.0, 0.7, 0.9)}
    # co-design, all free under its own margin, ends on the mesh that is compared
    assert {
        (problem.intervals, free, problem.speed_margin)
        for problem, free in asked
        if free
    } == {(8, PARAMETERS, 0.6), (4, PARAMETERS, 0.6)}


def test_there_is_a_row_for_all_that_was_solved(rows):
    cases = [(robot, share) for robot in ROBOTS for share in (1.0, 3.0)]
    # the last could not be
    assert [(row.robot, row.body_weights) for row in rows] == cases[:-1]


def test_a_row_is_of_the_cheapest_start(rows):
    spreads = {round(row.spread, 6) for row in rows}
    assert spreads <= {
        round(dear / cheap - 1.0, 6)
        for dear, cheap in [(2.0, 1.0), (1.5, 1.0), (2.0, 1.5)]
    }
    assert all(np.isfinite(row.period) and row.gear_ratio == 8.5 for row in rows[:4])


def test_what_was_solved_is_not_solved_again_and_numbers_can_be_read(
    rows, asked, folder, tmp_path
):
    before = len(asked)
    again = compare_objectives(SETTINGS, folder)
    # what could not be solved is tried again
    assert all(free and one.weights.force > 1000.0 for one, free in asked[before:])
    assert repr(again) == repr(rows)  # a guess has no peaks: its share is nan
    save_config(tmp_path / "objective.json", Objective(SETTINGS, tuple(rows)))
    read = load_config(Objective, tmp_path / "objective.json")
    assert read.settings == SETTINGS
    assert repr(read.rows) == repr(tuple(rows))
