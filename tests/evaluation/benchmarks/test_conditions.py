import dataclasses
import math

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks.conditions import (
    describe_ramp,
    speed_to_command,
    top_speed,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.run import (
    SPRINT_ACCELERATION,
    ramp_to_sprint,
    ramp_to_topspeed,
)
from bp2_rl.learning.policy import load_policy
from bp2_rl.settings.env import ControlConfig
from bp2_rl.simulation.schedule import Ramp


def with_results(results):
    policy = load_policy(asset_path("policies/built"))
    return dataclasses.replace(
        policy, card=dataclasses.replace(policy.card, results=results)
    )


@pytest.mark.parametrize("group", ["judged", "topspeed"])
@pytest.mark.parametrize(
    "value", ["x", True, -3, [1], {"a": 1}, 1e308, 10**400, math.nan]
)
def test_a_card_whose_results_are_none_is_refused_in_one_line(group, value):
    """What `load_policy` lets through: results may be anything by name."""
    result = {"judged": "speed", "topspeed": "best_speed"}[group]
    for results in ({group: {result: value}}, {group: value}):
        if results == {group: {"a": 1}}:
            continue  # another result
        with pytest.raises(
            UserError,
            match=rf"the policy's card is not as we write it: {result} of {group} is ",
        ):
            top_speed(with_results(results))
        with pytest.raises(
            UserError, match=r"the policy's card is not as we write it: \w+ of \w+ is "
        ):
            speed_to_command(with_results(results))


def test_a_schedule_says_what_its_controller_limits():
    ramp = Ramp(9.0, 2.0, hold=3.0)
    assert describe_ramp(ramp) == "from a stand to 9 m/s at 2 m/s², then hold for 3 s"
    limited = ramp.under(ControlConfig(launching=6.0, launching_speed=18.0))
    assert (
        "at 2 m/s², and at no more than 6 m/s² x (1 - v / 18 m/s), then hold"
        in describe_ramp(limited)
    )


def test_a_race_is_run_as_fast_as_the_controller_launches_if_the_card_says_nothing():
    policy = load_policy(asset_path("policies/built"))
    blank = dataclasses.replace(
        policy, card=dataclasses.replace(policy.card, results={})
    )
    control = policy.card.env.control
    assert math.isfinite(control.launching)
    ramp = ramp_to_sprint(blank, Setup())
    assert (ramp.acceleration, ramp.launching_speed) == (
        control.launching,
        control.launching_speed,
    )
    assert ramp.duration == pytest.approx(30.0)
    assert ramp_to_sprint(blank, Setup(acceleration=3.0)).acceleration == 3.0
    free = dataclasses.replace(blank.card.env, control=ControlConfig())
    old = dataclasses.replace(blank, card=dataclasses.replace(blank.card, env=free))
    assert (
        ramp_to_sprint(old, Setup()).acceleration,
        ramp_to_sprint(old, Setup()).launching,
    ) == (
        SPRINT_ACCELERATION,
        math.inf,
    )
    assert ramp_to_topspeed(blank, Setup()).launching == control.launching
