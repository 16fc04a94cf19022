"""The posterior benchmark: plausible robots under a policy, and what reports say of
them."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks import posterior as module
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.posterior import posterior, ramp_to_posterior
from bp2_rl.evaluation.benchmarks.run import plausible_rows
from bp2_rl.evaluation.plausible import (
    BestSecond,
    PlausibleRun,
    plausible_robot,
    read_posterior,
    road,
)
from bp2_rl.learning.policy import load_policy
from bp2_rl.robot.named import find_robot
from bp2_rl.simulation.rollout import rollout
from bp2_rl.simulation.schedule import Ramp


@pytest.fixture(scope="module")
def built():
    return load_policy("built")


@pytest.fixture(scope="module")
def one(built):
    return posterior(
        built, ramp_to_posterior(built, BenchmarkOptions()), BenchmarkOptions(robots=1)
    )


def test_a_robots_best_second_on_the_road_is_that_of_a_run_of_its_own(built, one):
    [values] = read_posterior(1)
    run = rollout(
        built,
        Ramp(15.5, acceleration=1.2, hold=1.0),
        hardware=plausible_robot(values),
        world=road(values),
    )
    assert one.metrics.robots[0].road.speed == pytest.approx(
        run.metrics.best_speed, abs=0.02
    )
    # without air, and on mains at best, a robot is no slower
    assert one.metrics.robots[0].belt.speed >= one.metrics.robots[0].road.speed
    assert one.good
    assert 8.0 < one.metrics.robots[0].time_100m < 14.0


def test_what_ships_explains_the_papers_belt(one):
    # the robots were drawn so that BP2's 13.2 m/s lie well within what they run
    assert one.metrics.belt[1] == pytest.approx(13.2, rel=0.15)


def test_robots_that_fall_are_counted_and_have_no_time(built, monkeypatch):
    fine, down = (
        BestSecond(v, v, (1.0, 1.0), at) for v, at in ((12.0, None), (9.0, 7.5))
    )
    runs = [PlausibleRun(fine, fine, 10.0), PlausibleRun(fine, down, None)]
    monkeypatch.setattr(module, "run_plausible", lambda *_: runs)
    found = posterior(
        built, ramp_to_posterior(built, BenchmarkOptions()), BenchmarkOptions(robots=2)
    )
    assert (found.good, found.metrics.falls, found.metrics.arrived) == (False, 1, 1)
    assert found.results["road"] == pytest.approx(
        np.quantile([12.0, 9.0], (0.05, 0.5, 0.95))
    )
    assert found.results["time_100m"] == [10.0, 10.0, 10.0]
    assert found.rows[-1].value == "1"


def test_a_policy_of_another_robot_is_refused(built):
    go1 = dataclasses.replace(built.card.env, hardware=find_robot("go1"))
    policy = dataclasses.replace(built, card=dataclasses.replace(built.card, env=go1))
    with pytest.raises(UserError, match="the policy runs Unitree Go1"):
        ramp_to_posterior(policy, BenchmarkOptions())


@pytest.mark.parametrize(
    ("results", "setup", "said"),
    [
        (
            {"posterior": {"road": [11.0, 12.0, 13.0]}},
            BenchmarkOptions(),
            "12.00 (11.00 to 13.00) m/s",
        ),
        (
            {"posterior": {"road": [11.0, 12.0, 13.0]}},
            BenchmarkOptions(robot="ideal"),
            None,
        ),
        ({"posterior": {}}, BenchmarkOptions(), None),
        ({"posterior": 3.0}, BenchmarkOptions(), None),
        ({}, BenchmarkOptions(), None),
    ],
)
def test_a_report_says_what_plausible_robots_run_if_the_card_does(
    built, results, setup, said
):
    policy = dataclasses.replace(
        built, card=dataclasses.replace(built.card, results=results)
    )
    rows = plausible_rows(policy, setup, "road", "m/s")
    assert [row.value for row in rows] == ([said] if said else [])
