"""A vector stands for all that a closed loop depends on, and for nothing else."""

import numpy as np
import pytest

from bp2_rl.paper.benchmarks.stability.coordinates import (
    BODY,
    Coordinates,
    angles_of,
    quaternion_of,
)
from bp2_rl.paper.benchmarks.stability.group import GroupState
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.settings.env import EnvConfig


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
    import mujoco

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
