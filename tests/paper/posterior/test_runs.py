"""Simulated robots on file, and the ranges that they fill."""

import dataclasses
import math

import numpy as np
import pytest

from bp2_rl.base.errors import WRONG_INPUT, UserError
from bp2_rl.base.serialization import claim_folder
from bp2_rl.evaluation.plausible import BestSecond, PlausibleRun, read_assumptions
from bp2_rl.learning.policy import load_policy
from bp2_rl.paper.cli import posterior
from bp2_rl.paper.posterior import runs as module
from bp2_rl.paper.posterior.runs import (
    RobotRun,
    RunCard,
    fill_ranges,
    read_runs,
    robots_at,
    run_robots,
    write_rows,
)
from bp2_rl.paper.posterior.study import study_posterior


def test_places_fill_every_range_evenly():
    places = fill_ranges(64, 5)
    assert places.shape == (64, 5)
    # a Sobol sequence has one place in each 64th of each range
    for column in (64.0 * places).astype(int).T:
        assert sorted(column) == list(range(64))
    np.testing.assert_array_equal(fill_ranges(48, 5), places[:48])


def test_robots_have_a_value_for_every_assumption():
    assumptions = read_assumptions()
    (low, high) = robots_at(
        assumptions, np.array([[0.0], [1.0]]) * np.ones(len(assumptions))
    )
    assert list(low) == list(assumptions)
    assert all(low[name] < high[name] for name in low)


def test_runs_are_read_as_they_were_written(tmp_path):
    runs = [
        RobotRun("built", 13.25, 11.5, 12.125, 1500.0, 1400.0),
        RobotRun("gentle", 0.0, 0.0, math.nan, 0.0, 0.0),
    ]
    write_rows(tmp_path / "runs.csv", [dataclasses.asdict(run) for run in runs])
    assert list(map(repr, read_runs(tmp_path / "runs.csv"))) == list(map(repr, runs))


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "policy,belt\nbuilt,x\n", "policy\nbuilt\n"]
)
def test_another_file_is_refused(tmp_path, text):
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(UserError, match=r"no runs.csv|needs 32 robots"):
        study_posterior(read_runs(tmp_path / "runs.csv"))


def test_a_robot_that_ran_under_one_policy_alone_is_missed():
    runs = [RobotRun("built", 13.0, 11.0, 12.0, 1500.0, 1400.0)] * 80
    with pytest.raises(UserError, match="'gentle': 0"):
        study_posterior(runs)


def test_each_robot_runs_under_its_own_policy_and_in_order(monkeypatch):
    def ran(policy, robots, launch):
        assert launch == 2.38
        name = float(policy.card.seed)
        bests = [BestSecond(x["speed"], 0.0, (name, 1.0), None) for x in robots]
        return [PlausibleRun(best, best, 9.0) for best in bests]

    monkeypatch.setattr(module, "BATCH", 3)
    monkeypatch.setattr(module, "run_plausible", ran)
    everyone = [({"speed": float(i)}, "ab"[i % 2]) for i in range(7)]
    batches = list(
        run_robots(everyone, {"a": load_policy("built"), "b": load_policy("gentle")})
    )
    assert [len(batch) for batch in batches] == [3, 3, 1]
    found = [run for batch in batches for run in batch]
    assert [run.belt for run in found] == [float(i) for i in range(7)]
    assert [(run.policy, run.hip) for run in found[:2]] == [("a", 4.0), ("b", 1.0)]


def test_runs_under_other_assumptions_are_not_added_to(tmp_path, capsys):
    others = read_assumptions()
    others.popitem()
    claim_folder(tmp_path, "assumptions.json", RunCard(others), "runs")
    assert posterior.main(["--out", str(tmp_path)]) == WRONG_INPUT
    said = capsys.readouterr().err
    assert "holds runs with another assumption_set" in said
    assert said.count("\n") == 1
