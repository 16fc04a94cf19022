import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from runs import kick, no_action, run_one

from bp2_rl.base.errors import UserError
from bp2_rl.env.controller import motors_of
from bp2_rl.env.observations import add_noise, sense
from bp2_rl.env.termination import fall
from bp2_rl.learning.policy import load_policy
from bp2_rl.robot.actuator import joint_torque
from bp2_rl.robot.bp2 import STAND_JOINTS
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.hardware import HardwareSpec, Losses
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.model import (
    foot_forces,
    foot_geom_ids,
    load_model,
)
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import (
    ControlConfig,
    EnvConfig,
    TerminationConfig,
)
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.measuring import envelope_use, run_metrics
from bp2_rl.simulation.rollout import RunRequest, rollout, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import Numerics, RobotSetup, settled
from bp2_rl.simulation.world import LEVEL, World

STANDING = EnvConfig(control=ControlConfig(mode="absolute"))
TROTTING = EnvConfig()  # the action is added to the reference motion


def pd_torque(run, config):
    """Return the torque of motors without a lag under the recorded targets, Nm."""
    q, qd = run.joint_position, run.joint_velocity
    return joint_torque(motors_of(config), 0.0 * q, q, qd, run.target, 0.0 * qd, 1e-3)


# --- C MuJoCo -------------------------------------------------------------------------


def test_standing_start_is_at_rest_at_the_origin():
    simulator = settled([RobotSetup(STANDING)])
    rest = simulator.qpos[0].copy()
    stand = np.array([STAND_JOINTS])
    for _ in range(1000):  # and it stays there
        simulator.millisecond(stand, np.zeros((1, 12)))
    # MuJoCo's soft contacts let the feet creep apart by a millimetre a second;
    # unsettled, it rocks at 0.03 m/s.
    np.testing.assert_allclose(simulator.qpos[0], rest, atol=2e-3)
    assert np.max(np.abs(simulator.qvel)) < 5e-3
    np.testing.assert_allclose(rest[:3], (0.0, 0.0, 0.55), atol=0.015)
    np.testing.assert_array_equal(rest[:2], 0.0)
    assert yaw_of(rest[3:7]) == pytest.approx(0.0, abs=1e-3)


def test_feet_of_a_standing_robot_carry_its_weight():
    run = run_one(no_action, Ramp(0.0, hold=0.5), STANDING)
    assert run.fell_at is None
    force = np.mean(run.foot_force[-100:], axis=0)
    assert np.sum(force[:, 2]) == pytest.approx(run.mass * GRAVITY, rel=1e-3)
    np.testing.assert_allclose(np.sum(force[:, :2], axis=0), 0.0, atol=0.5)
    assert np.all(force[:, 2] > 0.15 * run.mass * GRAVITY)
    # bent legs push their feet apart, and the ground pushes back
    assert np.all(force[[0, 2], 1] * force[[1, 3], 1] < 0.0)


@pytest.mark.parametrize(
    "world",
    [LEVEL, World(terrain=Terrain("rough", 0.01, seed=3))],
    ids=["level", "rough"],
)
def test_foot_forces_are_those_that_mujoco_puts_on_the_feet(world):
    """Against the constraint forces: the ground is all that acts on the free trunk's
    six coordinates from outside."""
    simulator = settled([RobotSetup(STANDING, world)])
    model, data = simulator.models[0], simulator.data[0]
    data.qvel[:6] = 1.0, -0.5, -0.8, 0.3, 0.2, 0.0
    mujoco.mj_forward(model, data)
    force = foot_forces(data)
    assert np.min(np.abs(force[:, 0])) > 1.0  # all four slide
    by_contact, wrench, feet = (
        np.zeros((4, 3)),
        np.zeros(6),
        foot_geom_ids(model).tolist(),
    )
    for i, (geom, frame) in enumerate(
        zip(data.contact.geom2, data.contact.frame, strict=True)
    ):
        mujoco.mj_contactForce(model, data, i, wrench)
        by_contact[feet.index(geom)] += wrench[:3] @ frame.reshape(3, 3)
    assert len({round(value) for value in by_contact[:, 2]}) == 4  # each has another
    np.testing.assert_allclose(force, by_contact, rtol=1e-12)
    np.testing.assert_allclose(
        np.sum(force, axis=0), data.qfrc_constraint[:3], rtol=1e-9
    )


