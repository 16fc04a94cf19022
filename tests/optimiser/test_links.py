"""Legs in the sagittal plane against legs in space, and a foot's rate against a complex
step."""

import numpy as np
import pytest

from bp2_rl.optimiser.links import hip_and_knee, hip_of, leg_links, leg_of
from bp2_rl.reference.library.table import foot_in_plane
from bp2_rl.robot import bp2, conventions, kinematics
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.robot.named import find_robot


def _posture(seed: int = 0):
    """Draw pitch, hips, knees and compressions of the four legs, and their rates."""
    random = np.random.default_rng(seed)
    joints = (
        np.array([0.2]),
        random.uniform(-1.0, 2.0, 4),
        random.uniform(-2.5, -0.2, 4),
        random.uniform(0.0, 0.1, 4),
    )
    return joints, (random.normal(size=1), *random.normal(size=(3, 4)))


def test_a_leg_in_the_plane_is_the_leg_in_space_with_abduction_at_zero():
    (pitch, hip, knee, compression), _ = _posture()
    p = kinematics.foot_position(
        np.stack([np.zeros(4), hip, knee], axis=-1), compression
    )
    level = (
        np.cos(pitch) * p[:, 0] + np.sin(pitch) * p[:, 2],
        np.cos(pitch) * p[:, 2] - np.sin(pitch) * p[:, 0],
    )
    lower = bp2.THIGH_LENGTH - compression
    soles = [
        _sole((0.0, 0.0, pitch[0]), i, (hip[i], knee[i]), lower[i]) for i in range(4)
    ]
    np.testing.assert_allclose(np.transpose(soles), level, atol=1e-15)
    place, _ = foot_in_plane(
        (pitch, hip, knee, lower), (pitch, hip, knee, lower), IDEAL.anatomy.geometry
    )
    np.testing.assert_allclose(place, level, atol=1e-15)


def _sole(trunk, index, joints, below, anatomy=IDEAL.anatomy):
    return leg_links(
        np, trunk, leg_of(anatomy, conventions.LEGS[index]), joints, below
    ).foot


def test_the_rate_of_a_planar_foot_is_its_derivative():
    """By a complex step of the other way to the same place, exact to rounding."""
    (pitch, hip, knee, compression), rates = _posture()
    joints = (pitch, hip, knee, bp2.THIGH_LENGTH - compression)
    _, rate = foot_in_plane(joints, rates, IDEAL.anatomy.geometry)
    pitch, hip, knee, lower = (
        value + 1e-30j * change for value, change in zip(joints, rates, strict=True)
    )
    feet = [
        _sole((0.0, 0.0, pitch[0]), i, (hip[i], knee[i]), lower[i]) for i in range(4)
    ]
    np.testing.assert_allclose(rate, np.imag(np.transpose(feet)) / 1e-30, atol=1e-14)


@pytest.mark.parametrize("robot", ["ideal", "go1", "mini_cheetah"])
@pytest.mark.parametrize("bend", [-1, 1])
def test_hip_and_knee_put_the_sole_where_it_was(robot, bend):
    (_, _, knee, _), _ = _posture()
    anatomy, knee = find_robot(robot).anatomy, -bend * knee
    leg, hip = anatomy.legs[1], np.array([0.3, 0.9, -0.2, 1.2])
    start = hip_of(leg)
    x, z = leg_links(np, (0.0, 0.0, 0.0), leg, (hip, knee), leg.lower_length).foot
    found = hip_and_knee(
        x - start[0], z - start[1], leg.thigh_length, leg.lower_length, bend
    )
    np.testing.assert_allclose(found, (hip, knee), atol=1e-12)
