"""Properties that the library in assets/reference_motions must have, whoever built
it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.cli.trajopt import load_solutions
from bp2_rl.optimiser.family import steps_of
from bp2_rl.optimiser.verify import failures, verify
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.robot import bp2, kinematics
from bp2_rl.robot.hardware import IDEAL


@pytest.fixture(scope="module")
def family():
    return load_solutions(None)


def test_it_covers_the_speeds(family):
    speeds = [solution.problem.speed for solution in family]
    assert speeds[0] == 0.5
    assert speeds[-1] == 15.0
    assert np.max(np.diff(speeds)) <= 0.5


def test_it_was_verified_when_it_was_built(family):
    """On the mesh of its problem, which a limit on slow trots once changed."""
    for solution in family:
        assert solution.motion.q.shape[1] == len(solution.problem.points)
        assert solution.violation <= 1e-6
        assert failures(solution.checks) == []


@pytest.mark.parametrize("speed", [4.0, 10.0, 13.0])
def test_it_is_what_was_verified(family, speed):
    (solution,) = (solution for solution in family if solution.problem.speed == speed)
    assert failures(verify(solution)) == []


def test_neighbours_are_near(family):
    for step in steps_of(family):
        assert abs(step.period) <= 0.06
        assert step.joints <= 0.15


def cycle(gait, speed):
    """Return the reference at 400 moments of a cycle straight ahead, and its joints by
    leg."""
    command = jnp.tile(jnp.array([speed, 0.0, 0.0]), (400, 1))
    reference = jax.jit(gait)(command, jnp.linspace(0.0, 1.0, 400))
    return reference, np.asarray(reference.joint_position).reshape(-1, 4, 3)


@pytest.mark.parametrize("speed", [0.0, 0.25, 0.5, 2.0, 5.25, 10.0, 13.2, 15.0, 20.0])
def test_the_gait_asks_nothing_of_the_motors_that_they_cannot(speed):
    reference, q = cycle(CollocationGait(), speed)
    lowest, highest = np.transpose([bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE])
    # A polynomial that touches a limit at a point may pass it by a hair before the
    # next.
    assert np.all(lowest <= q + 1e-3)
    assert np.all(q <= highest + 1e-3)
    assert np.abs(reference.joint_velocity).max() < bp2.NO_LOAD_SPEED
    assert np.abs(reference.torque).max() <= bp2.PEAK_TORQUE
    feet = kinematics.foot_position(q, np.asarray(reference.spring_compression))
    assert np.all(np.isfinite(feet))
    mean = reference.velocity[:-1, 0].mean()
    assert mean == pytest.approx(min(speed, 15.0), abs=0.02)


@pytest.mark.parametrize("speed", [1.0, 6.0, 12.0])
def test_standing_feet_stand_on_level_ground(speed):
    reference, q = cycle(CollocationGait(), speed)
    pitch = np.asarray(reference.pitch)[:, None]
    centre = kinematics.foot_position(
        q, np.asarray(reference.spring_compression) + bp2.FOOT_RADIUS
    )
    height = (
        np.asarray(reference.height)[:, None]
        + centre[..., 2] * np.cos(pitch)
        - centre[..., 0] * np.sin(pitch)
    )
    above = height - bp2.FOOT_RADIUS
    standing = np.asarray(reference.contact) > 0.5
    # What float32 and the solver leave of a foot's position at the end of a stance that
    # is solved by accelerations.
    assert np.abs(above[standing]).max() < 1e-3
    assert above[~standing].min() > -1e-3
    assert above[~standing].max() > 0.03


@pytest.mark.parametrize("speed", [0.0, 6.0, 15.0])
def test_a_robot_with_other_tracks_makes_the_same_motion_on_them(speed):
    """A trot in the sagittal plane does not ask how wide the robot is. 1e-5: float32,
    near a straight knee."""
    narrow = IDEAL.changed(fore_track=0.42, hind_track=0.24)
    (usual, _), (found, q) = (
        cycle(CollocationGait(hardware=robot), speed) for robot in (IDEAL, narrow)
    )
    for name in ("joint_position", "spring_compression", "height", "contact"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(usual, name), rtol=0, atol=1e-5, err_msg=name
        )
    feet = kinematics.foot_position(q, np.asarray(found.spring_compression), narrow)
    sides = np.tile([-0.21, 0.21, -0.12, 0.12], (400, 1))
    np.testing.assert_allclose(feet[..., 1], sides, rtol=0, atol=1e-6)
