"""A group of robots against runs of single robots."""

import dataclasses

import numpy as np
import pytest
from runs import run_one

from bp2_rl.paper.benchmarks.stability.group import RobotGroup, join
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation.rollout import sampled_commands
from bp2_rl.simulation.schedule import Ramp

CONFIG = EnvConfig(reference="kinematic")
RAMP = Ramp((1.5, 0.0, 0.0), acceleration=10.0, hold=0.1)
UNSTEERED = HeadingHold(limit=0.0)


def still(observation):
    """Act with zero residual actions, so that the robot follows the reference
    itself."""
    return 0.0 * observation[..., :12]


def group(hardware=IDEAL, **options) -> RobotGroup:
    return RobotGroup(still, CONFIG, hardware=hardware, **options)


def told(robots, ramp=RAMP):
    commands = sampled_commands(ramp)
    return commands[0], np.repeat(commands[1:, None], robots, axis=1)


@pytest.mark.parametrize("hardware", [IDEAL, BUILT], ids=["ideal", "built"])
def test_each_robot_runs_as_it_would_alone(hardware):
    alone = run_one(still, RAMP, CONFIG, hardware=hardware)
    robots = group(hardware)
    first, commands = told(2)
    moment, fell, log = robots.run(robots.standing(2, first), commands)
    assert not fell.any()
    run = log.trajectory(1)
    assert len(run) == len(alone)
    # A batch rounds otherwise than one robot, in the controller's float32: 1e-7 rad at
    # each control step.
    np.testing.assert_allclose(run.qpos, alone.qpos, atol=2e-5)
    np.testing.assert_allclose(run.command, alone.command, atol=1e-6)
    np.testing.assert_allclose(run.target, alone.target, atol=1e-5)
    pressed = np.abs(run.foot_force - alone.foot_force)
    # N; at a touchdown a hair's breadth is more
    assert np.quantile(pressed, 0.99) < 1.0
    assert run.mass == pytest.approx(alone.mass)
    assert np.all(np.diff(log.clock[0]) >= -1e-6)
    assert log.clock[0, -1] % 1.0 == pytest.approx(moment.phase[0], abs=0.01)


@pytest.mark.parametrize("hardware", [IDEAL, BUILT], ids=["ideal", "built"])
def test_a_run_in_two_parts_is_the_run(hardware):
    robots = group(hardware)
    first, commands = told(1)
    whole, *_ = robots.run(robots.standing(1, first), commands)
    half, *_ = robots.run(robots.standing(1, first), commands[:40])
    rest, *_ = robots.run(half, commands[40:])
    for name, value in vars(whole).items():
        np.testing.assert_allclose(
            vars(rest)[name], value, rtol=0.0, atol=1e-9, err_msg=name
        )
    assert whole.position.shape == (1, robots.memory, 12)


def test_noise_is_the_seeds_own_and_spares_those_without():
    robots = group(noise=RandomizationConfig())
    first, commands = told(3)
    share = np.array([1.0, 1.0, 0.0])

    def at_end(seed):
        return robots.run(
            robots.standing(3, first), commands[:30], seed=seed, noisy=share
        )[0].qpos

    # The reference alone takes no notice of sensors: an answering policy does.
    answering = RobotGroup(
        lambda observation: 0.1 * observation[..., 5:17],
        CONFIG,
        hardware=IDEAL,
        noise=RandomizationConfig(),
    )
    np.testing.assert_array_equal(at_end(1), at_end(2))
    one, other = (
        answering.run(
            answering.standing(3, first), commands[:30], seed=seed, noisy=share
        )[0].qpos
        for seed in (1, 2)
    )
    again = answering.run(
        answering.standing(3, first), commands[:30], seed=1, noisy=share
    )[0].qpos
    np.testing.assert_array_equal(one, again)
    assert np.abs(one[0] - one[1]).max() > 1e-4
    assert np.abs(one[:2] - other[:2]).max() > 1e-4
    np.testing.assert_array_equal(one[2], other[2])


def test_the_fallen_are_told_and_stay_down():
    robots = group()
    first, commands = told(2)
    start = robots.standing(2, first)
    qvel = start.qvel.copy()
    qvel[1, 3] = 30.0  # rad/s of roll
    moment, fell, log = robots.run(dataclasses.replace(start, qvel=qvel), commands)
    assert fell.tolist() == [False, True]
    run = log.trajectory(1)
    assert run.fell_at is not None
    assert run.fell_at == pytest.approx(log.lasted[1] * conventions.PHYSICS_STEP)
    assert len(run) == log.lasted[1] < log.clock.shape[1]
    assert moment.qpos[1, 2] < 0.6


def test_groups_join_and_part():
    robots = group()
    start = robots.standing(2, np.zeros(3))
    assert len(join(start, start.of([1]))) == 3
    assert start.of(np.zeros(5, int)).qpos.shape == (5, 23)
