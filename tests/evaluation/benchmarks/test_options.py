import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks.conditions import (
    speed_to_command,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import CommandConfig, EnvConfig


@pytest.mark.parametrize(
    ("results", "speed"),
    [
        # told 8.25 m/s it would run slower still
        ({"topspeed": {"commanded_speed": 9.0, "best_speed": 8.25}}, 9.0),
        ({"topspeed": {"best_speed": 8.25}}, 8.25),
        ({"sprint": {"commanded_speed": 8.0}}, 7.5),
        # the fastest command of the training
        ({"topspeed": {"commanded_speed": None, "best_speed": None}}, 7.5),
        ({}, 7.5),
        ({"judged": {"speed": 6.0}}, 7.5),
        ({"judged": {"speed": 4.004}}, 4.0),  # the command is beyond the robot
        ({"judged": {"speed": 0.004}}, 7.5),  # it only stands
        ({"judged": {"speed": 0.0}}, 7.5),  # all launches fell
        # but not under slower commands
        ({"judged": {"speed": 0.0, "held": 5.256}}, 5.26),
        ({"judged": {"speed": 0.0, "held": 1.2}}, 1.2),
        ({"judged": {"speed": 6.0, "held": 5.9}}, 7.5),
        # the judge of a training that ends at a speed tells no more than a little over
        ({"judged": {"speed": 6.0, "told": 6.6000000000000005}}, 6.6),
    ],
)
def test_a_policy_is_told_what_it_was_told_when_its_top_speed_was_measured(
    make_policy, results, speed
):
    env = EnvConfig(commands=CommandConfig(max_forward=7.5))
    assert speed_to_command(make_policy(env=env, results=results)) == speed


@pytest.mark.parametrize(
    ("results", "speed"), [({}, 9.0), ({"sprint": {"commanded_speed": 8.0}}, 8.0)]
)
def test_a_sprint_is_run_at_the_sprints_own_speed_or_else_the_top_speed(
    make_policy, results, speed
):
    policy = make_policy(results={"topspeed": {"commanded_speed": 9.0}} | results)
    assert speed_to_command(policy, "sprint") == speed


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"speed": 0.0}, "--speed"),
        ({"acceleration": np.inf}, "--acceleration"),
        ({"hold": np.nan}, "--hold"),
        ({"hold": 1e-12}, "--hold must be from 0.1 to 600, got 1e-12"),
        ({"robots": 0}, "--robots"),
        ({"seed": -1}, "--seed"),
        ({"speed": 1e308}, "--speed must be from 0.01 to 100"),
        ({"acceleration": 1e-320}, "--acceleration must be from 0.05 to 1000"),
        ({"hold": 1e6}, "--hold"),
        ({"seed": 2**32}, "--seed must be from 0 to 4294967295, got 4294967296"),
        (
            {"operator": HeadingHold(limit=0.0), "robots": 10**400},
            "--robots must be from 1 to 1048576, got a huge integer",
        ),
    ],
)
def test_impossible_choices_are_refused(wrong, words):
    with pytest.raises(UserError, match=words):
        BenchmarkOptions(**wrong)
