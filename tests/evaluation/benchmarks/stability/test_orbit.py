"""The map from stroke to stroke of a robot's clock."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env.controller import motion_of
from bp2_rl.evaluation.benchmarks.stability.coordinates import Coordinates
from bp2_rl.evaluation.benchmarks.stability.orbit import TICK, Orbit, whole_strides
from bp2_rl.evaluation.benchmarks.stability.tries import pushed_by
from bp2_rl.evaluation.runs.flock import Flock
from bp2_rl.evaluation.runs.operator import HeadingHold
from bp2_rl.robot.specs import IDEAL
from bp2_rl.settings.env import EnvConfig


def clock(command):
    """Its stride is 200 ms at rest, and 5 ms shorter each m/s."""
    return 1.0 / (0.2 - 0.005 * command[0])


def test_the_nearest_command_with_whole_control_steps_is_found():
    speed, ticks = whole_strides(clock, 10.3) or (0.0, 0)
    assert ticks == 30
    assert speed == pytest.approx(10.0, abs=1e-3)
    assert whole_strides(lambda command: 0.0 * command[0], 10.0) is None


def test_a_policys_own_clock_is_whole_there():
    reference = motion_of(EnvConfig())
    found = whole_strides(reference.phase_rate, 10.74)
    assert found is not None
    speed, ticks = found
    assert abs(speed - 10.74) < 0.5
    rate = float(reference.phase_rate(jnp.array([speed, 0.0, 0.0])))
    assert 1.0 / rate / TICK == pytest.approx(ticks, abs=1e-3)


@pytest.fixture(scope="module")
def stand() -> Orbit:
    """A robot that stands still: 3 control steps count as a stride."""
    nobody = HeadingHold(limit=0.0)
    config = dataclasses.replace(EnvConfig(), reference="none")
    flock = Flock(lambda observation: 0.0 * observation[..., :12], config, hardware=IDEAL, operator=nobody)
    start = flock.standing(1, np.zeros(3))
    return Orbit(flock, Coordinates.of(config, IDEAL, flock.memory, steered=False), 0.0, 3, start)


def test_a_stride_is_the_robots_own_and_a_fallen_one_does_not_return(stand):
    states = np.repeat(stand.at[None], 3, axis=0)
    states[1, 0] += 1e-4  # m, higher
    states[2, 21 + 3] = 250.0  # rad/s of pitch: no robot any more
    after = stand.step(states)
    alone, *_ = stand.flock.run(stand.base, stand.commands(1))
    # A batch rounds otherwise than one robot, in float32: by 1e-7 rad in targets, which 250 Nm/rad turn into motion.
    np.testing.assert_allclose(after[0], stand.coordinates.read(alone)[0], atol=1e-3)
    assert np.abs(after[1] - after[0]).max() > 1e-5
    assert np.all(np.isnan(after[2]))
    followed = stand.follow(states[:2], 2)
    assert followed.shape == (3, 2, len(stand.at))
    np.testing.assert_allclose(followed[1], after[:2], atol=1e-12)


def test_pushes_go_where_the_robot_heads(stand):
    base = stand.base.of([0, 0])
    base.qpos[1, 3:7] = np.cos(0.5), 0.0, 0.0, np.sin(0.5)  # heads 1 rad to the left
    then = pushed_by(base, np.array([2.0, 2.0]), np.array([np.pi / 2, 0.0]))
    np.testing.assert_allclose(then.qvel[0, :2] - base.qvel[0, :2], (0.0, 2.0), atol=1e-12)
    np.testing.assert_allclose(then.qvel[1, :2] - base.qvel[1, :2], (2 * np.cos(1.0), 2 * np.sin(1.0)), atol=1e-12)
