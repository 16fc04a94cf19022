import contextlib
import dataclasses
import json

import numpy as np
import pytest
from damage import flipped_bits, strange_json

from bp2_rl.base.files import write_npz
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.trajectory import Trajectory, TrajectoryError


def test_saving_and_loading_gives_the_same_trajectory(make_run, tmp_path):
    run = make_run(duration=0.5, fell_at=0.5, hardware=HardwareSpec(gear_ratio=10.0))
    run.save(tmp_path / "run.npz")
    loaded = Trajectory.load(tmp_path / "run.npz")
    for field in dataclasses.fields(Trajectory):
        expected, actual = getattr(run, field.name), getattr(loaded, field.name)
        if isinstance(expected, np.ndarray):
            np.testing.assert_array_equal(actual, expected, strict=True)
        else:
            assert actual == expected, field.name
    # no temporary file is left
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrajectoryError, match=r"no trajectory at .*gone\.npz"):
        Trajectory.load(tmp_path / "gone.npz")


def test_between_takes_the_samples_in_the_half_open_interval(make_run):
    part = make_run(duration=1.0).between(0.25, 0.5)
    assert len(part) == 250
    assert part.time[0] == pytest.approx(0.25)
    assert part.time[-1] == pytest.approx(0.499)


def test_joints_and_springs_come_out_of_qpos_in_the_order_of_the_model(make_run):
    from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, SPRING_QPOS

    qpos, qvel = np.tile(np.arange(23.0), (100, 1)), np.tile(np.arange(22.0), (100, 1))
    run = make_run(duration=0.1, qpos=qpos, qvel=qvel)
    np.testing.assert_array_equal(run.joint_position[0], MOTOR_QPOS)
    np.testing.assert_array_equal(run.joint_velocity[0], MOTOR_QVEL)
    np.testing.assert_array_equal(run.spring_compression[0], SPRING_QPOS)


@pytest.mark.attack
def test_whatever_a_trajectorys_file_says_of_itself_it_is_loaded_or_refused(
    make_run, tmp_path
):
    path = tmp_path / "run.npz"
    make_run(duration=0.1).save(path)
    arrays = dict(np.load(path))
    for text in strange_json(json.loads(str(arrays["facts"])), 200):
        write_npz(path, arrays | {"facts": np.array(text)})
        with contextlib.suppress(TrajectoryError):  # anything else fails the test
            Trajectory.load(path)


def test_a_flipped_bit_ends_in_a_trajectory_or_in_one_line(make_run, tmp_path):
    path = tmp_path / "run.npz"
    make_run(duration=0.01).save(path)
    for content in flipped_bits(path.read_bytes(), 400):
        path.write_bytes(content)
        with contextlib.suppress(TrajectoryError):
            Trajectory.load(path)


def test_a_trajectorys_arrays_are_not_unpacked_where_they_do_not_fit(
    make_run, tmp_path
):
    """What we save is not compressed: arrays larger than their file are a
    stranger's."""
    path = tmp_path / "run.npz"
    run = make_run(duration=0.1)
    run.save(path)
    arrays = dict(np.load(path))
    for name in ("time", *(name for name in arrays if arrays[name].ndim > 1)):
        arrays[name] = np.zeros((100_000, *arrays[name].shape[1:]))
    write_npz(path, arrays, compressed=True)
    with pytest.raises(TrajectoryError, match="at most are read"):
        Trajectory.load(path)


def pickled(path):
    with path.open("wb") as file:
        np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)


def with_a_sample_less(path):
    arrays = dict(np.load(path))
    np.savez(path, **(arrays | {"torque": arrays["torque"][1:]}))


def cut(share):
    def cut_file(path):
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])

    return cut_file


@pytest.mark.parametrize(
    "damage",
    [
        *map(cut, (0.0, 0.001, 0.5, 0.99)),
        lambda path: np.savez(path, weights=np.zeros(3)),
        pickled,
        with_a_sample_less,
    ],
)
def test_what_is_no_whole_trajectory_is_refused(make_run, tmp_path, damage):
    path = tmp_path / "run.npz"
    make_run(duration=0.1).save(path)
    damage(path)
    with pytest.raises(
        TrajectoryError, match=r"run\.npz is no trajectory, or not a whole one"
    ):
        Trajectory.load(path)


def test_ground_velocity_is_seen_from_the_heading_which_has_no_jump(make_run):
    run = make_run(duration=0.1)
    yaw = np.linspace(3.0, 3.5, 100)  # passes pi, where the angle wraps
    qpos, qvel = run.qpos.copy(), run.qvel.copy()
    qpos[:, 3], qpos[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    qvel[:, 0] = 3.0 * np.cos(yaw) - 0.5 * np.sin(yaw)
    qvel[:, 1] = 3.0 * np.sin(yaw) + 0.5 * np.cos(yaw)
    run = make_run(duration=0.1, qpos=qpos, qvel=qvel)
    np.testing.assert_allclose(run.heading, yaw, rtol=1e-12)
    expected = np.tile([3.0, 0.5], (100, 1))
    np.testing.assert_allclose(run.ground_velocity, expected, rtol=1e-12)