def test_no_torque_leaves_the_envelope_whatever_the_policy_does_until_it_falls():
    run = run_one(kick, Ramp(3.0, hold=5.0), TROTTING)
    use = envelope_use(run)
    assert np.sum(use.outside) == 0
    assert np.mean(use.near) > 0.05  # it tried
    assert run.fell_at == pytest.approx(len(run) * run.dt)
    assert len(run) < 4000
    assert not fall(run.qpos, run.qvel, TROTTING.termination).happened.any()


def test_finer_physics_leaves_start_samples_and_motors_as_they_are():
    schedule = Ramp(0.0, hold=0.1)
    usual, fine, finest = (
        run_one(kick, schedule, STANDING, numerics=Numerics(steps=steps))
        for steps in (1, 4, 8)
    )
    assert len(fine) == len(usual) == 100
    np.testing.assert_array_equal(fine.qpos[0], usual.qpos[0])
    np.testing.assert_allclose(fine.torque, pd_torque(fine, STANDING), atol=1e-9)
    # Euler's error is of first order in the step: from 1 ms to 1/8 it falls by 7/8,
    # from 1/4 to 1/8 by 1/8.
    coarse, small = (
        np.max(np.abs(run.qpos[:60] - finest.qpos[:60])) for run in (usual, fine)
    )
    assert 0.0 < small < 0.3 * coarse < 0.01


def test_finer_motors_lag_no_less():
    """The drive's first-order lag is of continuous time: computed in quarters of a
    millisecond it takes as long."""
    lagging = dataclasses.replace(
        STANDING, hardware=HardwareSpec(losses=Losses(current_lag=0.02))
    )
    schedule = Ramp(0.0, hold=0.1)
    held, fine = (
        run_one(
            kick, schedule, lagging, numerics=Numerics(steps=4, motors_each_step=each)
        )
        for each in (False, True)
    )
    rise, fine_rise = (np.abs(run.torque[1] - run.torque[0]) for run in (held, fine))
    assert np.min(rise) > 10.0
    # Implicit Euler goes 1/21 of the way in 1 ms and 1 - (80/81)^4, 2 % more, in four
    # quarters; the fine motors begin 0.75 ms, 4 % of the lag, earlier on theirs.
    np.testing.assert_allclose(fine_rise, rise, rtol=0.08)


def test_another_robot_runs_under_the_controller_of_the_assumed_one():
    heavy = HardwareSpec(mass_scale=1.1, peak_torque=100.0)
    config = EnvConfig(control=ControlConfig(feedforward=1.0))
    schedule = Ramp(1.0, hold=0.05)
    run = run_one(no_action, schedule, config, hardware=heavy)
    assert run.hardware == heavy
    own, assumed = (
        run_one(no_action, schedule, each)
        for each in (dataclasses.replace(config, hardware=heavy), config)
    )
    assert run.mass == pytest.approx(1.1 * assumed.mass)
    np.testing.assert_array_equal(run.qpos[0], own.qpos[0])  # it stands as it is
    # More weight asks for more torque from the start, but the controller knows nothing
    # of it.
    np.testing.assert_allclose(run.target[:5], assumed.target[:5], atol=1e-6)
    assert np.max(np.abs(run.target[:5] - own.target[:5])) > 1e-3
    weak = run_one(kick, schedule, config, hardware=heavy)
    assert np.max(np.abs(weak.torque)) == pytest.approx(100.0)


def test_a_rollout_is_a_run_whose_ramp_rises_as_the_policys_controller_lets_it():
    """From a stand at 6 m/s2, towards 18 m/s: v = 18 (1 - exp(-t / 3 s)), though 30
    m/s2 are asked for."""
    control = dataclasses.replace(STANDING.control, launching=6.0, launching_speed=18.0)
    config = dataclasses.replace(STANDING, control=control)
    run = rollout(no_action, Ramp(3.0, acceleration=30.0, hold=0.1), config=config)
    asked = Ramp(3.0, acceleration=30.0, hold=0.1, launching=6.0, launching_speed=18.0)
    assert run.steady_from == asked.steady_from > 0.5
    np.testing.assert_array_equal(run.qpos, run_one(no_action, asked, config).qpos)
    law = np.minimum(18.0 * (1.0 - np.exp(-run.time / 3.0)), 3.0)
    # ticks of 5 ms
    np.testing.assert_allclose(run.command[:, 0], law, atol=0.035)
    assert run.metrics == run_metrics(run)
    assert run.metrics is run.metrics  # it is measured once


