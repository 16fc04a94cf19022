"""The map from cycle to cycle of a robot's clock."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env.controller import motion_of
from bp2_rl.paper.benchmarks.stability.coordinates import Coordinates
from bp2_rl.paper.benchmarks.stability.group import RobotGroup
from bp2_rl.paper.benchmarks.stability.orbit import TICK, Orbit, whole_strides
from bp2_rl.paper.benchmarks.stability.tries import _of_deviations, pushed_by
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import ControlConfig, EnvConfig


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
    group = RobotGroup(
        lambda observation: 0.0 * observation[..., :12],
        config,
        hardware=IDEAL,
        operator=nobody,
    )
    start = group.standing(1, np.zeros(3))
    return Orbit(
        group, Coordinates.of(config, IDEAL, group.memory, steered=False), 0.0, 3, start
    )


def test_a_stride_is_the_robots_own_and_a_fallen_one_does_not_return(stand):
    states = np.repeat(stand.at[None], 3, axis=0)
    states[1, 0] += 1e-4  # m, higher
    states[2, 21 + 3] = 250.0  # rad/s of pitch: no robot any more
    after = stand.step(states)
    alone, *_ = stand.group.run(stand.base, stand.commands(1))
    # A batch rounds otherwise than one robot, in float32: by 1e-7 rad in targets, which
    # 250 Nm/rad turn into motion.
    np.testing.assert_allclose(after[0], stand.coordinates.read(alone)[0], atol=1e-3)
    assert np.abs(after[1] - after[0]).max() > 1e-5
    assert np.all(np.isnan(after[2]))
    followed = stand.follow(states, 2)
    assert followed.shape == (3, 3, len(stand.at))
    np.testing.assert_allclose(followed[1], after, atol=1e-12)
    two, *_ = stand.group.run(stand.base, np.concatenate([stand.commands(1)] * 2))
    np.testing.assert_allclose(
        followed[2, 0], stand.coordinates.read(two)[0], atol=1e-3
    )
    assert np.all(np.isnan(followed[2, 2]))


def remembering(observation):
    """Acts on what the joints did five control steps ago; the entry is their change
    since then."""
    return -2.0 * observation[..., -47:][..., 5:17]


def test_what_a_policy_remembers_goes_on_from_stride_to_stride():
    """Written anew in each cycle, its history would be that of the first."""
    nobody = HeadingHold(limit=0.0)
    config = dataclasses.replace(
        EnvConfig(), reference="none", control=ControlConfig(history=(5,))
    )
    group = RobotGroup(remembering, config, hardware=IDEAL, operator=nobody)
    coordinates = Coordinates.of(config, IDEAL, group.memory, steered=False)
    orbit = Orbit(group, coordinates, 0.0, 3, group.standing(1, np.zeros(3)))
    off = orbit.at[None] + 0.0
    off[0, 3:19] += 0.05  # rad and m: off the pose that it remembers
    followed = orbit.follow(off, 3)
    whole, *_ = group.run(
        coordinates.write(off, orbit.base), np.concatenate([orbit.commands(1)] * 3)
    )
    np.testing.assert_allclose(followed[3, 0], coordinates.read(whole)[0], atol=1e-3)
    forgets = off
    for _ in range(3):
        forgets = orbit.step(forgets)
    assert np.abs(forgets - followed[3]).max() > 0.05


class Linear(Orbit):
    """A map of three coordinates, of which the third forgets what it was at once: as a
    history that is not read."""

    MATRIX = np.diag([0.9, -0.5, 0.0])

    def __init__(self):
        """Of no robot."""

    @property
    def at(self):
        return np.array([1.0, 2.0, 3.0])

    def follow(self, states, strides):
        off = [states - self.at]
        for _ in range(strides):
            off.append(off[-1] @ self.MATRIX.T)
        return np.stack(off) + self.at


@pytest.mark.parametrize("later", [False, True])
def test_deviations_have_the_maps_radius_also_a_stride_later(later):
    scales = np.array([1.0, 0.1, 10.0])
    off = 0.5 * scales * np.random.default_rng(0).standard_normal((300, 3))
    found = _of_deviations(Linear(), scales, off, "deviations", 0, later=later)
    assert found is not None
    assert found.radius == pytest.approx(0.9, abs=1e-6)
    assert ("a stride later" in found.what) is later


def test_pushes_go_where_the_robot_heads(stand):
    base = stand.base.of([0, 0])
    base.qpos[1, 3:7] = np.cos(0.5), 0.0, 0.0, np.sin(0.5)  # heads 1 rad to the left
    then = pushed_by(base, np.array([2.0, 2.0]), np.array([np.pi / 2, 0.0]))
    np.testing.assert_allclose(
        then.qvel[0, :2] - base.qvel[0, :2], (0.0, 2.0), atol=1e-12
    )
    np.testing.assert_allclose(
        then.qvel[1, :2] - base.qvel[1, :2],
        (2 * np.cos(1.0), 2 * np.sin(1.0)),
        atol=1e-12,
    )
