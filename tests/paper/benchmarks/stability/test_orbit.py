"""The return map of a robot's gait from stride to stride, and the state vector on which
it acts."""

import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.env.controller import motion_of
from bp2_rl.paper.benchmarks.stability.group import GroupState, RobotGroup
from bp2_rl.paper.benchmarks.stability.orbit import (
    BODY,
    TICK,
    Coordinates,
    Orbit,
    angles_of,
    quaternion_of,
    whole_strides,
)
from bp2_rl.paper.benchmarks.stability.tries import (
    deviation_radius,
    largest_survived,
    push,
)
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import ControlConfig, EnvConfig


def clock(command):
    """Return the phase rate of a clock whose stride is 200 ms at rest, and 5 ms shorter
    each m/s."""
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
    """Return the return map of a robot that stands still: 3 control steps count as a
    stride."""
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
        group,
        Coordinates.of(config, IDEAL, group.memory, steered=False),
        np.zeros((3, 3)),
        start,
    )


def test_a_stride_is_the_robots_own_and_a_fallen_one_does_not_return(stand):
    states = np.repeat(stand.at[None], 3, axis=0)
    states[1, 0] += 1e-4  # m, higher
    states[2, 21 + 3] = 250.0  # rad/s of pitch: no robot any more
    after = stand.follow(states, 1)[1]
    alone, *_ = stand.group.run(stand.base, stand.commands[:, None])
    # A batch rounds otherwise than one robot, in float32: by 1e-7 rad in targets, which
    # 250 Nm/rad turn into motion.
    np.testing.assert_allclose(after[0], stand.coordinates.read(alone)[0], atol=1e-3)
    assert np.abs(after[1] - after[0]).max() > 1e-5
    assert np.all(np.isnan(after[2]))
    followed = stand.follow(states, 2)
    assert followed.shape == (3, 3, len(stand.at))
    np.testing.assert_allclose(followed[1], after, atol=1e-12)
    two, *_ = stand.group.run(stand.base, np.concatenate([stand.commands[:, None]] * 2))
    np.testing.assert_allclose(
        followed[2, 0], stand.coordinates.read(two)[0], atol=1e-3
    )
    assert np.all(np.isnan(followed[2, 2]))


def remembering(observation):
    """Act on the joints' change over the last five control steps, an entry of the
    observation."""
    return -2.0 * observation[..., -47:][..., 5:17]


def test_what_a_policy_remembers_goes_on_from_stride_to_stride():
    """Written anew in each cycle, its history would be that of the first."""
    nobody = HeadingHold(limit=0.0)
    config = dataclasses.replace(
        EnvConfig(), reference="none", control=ControlConfig(history=(5,))
    )
    group = RobotGroup(remembering, config, hardware=IDEAL, operator=nobody)
    coordinates = Coordinates.of(config, IDEAL, group.memory, steered=False)
    orbit = Orbit(group, coordinates, np.zeros((3, 3)), group.standing(1, np.zeros(3)))
    off = orbit.at[None] + 0.0
    off[0, 3:19] += 0.05  # rad and m: off the pose that it remembers
    followed = orbit.follow(off, 3)
    whole, *_ = group.run(
        coordinates.write(off, orbit.base),
        np.concatenate([orbit.commands[:, None]] * 3),
    )
    np.testing.assert_allclose(followed[3, 0], coordinates.read(whole)[0], atol=1e-3)
    forgets = off
    for _ in range(3):
        forgets = orbit.follow(forgets, 1)[1]
    assert np.abs(forgets - followed[3]).max() > 0.05


class Linear(Orbit):
    """A linear map of three coordinates, of which the third is forgotten at once, as a
    history that is not read."""

    MATRIX = np.diag([0.9, -0.5, 0.0])

    def __init__(self):
        """Make a map without any robot."""

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
    found = deviation_radius(Linear(), scales, off, 0, later=later)
    assert found is not None
    assert found.radius == pytest.approx(0.9, abs=1e-6)
    assert ("a stride later" in found.what) is later


def test_pushes_go_where_the_robot_heads(stand):
    base = stand.base.of([0, 0])
    base.qpos[1, 3:7] = np.cos(0.5), 0.0, 0.0, np.sin(0.5)  # heads 1 rad to the left
    then = push(base, np.array([2.0, 2.0]), np.array([np.pi / 2, 0.0]))
    np.testing.assert_allclose(
        then.qvel[0, :2] - base.qvel[0, :2], (0.0, 2.0), atol=1e-12
    )
    np.testing.assert_allclose(
        then.qvel[1, :2] - base.qvel[1, :2],
        (2 * np.cos(1.0), 2 * np.sin(1.0)),
        atol=1e-12,
    )


