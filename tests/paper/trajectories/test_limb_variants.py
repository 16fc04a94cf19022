"""Variants of the robot with other limbs: masses, solutions and the command."""

import itertools

import numpy as np
import pytest

from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.problem import Problem
from bp2_rl.paper.cli import trajectories
from bp2_rl.paper.trajectories import variants
from bp2_rl.paper.trajectories.comparison import compare_variants
from bp2_rl.paper.trajectories.variants import limb_variants
from bp2_rl.robot import bp2, conventions


def inertia_about_the_hip(problem: Problem) -> float:
    """Return the inertia of a stretched leg, kg m2, by moving its hip alone."""
    mass = PlanarModel.of(problem).terms(np.zeros(15), np.zeros(15)).mass
    return float(mass[3, 3]) - problem.hardware.reflected_inertia


def test_all_weigh_the_same_and_differ_as_they_are_called():
    problems = limb_variants(Problem())
    weights = [PlanarModel.of(problem).weight for problem in problems.values()]
    np.testing.assert_allclose(
        weights, 4 * bp2.QUARTER_MASS * conventions.GRAVITY, rtol=1e-12
    )
    legs = {name: inertia_about_the_hip(problem) for name, problem in problems.items()}
    # A thigh has its mass 24 mm from the hip, a toe some 0.7 m.
    assert legs["thigh x 2"] - legs["as it is"] == pytest.approx(
        0.014 + 2.2 * 0.024**2, rel=1e-9
    )
    assert legs["toe x 2"] - legs["as it is"] == pytest.approx(
        2 * (legs["as it is"] - legs["toe x 0.5"]), rel=1e-9
    )
    assert legs["toe x 2"] > 1.5 * legs["as it is"]
    assert legs["trunk x 1000"] == legs["as it is"]


def test_several_are_solved_side_by_side_and_come_in_their_order(tmp_path):
    problem = Problem(intervals=4)
    two = dict(itertools.islice(limb_variants(problem).items(), 2))
    where = {"what": "limbs", "workers": 2}
    found = list(compare_variants(problem, two, (6.0,), tmp_path, **where))
    assert [[row.name for row in rows] for rows in found] == [
        ["as it is"] * 2,
        ["thigh x 0.5"] * 2,
    ]
    assert all(row.gait is not None for rows in found for row in rows)
    assert {path.name for path in tmp_path.iterdir()} == {
        "problem.json",
        "as-it-is",
        "thigh-x-0.5",
    }


def test_the_command_prints_a_table_and_leaves_its_numbers(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(variants, "LIMBS", {})
    words = [
        "limbs",
        "--intervals",
        "4",
        "--speeds",
        "6",
        "--workers",
        "1",
        "--out",
        str(tmp_path / "limbs"),
    ]
    assert trajectories.main(words) == 0
    assert "as it is" in capsys.readouterr().out
    assert (tmp_path / "limbs" / "limbs.json").is_file()
    assert trajectories.main(["limbs", "--speeds", "10", "6"]) == 2
    assert "slowest first" in capsys.readouterr().err
