import numpy as np
import pytest

from bp2_rl.env.config import CommandConfig, EnvConfig
from bp2_rl.evaluation import benchmarks
from bp2_rl.evaluation.benchmarks import Setup, describe_operator, topspeed
from bp2_rl.evaluation.rollout import HeadingHold
from bp2_rl.learning.policy import Policy


@pytest.fixture
def make_policy(make_card):
    """The card is all that a benchmark itself reads of a policy."""

    def make(**results):
        env = EnvConfig(commands=CommandConfig(max_forward=7.5))
        none = np.zeros(0, np.float32)
        return Policy(card=make_card(env=env, results=results), mean=none, std=none, layers=())

    return make


@pytest.fixture
def asked(monkeypatch, make_run):
    """What the simulators were asked for, instead of running them."""
    calls = []

    def backend(name):
        def rollout(policy, schedule, config, **rest):
            calls.append((name, schedule, config, rest))
            return make_run(duration=3.0)

        return rollout

    monkeypatch.setattr(benchmarks, "BACKENDS", {name: backend(name) for name in benchmarks.BACKENDS})
    return calls


@pytest.mark.parametrize("backend", ["mujoco", "mjx"])
def test_topspeed_ramps_to_the_speed_and_holds_it(make_policy, asked, backend):
    operator = HeadingHold(heading_gain=1.0)
    policy = make_policy()
    evaluation = topspeed(policy, Setup(backend=backend, speed=6.0, hold=20.0, operator=operator))
    ((name, schedule, config, rest),) = asked
    assert name == backend
    assert config is policy.card.env
    assert rest["operator"] is operator
    assert (schedule.target, schedule.acceleration, schedule.hold) == ((6.0, 0.0, 0.0), 2.4, 20.0)
    assert evaluation.benchmark == "topspeed"
    assert evaluation.metrics.best_speed == pytest.approx(5.0)
    assert "6 m/s" in evaluation.conditions["schedule"]
    assert "1/s x heading" in evaluation.conditions["operator"]
    assert "seed 3" in evaluation.conditions["policy"]
    assert evaluation.conditions["weights_sha256"] == policy.card.weights_sha256


@pytest.mark.parametrize(
    ("results", "speed"),
    [
        ({"commanded_speed": 9.0, "top_speed": 8.25}, 9.0),  # told 8.25 m/s it would run slower still
        ({"top_speed": 8.25}, 8.25),
        ({"commanded_speed": None, "top_speed": "fast"}, 7.5),  # the fastest command of the training
        ({}, 7.5),
    ],
)
def test_a_policy_is_told_what_it_was_told_when_its_top_speed_was_measured(make_policy, asked, results, speed):
    topspeed(make_policy(**results), Setup())
    assert [schedule.target[0] for _, schedule, *_ in asked] == [speed]


def test_no_operator_is_said_to_be_none():
    assert describe_operator(HeadingHold(limit=0.0)).startswith("none")