def test_noise_of_the_sensors_changes_what_the_policy_observes_and_nothing_else():
    """Against the noise of training, drawn by hand: a policy whose action is its
    observation shows it in the target."""
    config = dataclasses.replace(
        STANDING, control=ControlConfig(mode="absolute", action_scale=0.1)
    )
    standing = Ramp(0.0, hold=0.02)

    def joints(observation):
        return observation[..., 5:17]  # rad, from the stand

    plain, noisy, again, other = (
        run_one(joints, standing, config, noise_seed=seed, operator=HeadingHold())
        for seed in (None, 3, 3, 4)
    )
    np.testing.assert_array_equal(noisy.qpos[0], plain.qpos[0])
    for field in ("qpos", "qvel", "torque", "command", "target", "foot_force"):
        np.testing.assert_array_equal(getattr(noisy, field), getattr(again, field))
    assert np.max(np.abs(noisy.target - other.target)) > 1e-4
    for k in range(4):
        measured = sense(
            jnp.asarray(noisy.qpos[5 * k], jnp.float32),
            jnp.asarray(noisy.qvel[5 * k], jnp.float32),
        )
        seen = add_noise(
            measured, config.randomization, jax.random.fold_in(jax.random.PRNGKey(3), k)
        )
        expected = np.asarray(STAND_JOINTS) + 0.1 * (
            seen.joint_position - np.asarray(STAND_JOINTS)
        )
        np.testing.assert_allclose(noisy.target[5 * k], expected, atol=1e-6)  # float32
    # The motors and the physics know nothing of it.
    np.testing.assert_allclose(noisy.torque, pd_torque(noisy, config), atol=1e-9)


def test_a_robot_without_noise_runs_beside_one_with_noise():
    requests = [RunRequest(Ramp(3.0, hold=0.1), noise_seed=seed) for seed in (None, 3)]
    plain, noisy = simulate(kick, requests, STANDING)
    alone = run_one(kick, Ramp(3.0, hold=0.1), STANDING)
    # compiled otherwise
    np.testing.assert_allclose(plain.target[:100], alone.target[:100], atol=1e-6)
    assert np.max(np.abs(noisy.target[:100] - alone.target[:100])) > 0.1


def test_a_shipped_policy_runs_in_three_lines():
    run = rollout(load_policy("built"), Ramp(2.0, hold=0.5))
    assert run.fell_at is None
    assert 1.0 < (run.metrics.best_speed or 0.0) < 2.5


def test_a_policy_that_observes_something_else_is_refused_before_it_runs():
    """The policy `built` observes its past, the default controller offers the present
    alone."""
    policy = load_policy("built")
    line = r"observes \('command@5', 3\) where this config gives nothing more; pass no config"
    with pytest.raises(UserError, match=line):
        rollout(policy, Ramp(1.0, hold=0.2), config=TROTTING)


def test_no_state_gone_bad_is_reset_behind_our_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warning to a log file
    simulator = settled([RobotSetup(STANDING)])
    model, data = simulator.models[0], simulator.data[0]
    data.qvel[0] = np.nan
    mujoco.mj_step(model, data)
    assert fall(data.qpos, data.qvel, TerminationConfig()).happened


def test_forces_of_legs_on_legs_are_not_the_grounds():
    """In the air, feet of the fore legs in each other."""
    model = load_model(HardwareSpec(solid_legs=True), visual=False, weighed=True)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qpos[2], data.qpos[[7, 11]] = 2.0, (0.36, -0.36)
    mujoco.mj_forward(model, data)
    feet = set(foot_geom_ids(model))
    assert any(
        pair <= feet
        for pair in ({*pair} for pair in zip(*data.contact.geom.T, strict=True))
    )
    np.testing.assert_array_equal(foot_forces(data), 0.0)
