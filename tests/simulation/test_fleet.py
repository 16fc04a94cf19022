"""A fleet of randomised robots, beside the run of a single one."""

import dataclasses

import jax
import numpy as np
import pytest
from runs import kick, no_action, run_one

from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.controller import Controller
from bp2_rl.robot import bp2
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation import policy_runner, simulator
from bp2_rl.simulation.batch import rollout_batch
from bp2_rl.simulation.schedule import Ramp

TROTTING = EnvConfig()  # the action is added to the reference motion
SCHEDULE = Ramp(1.0, hold=0.2)
NOMINAL = RandomizationConfig(enabled=False)


@pytest.fixture
def alone(monkeypatch):
    """The run of a single robot that starts as the fleet's first: at the keyframe, not settled, at a drawn phase."""
    config = dataclasses.replace(TROTTING, randomization=NOMINAL)
    phase = jax.jit(BP2Env(config).reset)(jax.random.split(jax.random.PRNGKey(0), 1)[0]).pipeline_state.controller.phase

    class OutOfPhase(Controller):
        def init(self, phase=phase):
            return super().init(phase)

    monkeypatch.setattr(simulator, "SETTLING_TIME", 0.0)
    monkeypatch.setattr(policy_runner, "Controller", OutOfPhase)
    return run_one(no_action, SCHEDULE, TROTTING)


def test_a_robot_as_designed_runs_as_it_does_alone(alone):
    fleet = rollout_batch(no_action, SCHEDULE, TROTTING, robots=1, randomization=NOMINAL)
    after = slice(5, None, 5)  # a fleet's samples are those at the end of each control step
    steps = len(alone.time[after])
    np.testing.assert_allclose(fleet.time[:steps], alone.time[after])
    # Both are C MuJoCo: what is left is the float32 in which the environment hands states on, 1e-6 of each in 0.6 s.
    np.testing.assert_allclose(fleet.speed[:steps, 0], alone.ground_velocity[after, 0], atol=1e-5)
    np.testing.assert_allclose(fleet.offset[:steps, 0], alone.qpos[after, 1], atol=1e-6)
    np.testing.assert_array_equal(fleet.fell_at, np.inf)
    assert fleet.steady_from == pytest.approx(1.0 / 2.4)
    np.testing.assert_allclose(fleet.command, [SCHEDULE.command(t)[0] for t in fleet.time])
    assert {name: float(values[0]) for name, values in fleet.robots.items()} == pytest.approx(
        {"friction": bp2.FOOT_FRICTION, "latency": 0.0, "mass": alone.mass, "strength": 1.0}
    )


@pytest.fixture(scope="module")
def falling():
    """Twelve robots as they are drawn, under a policy that throws them over."""
    return rollout_batch(kick, Ramp(3.0, hold=0.25), TROTTING, robots=12, seed=3)


def test_fallen_robots_are_known_by_the_time_of_their_fall(falling):
    down = falling.fell_at < np.inf
    assert np.sum(down) >= 6
    assert np.all(falling.fell_at[down] <= falling.time[-1])
    assert len(set(falling.fell_at[down])) > 1  # each falls by itself


def test_robots_are_drawn_from_the_ranges_of_training(falling):
    drawn = RandomizationConfig()
    for name, low, high in (
        ("friction", *(bp2.FOOT_FRICTION * factor for factor in drawn.friction)),
        ("latency", *drawn.latency),
        ("mass", *(bp2.TOTAL_MASS * factor for factor in drawn.mass)),
        ("strength", *drawn.strength),
    ):
        values = falling.robots[name]
        assert np.all((low - 1e-6 <= values) & (values <= high + 1e-6)), name
        assert np.unique(values).size == 12, name
