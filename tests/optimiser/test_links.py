"""Legs in the sagittal plane against legs in space, and a foot's rate against a complex step."""

import numpy as np

from bp2_rl.optimiser.links import down_link, hip_and_knee, hip_fore_aft, leg_links
from bp2_rl.reference.library.table import foot_in_plane
from bp2_rl.robot import bp2, conventions, kinematics


def _posture(seed: int = 0):
    """Pitch, hips, knees and compressions of the four legs, and their rates."""
    random = np.random.default_rng(seed)
    joints = np.array([0.2]), random.uniform(-1.0, 2.0, 4), random.uniform(-2.5, -0.2, 4), random.uniform(0.0, 0.1, 4)
    return joints, (random.normal(size=1), *random.normal(size=(3, 4)))


def test_a_leg_in_the_plane_is_the_leg_in_space_with_abduction_at_zero():
    (pitch, hip, knee, compression), _ = _posture()
    p = kinematics.foot_position(np.stack([np.zeros(4), hip, knee], axis=-1), compression)
    level = np.cos(pitch) * p[:, 0] + np.sin(pitch) * p[:, 2], np.cos(pitch) * p[:, 2] - np.sin(pitch) * p[:, 0]
    fore_aft = np.array([hip_fore_aft(leg) for leg in conventions.LEGS])
    np.testing.assert_array_equal(fore_aft, kinematics.leg_origins()[:, 0])
    leg = leg_links(np, (0.0, 0.0, pitch), fore_aft, (hip, knee), bp2.THIGH_LENGTH)
    lower = bp2.THIGH_LENGTH - compression
    np.testing.assert_allclose(down_link(np, leg.knee, leg.lower, lower), level, atol=1e-15)
    place, _ = foot_in_plane((pitch, hip, knee, lower), (pitch, hip, knee, lower), bp2.THIGH_LENGTH)
    np.testing.assert_allclose(place, level, atol=1e-15)


def test_the_rate_of_a_planar_foot_is_its_derivative():
    """By a complex step of the other way to the same place, exact to rounding."""
    (pitch, hip, knee, compression), rates = _posture()
    joints = (pitch, hip, knee, bp2.THIGH_LENGTH - compression)
    _, rate = foot_in_plane(joints, rates, bp2.THIGH_LENGTH)
    pitch, hip, knee, lower = (value + 1e-30j * change for value, change in zip(joints, rates, strict=True))
    leg = leg_links(np, (0.0, 0.0, pitch), kinematics.leg_origins()[:, 0], (hip, knee), bp2.THIGH_LENGTH)
    foot = down_link(np, leg.knee, leg.lower, lower)
    np.testing.assert_allclose(rate, np.imag(foot) / 1e-30, atol=1e-14)


def test_hip_and_knee_put_the_sole_where_it_was():
    (_, _, knee, compression), _ = _posture()
    hip, lower = np.array([0.3, 0.9, -0.2, 1.2]), bp2.THIGH_LENGTH - compression
    leg = leg_links(np, (0.0, 0.0, 0.0), 0.0, (hip, knee), bp2.THIGH_LENGTH)
    x, z = down_link(np, leg.knee, leg.lower, lower)
    np.testing.assert_allclose(hip_and_knee(x, z, bp2.THIGH_LENGTH, lower), (hip, knee), atol=1e-12)
