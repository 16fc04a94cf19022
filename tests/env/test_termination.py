"""The definition of a fall: one law for the environment of training and for the
judge."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env.termination import fall, fall_in_training, self_collision
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig, TerminationConfig

CONFIG = TerminationConfig()


def state(height=0.55, tilt=0.0, speed=0.0, joint=0.0):
    qpos, qvel = np.zeros(23), np.zeros(22)
    qpos[2], qpos[3], qpos[4] = height, math.cos(tilt / 2), math.sin(tilt / 2)
    qpos[9], qvel[7] = joint, speed
    return qpos, qvel


CASES = [
    ({}, None),
    ({"height": 0.31}, None),
    ({"height": 0.29}, "too_low"),
    ({"tilt": math.acos(0.81)}, None),
    ({"tilt": math.acos(0.79)}, "tilted"),
    ({"tilt": math.pi}, "tilted"),
    ({"speed": 199.0}, None),
    ({"speed": -201.0}, "exploded"),
    ({"speed": math.nan}, "exploded"),
    ({"height": math.nan}, "exploded"),
    ({"tilt": math.nan}, "exploded"),
    ({"joint": math.inf}, "exploded"),
]


@pytest.mark.parametrize(("changes", "cause"), CASES)
def test_falls(changes, cause):
    judged = fall(*state(**changes), CONFIG)
    assert judged.happened == (cause is not None)
    assert cause is None or getattr(judged, cause)


def test_a_batch_on_jax_is_judged_as_each_state_by_itself():
    states = [state(**changes) for changes, _ in CASES]
    qpos, qvel = (
        jnp.asarray(np.stack(x), jnp.float32) for x in zip(*states, strict=True)
    )
    expected = np.transpose([fall(*each, CONFIG)[:3] for each in states])
    np.testing.assert_array_equal(fall(qpos, qvel, CONFIG)[:3], expected)
    np.testing.assert_array_equal(
        jax.vmap(lambda q, v: fall(q, v, CONFIG))(qpos, qvel)[:3], expected
    )


@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0])
def test_the_tilt_does_not_depend_on_where_the_robot_looks(turn):
    """Turned about the vertical after being pitched by 0.6 rad, whose cosine is
    0.825."""
    qpos, qvel = state()
    pitch, yaw = (0.6 / 2, turn / 2)
    qpos[3:7] = (
        math.cos(yaw) * math.cos(pitch),
        -math.sin(yaw) * math.sin(pitch),
        math.cos(yaw) * math.sin(pitch),
        math.sin(yaw) * math.cos(pitch),
    )
    assert not fall(qpos, qvel, TerminationConfig(min_up=0.82)).happened
    assert fall(qpos, qvel, TerminationConfig(min_up=0.83)).tilted


@pytest.mark.parametrize(("max_overlap", "ends"), [(0.028, True), (0.030, False)])
def test_legs_may_be_in_each_other_by_so_much(max_overlap, ends):
    """Lower legs of 14.5 mm whose axes meet are 29 mm in each other."""
    qpos, _ = state()
    qpos[[7, 11]] = 0.4, -0.4
    config = TerminationConfig(max_overlap=max_overlap)
    assert self_collision(qpos, config, HardwareSpec(solid_legs=True)) == ends
    # NaN is no way out
    assert self_collision(np.full(23, math.nan), config, HardwareSpec(solid_legs=True))
    assert self_collision(qpos, config, HardwareSpec()) is None


@pytest.mark.parametrize(("torque", "action"), [(0.0, math.nan), (math.inf, 0.0)])
def test_in_training_numbers_that_are_not_finite_and_legs_in_each_other_end_an_episode_too(
    torque, action
):
    config, (qpos, qvel) = EnvConfig(hardware=HardwareSpec(solid_legs=True)), state()
    still, bad_torque, bad_action = np.zeros(12), np.zeros(12), np.zeros(12)
    bad_torque[5], bad_action[3] = torque, action
    assert not fall_in_training(qpos, qvel, still, still, config).happened
    assert fall_in_training(qpos, qvel, bad_torque, bad_action, config)[:3] == (
        True,
        False,
        False,
    )
    qpos[[7, 11]] = 0.4, -0.4
    assert fall_in_training(qpos, qvel, still, still, config)[:4] == (
        False,
        False,
        False,
        True,
    )
    assert (
        fall_in_training(qpos, qvel, still, still, EnvConfig()).self_collision is None
    )


def test_a_fall_asks_after_legs_only_where_it_was_told_to():
    judged = fall(*state(), CONFIG)
    assert not judged.happened
    assert judged._replace(self_collision=np.bool_(True)).happened
