"""Leg kinematics against their own inverse, against C MuJoCo, and at the edge of
reach."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from extension import leg_extension
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bp2_rl.robot import bp2, kinematics, model
from bp2_rl.robot.hardware import IDEAL

RANGES = np.array([bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE])


loaded = functools.cache(model.load_model)


def legs(limits):
    return arrays(np.float64, 4, elements=st.floats(*limits))


@st.composite
def postures(draw, leg_length=bp2.THIGH_LENGTH):
    """Draw joint angles within their ranges, soles below the hip axes, and spring
    compressions within their travel."""
    joints = np.stack([draw(legs(limits)) for limits in RANGES], axis=-1)
    compression = draw(legs((0.0, bp2.SPRING_TRAVEL)))
    hip, shin = joints[:, 1], joints[:, 1] + joints[:, 2]
    drop = leg_length * np.cos(hip) + (leg_length - compression) * np.cos(shin)
    joints[drop < 0.01] = 0.0, bp2.STAND_HIP, bp2.STAND_KNEE
    return joints, compression


def test_a_leg_with_zero_angles_hangs_straight_down():
    fore, hind = (0.35, 0.195), (-0.35, 0.160)
    below = [(x, side * y, -0.70) for x, y in (fore, hind) for side in (-1, 1)]
    feet = kinematics.foot_position(np.zeros((4, 3)))
    np.testing.assert_allclose(feet, below, rtol=0, atol=1e-15)


def test_positive_angles_swing_the_leg_the_documented_way():
    """Abad about +x moves every foot to the left, hip about +y backwards; a bent knee
    brings the shank back."""
    at_rest = kinematics.foot_position(np.zeros((4, 3)))
    moved = [
        kinematics.foot_position(np.tile(0.1 * np.eye(3)[joint], (4, 1))) - at_rest
        for joint in range(3)
    ]
    assert (moved[0][:, 1] > 0.05).all()
    assert (moved[1][:, 0] < -0.05).all()
    assert (moved[2][:, 0] < -0.02).all()


def test_compression_shortens_the_leg():
    compression = np.array([0.0, 0.01, 0.05, 0.13])
    feet = kinematics.foot_position(
        np.zeros((4, 3)), compression, IDEAL.changed(leg_length=0.4)
    )
    assert feet[:, 2] == pytest.approx(-0.8 + compression, abs=1e-15)


@pytest.mark.parametrize("leg_length", [0.30, bp2.THIGH_LENGTH, 0.45])
@given(data=st.data())
def test_joint_angles_invert_foot_positions(leg_length, data):
    """Float64; 1e-9 rad because the knee loses digits towards its straight end (cosine
    0.995)."""
    joints, compression = data.draw(postures(leg_length))
    hardware = IDEAL.changed(leg_length=leg_length)
    feet = kinematics.foot_position(joints, compression, hardware)
    found = kinematics.joint_angles(feet, compression, hardware)
    np.testing.assert_allclose(found, joints, rtol=0, atol=1e-9)


@given(postures())
def test_foot_positions_invert_joint_angles(posture):
    """To 1e-12 m in float64, and to 1e-6 m in float32, which is what training uses."""
    feet = kinematics.foot_position(*posture)
    found = kinematics.foot_position(
        kinematics.joint_angles(feet, posture[1]), posture[1]
    )
    np.testing.assert_allclose(found, feet, rtol=0, atol=1e-12)

    feet, compression = np.asarray(feet, np.float32), posture[1].astype(np.float32)
    single = kinematics.foot_position(
        kinematics.joint_angles(feet, compression), compression
    )
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, feet, rtol=0, atol=1e-6)


def test_jax_and_numpy_agree():
    rng = np.random.default_rng(0)
    joints = rng.uniform(RANGES[:, 0], RANGES[:, 1], (1000, 4, 3)).astype(np.float32)
    compression = rng.uniform(0.0, bp2.SPRING_TRAVEL, (1000, 4)).astype(np.float32)
    feet = kinematics.foot_position(joints, compression)
    np.testing.assert_allclose(
        jax.jit(kinematics.foot_position)(
            jnp.asarray(joints), jnp.asarray(compression)
        ),
        feet,
        atol=1e-6,
    )
    feet = kinematics.leg_origins() + rng.uniform(
        (-0.3, -0.1, -0.55), (0.3, 0.1, -0.35), (1000, 4, 3)
    )
    found = jax.jit(kinematics.joint_angles)(jnp.asarray(feet, jnp.float32))
    # float32 near a straight knee
    np.testing.assert_allclose(found, kinematics.joint_angles(feet), atol=2e-5)


@pytest.mark.parametrize(
    "hardware",
    [IDEAL, IDEAL.changed(leg_length=0.37, fore_track=0.40, hind_track=0.26)],
)
@settings(deadline=None)  # the first example compiles
@given(seed=st.integers(0, 2**32 - 1))
def test_soles_are_where_mujoco_has_them(seed, hardware):
    rng, robot = np.random.default_rng(seed), loaded(hardware)
    joints = rng.uniform(RANGES[:, 0], RANGES[:, 1], (4, 3))
    compression = rng.uniform(0.0, bp2.SPRING_TRAVEL, 4)
    data = mujoco.MjData(robot)
    data.qpos[:7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    data.qpos[model.MOTOR_QPOS] = joints.ravel()
    data.qpos[model.SPRING_QPOS] = compression
    mujoco.mj_kinematics(robot, data)
    soles = np.stack([data.site(name).xpos for name in model.SOLE_SITES])
    found = kinematics.foot_position(joints, compression, hardware)
    np.testing.assert_allclose(found, soles, rtol=0, atol=1e-12)


@settings(deadline=None)  # the first example compiles
@given(
    arrays(np.float32, (4, 3), elements=st.floats(-3.0, 3.0, width=32)),
    arrays(np.float32, (4,), elements=st.floats(0.0, 0.25, width=32)),
)
@example(np.array([[0.0, 0.0, 1e-4]] * 4, np.float32), np.zeros(4, np.float32))
def test_no_foot_position_gives_infinite_angles_or_derivatives(offset, compression):
    """Anywhere, hip included: too far, too near, above the trunk, on the abduction
    axis."""
    feet = jnp.asarray(kinematics.leg_origins(), jnp.float32) + offset
    angles, gradient = _angles_and_gradient(feet, jnp.asarray(compression))
    assert jnp.isfinite(angles).all()
    assert jnp.isfinite(gradient).all()


@jax.jit
def _angles_and_gradient(feet, compression):
    return kinematics.joint_angles(feet, compression), jax.jacfwd(
        kinematics.joint_angles
    )(feet, compression)


def test_a_foot_out_of_reach_is_met_in_direction():
    feet = kinematics.leg_origins() + np.array([0.0, 0.0, -2.0])
    feet[:, 1] += IDEAL.anatomy.geometry.lateral
    feet[:, 0] += [2.0, 1.0, -1.0, 0.0]
    found = (
        kinematics.foot_position(kinematics.joint_angles(feet))
        - kinematics.leg_origins()
    )
    np.testing.assert_allclose(
        found[:, 0] / found[:, 2], [-1.0, -0.5, 0.5, 0.0], atol=1e-9
    )
    np.testing.assert_allclose(
        np.linalg.norm(found[:, [0, 2]], axis=1), 0.70, atol=1e-6
    )


@given(postures())
def test_reach_bounds_every_posture_within_the_knee_range(posture):
    joints, compression = posture
    extension = leg_extension(kinematics.foot_position(joints, compression))
    for leg in range(4):
        nearest, farthest = kinematics.reach(compression[leg])
        assert nearest - 1e-12 <= extension[leg] <= farthest + 1e-12
    straight = np.tile([0.3, 0.2, bp2.KNEE_RANGE[1]], (4, 1))
    assert leg_extension(kinematics.foot_position(straight)) == pytest.approx(
        kinematics.reach()[1]
    )


@given(low=st.floats(-4.0, 4.0), width=st.floats(0.0, 7.0), lower=st.floats(0.1, 0.4))
def test_reach_is_that_of_the_best_and_the_worst_knee_wherever_its_range_is(
    low, width, lower
):
    """As a search of the whole range finds it; the law is flat at its extremes: 1e-3
    rad off costs 1e-6 of a length."""
    leg = IDEAL.anatomy.legs[1]
    thigh, foot = leg.thigh_length, (0.0, 0.0, leg.foot_radius - lower)
    one = dataclasses.replace(
        leg, foot=foot, ranges=(*leg.ranges[:2], (low, low + width))
    )
    knees = np.linspace(low, low + width, 8001)
    distances = np.abs(thigh + lower * np.exp(1j * knees))
    nearest, farthest = one.reach()
    # not flat where it folds to a point
    assert distances.min() - 1e-3 * lower <= nearest <= distances.min() + 1e-12
    assert distances.max() - 1e-12 <= farthest <= distances.max() + 1e-6 * lower
