"""A fleet of drawn robots, beside the run of a single one."""

import dataclasses

import numpy as np
import pytest
from runs import run_one

from bp2_rl.learning.policy import load_policy
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import BUILT
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation import parallel as module
from bp2_rl.simulation.parallel import run_fleet
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp

SCHEDULE = Ramp(1.0, hold=0.2)
REQUEST = RunRequest(SCHEDULE, BUILT)
NOMINAL = RandomizationConfig(enabled=False)


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Simulate in this process, without workers, which would compile everything
    anew."""

    def simulate_all(measure, policy, requests, backend):
        return [
            measure(*pair)
            for pair in zip(
                requests, simulate(policy, requests, backend=backend), strict=True
            )
        ]

    monkeypatch.setattr(module, "simulate_all", simulate_all)


@pytest.fixture(scope="module")
def policy():
    return load_policy("built")


def test_a_robot_as_designed_runs_as_it_does_alone(policy):
    fleet = run_fleet(policy, REQUEST, NOMINAL, robots=2)
    alone = run_one(policy, SCHEDULE, policy.card.env, hardware=BUILT)
    each = slice(None, None, 5)
    lasted = len(alone.time[each])
    for robot in range(2):  # what is drawn is of float32, even where it is as designed
        np.testing.assert_allclose(
            fleet.speed[:lasted, robot], alone.ground_velocity[each, 0], atol=1e-5
        )
        np.testing.assert_allclose(
            fleet.offset[:lasted, robot], alone.qpos[each, 1], atol=1e-6
        )
    np.testing.assert_allclose(fleet.time[:lasted], alone.time[each])
    assert len(fleet.time) == np.ceil(SCHEDULE.duration / 0.005)
    assert fleet.steady_from == pytest.approx(1.0 / 2.4)
    np.testing.assert_allclose(
        fleet.command, [SCHEDULE.command(t)[0] for t in fleet.time], atol=1e-12
    )
    assert {
        name: float(values[1]) for name, values in fleet.robots.items()
    } == pytest.approx(
        {
            "friction": BUILT.friction,
            "latency": BUILT.losses.latency,
            "mass": alone.mass,
            "strength": 1.0,
        }
    )


def test_fallen_robots_are_known_by_the_time_of_their_fall(policy):
    drawn = RandomizationConfig(push_velocity=5.0, push_interval=0.1)
    fleet = run_fleet(policy, REQUEST, drawn, robots=6, seed=3)
    down = fleet.fell_at < np.inf
    assert np.sum(down) >= 3
    assert np.all(fleet.fell_at[down] <= fleet.time[-1])
    assert len(set(fleet.fell_at[down])) > 1  # each falls by itself
    for robot in np.flatnonzero(down):
        assert np.all(fleet.speed[fleet.time > fleet.fell_at[robot], robot] == 0.0)
    low, high = (bp2.TOTAL_MASS * factor for factor in drawn.mass)
    assert np.all((low < fleet.robots["mass"]) & (fleet.robots["mass"] < high))


def test_the_noise_is_that_of_the_ranges_not_of_the_policys_training(
    policy, monkeypatch
):
    asked = []
    monkeypatch.setattr(
        module,
        "simulate_all",
        lambda measure, policy, requests, backend: (
            asked.append(
                (
                    policy.card.env.randomization,
                    [request.noise_seed for request in requests],
                    backend,
                )
            )
            or [(np.zeros(3), np.zeros(3), 0.015, 0.1, 36.0) for _ in requests]
        ),
    )
    ranges = dataclasses.replace(RandomizationConfig(), joint_velocity_noise=0.7)
    run_fleet(policy, REQUEST, ranges, robots=3, backend="drake")
    [(drawn, seeds, backend)] = asked
    assert drawn == ranges
    assert len(set(seeds)) == 3
    assert backend == "drake"
