import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env.controller import Controller, motion_of
from bp2_rl.env.observations import Measurement, layout_of, size_of
from bp2_rl.reference.kinematic_trot import KinematicGait, Standing
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import ControlConfig, EnvConfig

COMMAND = jnp.array([6.0, 0.0, 0.0])


def targets(config: EnvConfig, action: float = 0.0):
    """Return the controller's joint targets for an action that is the same for all
    joints."""
    controller = Controller(config)
    return controller.act(controller.init(0.2), COMMAND, jnp.full(12, action))


@pytest.mark.parametrize(
    ("name", "motion"),
    [
        ("kinematic", KinematicGait),
        ("collocation", CollocationGait),
        ("none", Standing),
    ],
)
def test_the_reference_is_the_one_that_was_named_for_this_robot(name, motion):
    config = EnvConfig(reference=name, hardware=HardwareSpec(mass_scale=1.1))
    reference_motion = motion_of(config)
    assert isinstance(reference_motion, motion)
    assert reference_motion.hardware == config.hardware
    state, target, reference = targets(config)
    expected = reference_motion(COMMAND, state.phase)
    assert np.allclose(target.position, expected.joint_position)
    assert np.allclose(reference.height, expected.height)
    assert np.allclose(target.velocity, expected.joint_velocity)


def test_without_a_reference_the_robot_is_asked_to_stand_and_its_phase_goes_on():
    config = EnvConfig(reference="none")
    state, target, reference = targets(config)
    # a pose with the soles below the hips
    assert np.allclose(target.position, bp2.STAND_JOINTS, atol=0.1)
    assert np.all(target.velocity == 0.0)
    assert float(state.phase) > 0.2
    assert np.allclose(reference.velocity, COMMAND)


@pytest.mark.parametrize("reference", ["kinematic", "collocation"])
def test_the_clock_can_be_hidden_from_a_policy_where_nothing_steps(reference):
    measured = Measurement(
        jnp.zeros(12), jnp.zeros(12), jnp.array([0.0, 0.0, 1.0]), jnp.zeros(3)
    )

    def clock(speed, clock_at_rest):
        config = EnvConfig(
            reference=reference, control=ControlConfig(clock_at_rest=clock_at_rest)
        )
        controller = Controller(config)
        return controller.observe(
            controller.init(0.125), jnp.array([speed, 0.0, 0.0]), measured
        )[1][3:5]

    seen = np.full(2, math.sqrt(0.5))
    np.testing.assert_allclose(clock(0.0, True), seen, rtol=1e-6)
    np.testing.assert_array_equal(clock(0.0, False), 0.0)
    assert 0.05 < float(clock(0.1, False)[0]) < 0.5
    np.testing.assert_allclose(clock(6.0, False), seen, rtol=2e-3)


def test_history_is_what_changed_since_then_and_nothing_at_first():
    config = EnvConfig(control=ControlConfig(history=(1, 3)))
    controller = Controller(config)
    state, frames, seen = controller.init(0.2), [], []
    for k in range(5):
        measured = Measurement(
            jnp.full(12, float(k) ** 2),
            jnp.zeros(12),
            jnp.array([0.0, 0.0, 1.0]),
            jnp.zeros(3),
        )
        frames.append(np.asarray(controller.frame(state, COMMAND, measured)))
        state, observation = controller.observe(state, COMMAND, measured)
        seen.append(np.asarray(observation))
        state, _, _ = controller.act(state, COMMAND, jnp.full(12, 0.1 * k))
    assert size_of(layout_of(config)) == len(seen[0]) == 3 * 47
    for k, observation in enumerate(seen):
        now, one, three = np.split(observation, 3)
        np.testing.assert_array_equal(now, frames[k])
        np.testing.assert_array_equal(one, frames[k] - frames[k - 1] if k >= 1 else 0.0)
        np.testing.assert_array_equal(
            three, frames[k] - frames[k - 3] if k >= 3 else 0.0
        )


def test_feed_forward_is_the_torque_that_the_pd_law_makes_of_the_offset():
    plain, fed = (
        dataclasses.replace(
            EnvConfig(reference="collocation"), control=ControlConfig(feedforward=share)
        )
        for share in (0.0, 0.5)
    )
    (_, without, reference), (_, with_torque, _) = targets(plain), targets(fed)
    offset = with_torque.position - without.position
    assert np.allclose(
        fed.control.stiffness * offset, 0.5 * reference.torque, atol=1e-3
    )
    assert np.abs(reference.torque).max() > 1.0