def test_bisection_brackets_where_survival_ends():
    ends = np.array([0.1, 1.3, 3.9, 5.0, 0.0])
    low, high = largest_survived(
        lambda sizes: sizes < ends, len(ends), most=4.0, rounds=8
    )
    np.testing.assert_allclose(high - low, 4.0 / 2**8)
    assert np.all(low[:3] < ends[:3])
    assert np.all(ends[:3] <= high[:3])
    assert high[3] == 4.0
    assert low[4] == 0.0


# --- The vector ------------------------------------------------------------------------


def moment(robots=3, depth=2) -> GroupState:
    rng = np.random.default_rng(0)

    def drawn(*shape):
        return 0.2 * rng.standard_normal((robots, *shape))

    qpos = drawn(23)
    qpos[:, 3:7] = quaternion_of(*(drawn() for _ in range(3)))
    position = drawn(depth, 12)
    return GroupState(
        qpos=qpos,
        qvel=drawn(22),
        torque=drawn(12),
        warmstart=drawn(22),
        phase=np.full(robots, 0.3),
        action=drawn(12),
        seen=drawn(0, 47),
        steps=np.full(robots, 60.0),
        command=drawn(3),
        position=position,
        velocity=drawn(depth, 12),
    )


def test_angles_and_quaternions_are_mujocos():
    yaw, pitch, roll = 0.4, -0.3, 0.2
    expected = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in (((0, 0, 1), yaw), ((0, 1, 0), pitch), ((1, 0, 0), roll)):
        turn, before = np.zeros(4), expected.copy()
        mujoco.mju_axisAngle2Quat(turn, np.array(axis, float), angle)
        mujoco.mju_mulQuat(expected, before, turn)
    found = quaternion_of(*(np.array([angle]) for angle in (yaw, pitch, roll)))
    np.testing.assert_allclose(found[0], expected, atol=1e-15)
    np.testing.assert_allclose(
        np.ravel(angles_of(found)), (yaw, pitch, roll), atol=1e-12
    )


@pytest.mark.parametrize("steered", [False, True])
def test_what_is_written_is_read_again(steered):
    coordinates = Coordinates(steered, torque=True, older=1, scale=0.5)
    all_robots = moment()
    vectors = coordinates.read(all_robots)
    assert vectors.shape == (3, coordinates.size)
    written = coordinates.write(vectors, all_robots.of([0]))
    np.testing.assert_allclose(coordinates.read(written), vectors, atol=1e-12)
    np.testing.assert_array_equal(written.qpos[:, 0], 0.0)
    np.testing.assert_array_equal(written.phase, 0.3)


def test_nobody_knows_where_it_is_nor_unless_steered_which_way_it_heads():
    coordinates = Coordinates(False, torque=True, older=0, scale=0.5)
    here = moment(1, 1)
    yaw, pitch, roll = angles_of(here.qpos[:, 3:7])
    turned, (cos, sin) = here.of([0]), (np.cos(0.7), np.sin(0.7))
    turned.qpos[:, :2] += (5.0, -2.0)
    turned.qpos[:, 3:7] = quaternion_of(yaw + 0.7, pitch, roll)
    vx, vy = here.qvel[0, :2]
    turned.qvel[0, :2] = cos * vx - sin * vy, sin * vx + cos * vy
    np.testing.assert_allclose(
        coordinates.read(turned), coordinates.read(here), atol=1e-12
    )
    steered = Coordinates(True, torque=True, older=0, scale=0.5)
    assert np.abs(steered.read(turned) - steered.read(here)).max() > 0.5


def test_an_action_moves_the_target_that_it_made():
    coordinates = Coordinates(False, torque=False, older=1, scale=0.5)
    base = moment(1)
    vector = coordinates.read(base)
    vector[:, BODY] += 0.2
    then = coordinates.write(vector, base)
    np.testing.assert_allclose(
        then.position[0, -1] - base.position[0, -1], [0.1] + [0.0] * 11, atol=1e-15
    )
    np.testing.assert_array_equal(then.position[0, 0], base.position[0, 0])
    np.testing.assert_array_equal(then.torque, base.torque)


@pytest.mark.parametrize(
    ("robot", "memory", "size"),
    [(IDEAL, 0, BODY + 12), (BUILT, 1, BODY + 24), (BUILT, 2, BODY + 36)],
)
def test_torque_and_older_targets_count_where_they_act(robot, memory, size):
    assert Coordinates.of(EnvConfig(), robot, memory, steered=False).size == size
    assert Coordinates.of(EnvConfig(), robot, memory, steered=True).size == size + 3
