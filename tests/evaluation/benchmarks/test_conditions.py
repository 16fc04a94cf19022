import dataclasses
import math

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks.conditions import (
    speed_to_command,
    top_speed,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.run import (
    SPRINT_ACCELERATION,
    ramp_to_sprint,
    ramp_to_topspeed,
)
from bp2_rl.learning.policy import load_policy
from bp2_rl.settings.env import ControlConfig


def with_results(results):
    policy = load_policy(asset_path("policies/built"))
    return dataclasses.replace(
        policy, card=dataclasses.replace(policy.card, results=results)
    )


@pytest.mark.parametrize(
    ("group", "result"), [("judged", "speed"), ("topspeed", "best_speed")]
)
@pytest.mark.parametrize("value", ["x", True, -3, [1], 1e308, 10**400, math.nan])
@pytest.mark.parametrize("nested", [True, False])
def test_a_card_whose_results_are_none_is_refused_in_one_line(
    group, result, value, nested
):
    """What `load_policy` lets through: results may be anything by name."""
    policy = with_results({group: {result: value} if nested else value})
    refused = r"the policy's card is not as we write it: {} of {} is "
    with pytest.raises(UserError, match=refused.format(result, group)):
        top_speed(policy)
    with pytest.raises(UserError, match=refused.format(r"\w+", r"\w+")):
        speed_to_command(policy)


def test_a_race_is_run_as_fast_as_the_controller_launches_if_the_card_says_nothing():
    blank = with_results({})
    control = blank.card.env.control
    assert math.isfinite(control.launching)
    ramp = ramp_to_sprint(blank, BenchmarkOptions())
    assert (ramp.acceleration, ramp.launching_speed) == (
        control.launching,
        control.launching_speed,
    )
    assert ramp.duration == pytest.approx(30.0)
    assert ramp_to_topspeed(blank, BenchmarkOptions()).launching == control.launching
    free = dataclasses.replace(blank.card.env, control=ControlConfig())
    old = dataclasses.replace(blank, card=dataclasses.replace(blank.card, env=free))
    ramp = ramp_to_sprint(old, BenchmarkOptions())
    assert (ramp.acceleration, ramp.launching) == (SPRINT_ACCELERATION, math.inf)
