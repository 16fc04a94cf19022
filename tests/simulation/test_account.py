"""The energy ledger and what is seen under the feet, of short runs of a robot that
trots without a policy."""

import dataclasses
from functools import cache

import mujoco
import numpy as np
import pytest
from known_strides import CAUSES
from runs import no_action, run_one
from synthetic import make_run

from bp2_rl.env.controller import motors_of
from bp2_rl.robot.actuator import bus_power, torque_limits
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.account import (
    account,
    before_contact,
    beyond_envelope,
    replay,
)
from bp2_rl.simulation.measuring import foot_centres
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import OUTSIDE, RobotSetup, Simulator
from bp2_rl.simulation.world import World

FLAT, UPHILL = Terrain(), Terrain("waves", 0.05, slope=0.05)
CONFIG = EnvConfig()  # the action is added to the reference motion


@cache
def trot(hardware: HardwareSpec = BUILT, terrain: Terrain = FLAT):
    """Return a run up to 2 m/s, half a second of it held, without a policy."""
    ramp, world = Ramp(2.0, acceleration=4.0, hold=0.5), World(terrain)
    return run_one(no_action, ramp, CONFIG, hardware=hardware, world=world)


@pytest.mark.parametrize(
    ("hardware", "terrain"),
    [(IDEAL, FLAT), (BUILT, FLAT), (BUILT, UPHILL)],
    ids=["ideal", "built", "waves uphill"],
)
def test_energy_closes_in_every_millisecond(hardware, terrain):
    """What the motors draw is what is lost and stored, each computed by itself;
    converged contacts leave 1e-9."""
    power = account(trot(hardware, terrain)).power
    assert power.closure < 1e-6
    assert set(power.lost) == set(CAUSES)
    whole = power.mean - sum(power.lost.values()) - power.stored - power.integration
    # the ledger's last millisecond has no energy after it
    assert abs(whole) < 0.02 * power.mean
    assert power.stored > 10.0  # 36 kg were brought to 2 m/s in a second
    lossless = {"gears", "joints", "slides", "air"}
    if hardware is IDEAL:
        assert all(power.lost[cause] == 0.0 for cause in lossless)
    else:
        assert all(power.lost[cause] > 0.0 for cause in lossless)


@pytest.mark.parametrize(
    "forgotten",
    [
        {"losses": dataclasses.replace(BUILT.losses, drag_area=0.0)},
        {"losses": dataclasses.replace(BUILT.losses, gear_efficiency=1.0)},
        {"losses": dataclasses.replace(BUILT.losses, joint_friction=0.0)},
        {"losses": dataclasses.replace(BUILT.losses, spring_friction=0.0)},
        {"contact_time": 0.006},
        {"spring_damping": 0.0},
    ],
    ids=["air", "gears", "joints", "slides", "ground", "dampers"],
)
def test_a_loss_that_was_not_booked_is_missed(forgotten):
    """The same run, booked as if its robot were another: the balance no longer
    closes."""
    run = dataclasses.replace(trot(), hardware=dataclasses.replace(BUILT, **forgotten))
    assert account(run).power.closure > 1e-5


def test_energy_is_of_motion_height_and_springs():
    """Against one half v' M v, m g h of the bodies, and one half k s^2 of the springs
    within their travel."""
    run = trot(IDEAL)
    ledger, _ = replay(run)
    simulator = Simulator([RobotSetup(EnvConfig())])
    model, data = simulator.models[0], simulator.data[0]
    for k in (0, 400, 760):
        data.qpos[:], data.qvel[:] = run.qpos[k], run.qvel[k]
        mujoco.mj_forward(model, data)
        momentum = np.zeros(22)
        mujoco.mj_mulM(model, data, momentum, data.qvel)
        springs = (
            np.where(run.spring_compression[k] < 0.0, 36e3, 6e3)
            * run.spring_compression[k] ** 2
        )
        height = float(np.sum(model.body_mass * data.xipos[:, 2]))
        expected = 0.5 * data.qvel @ momentum + 9.81 * height + 0.5 * np.sum(springs)
        assert ledger.energy[k] == pytest.approx(expected, rel=1e-9)


def test_the_bus_is_what_motors_and_windings_draw():
    run = trot()
    ledger, _ = replay(run)
    motors = motors_of(EnvConfig(hardware=BUILT))
    mean = 0.5 * (run.joint_velocity[:-1] + run.joint_velocity[1:])
    for expected in (
        bus_power(motors, run.torque[:-1], mean),
        np.sum(ledger.motors + ledger.copper, axis=1),
    ):
        np.testing.assert_allclose(ledger.bus, expected, rtol=1e-12, atol=1e-9)
    assert np.min(ledger.copper) >= 0.0


def test_gears_lose_their_share_of_the_motors_work():
    """8 % of |torque x speed|, where a joint is not at rest: most of the time."""
    run = trot()
    ledger, _ = replay(run)
    work = np.sum(np.abs(run.torque * run.joint_velocity), axis=-1)
    assert np.mean(ledger.lost["gears"]) == pytest.approx(0.08 * np.mean(work), rel=0.1)


def test_no_torque_leaves_the_envelope_at_any_time_of_a_built_robots_millisecond():
    """Under targets as rough as they can be; the ideal robot leaves it, by its own
    account."""

    def rough(hardware):
        robot, rng = (
            Simulator([RobotSetup(EnvConfig(hardware=hardware))]),
            np.random.default_rng(0),
        )
        robot.settle()
        worst = 0.0
        for _ in range(60):
            target = robot.qpos[:, MOTOR_QPOS] + rng.uniform(-0.5, 0.5, 12)
            for _ in range(5):
                before = robot.qvel[:, MOTOR_QVEL].copy()
                torque = robot.millisecond(target, np.zeros((1, 12)))
                for qd in (before, robot.qvel[:, MOTOR_QVEL]):
                    lower, upper = torque_limits(robot.motors[0], qd)
                    worst = max(
                        worst, float(np.max(np.maximum(torque - upper, lower - torque)))
                    )
        return worst

    assert rough(dataclasses.replace(IDEAL, envelope="throughout")) <= OUTSIDE + 1e-9
    assert rough(IDEAL) > 5.0
    assert np.max(beyond_envelope(trot())) <= OUTSIDE + 1e-9


def test_soles_are_where_they_are_and_move_as_they_move():
    """Heights and velocities of the soles against differences of the heights."""
    run = trot()
    _, soles = replay(run)
    radius = run.hardware.anatomy.geometry.foot_radius
    height = foot_centres(run)[:-1, :, 2] - radius
    np.testing.assert_allclose(
        np.diff(height, axis=0) / run.dt, soles.velocity[1:, :, 2], atol=0.6
    )
    assert account(run).ground.depth == pytest.approx(-np.min(height))
    assert 0.0 < account(run).ground.depth < 0.02


def test_a_landing_is_looked_at_just_before_the_foot_touches():
    touching = np.array([0, 0, 1, 0, 1, 1, 1, 0, 0, 1, 1], bool)
    assert list(before_contact(touching, np.array([4, 9]))) == [3, 8]
    assert list(before_contact(touching, np.array([], int))) == []


def test_a_force_plate_shows_means_of_five_milliseconds():
    run = trot()
    force = np.zeros_like(run.foot_force)
    force[::5, 2, 2] = 1000.0  # N, for one millisecond in five
    force[0:2, 1, 0] = 5000.0  # which is not vertical
    assert account(
        dataclasses.replace(run, foot_force=force)
    ).ground.plate_force == pytest.approx(200.0)
    # no 5 ms
    assert account(run.between(0.0, 0.003)).ground.plate_force < np.max(
        run.foot_force[..., 2]
    )


def test_motors_are_beyond_the_no_load_speed_of_the_robot_that_runs():
    run = trot()
    assert account(run).power.overspeed_share == 0.0
    slow = dataclasses.replace(
        run, hardware=dataclasses.replace(BUILT, no_load_speed=3.0, corner_speed=2.0)
    )
    share = account(slow).power.overspeed_share
    assert 0.05 < share == np.mean(np.abs(run.qvel[:, MOTOR_QVEL]) > 3.0)


def test_springs_give_what_they_were_given():
    """Against one half k s2 of the springs of 6000 N/m, their rebound stops of 36 kN/m
    in all included."""
    run = trot(IDEAL)
    ledger, _ = replay(run)
    s = run.spring_compression[:-1]
    held = 0.5 * np.where(s < 0.0, 36e3, 6e3) * s**2
    given = np.cumsum(ledger.springs, axis=0) * run.dt
    # The force is that at the beginning of its millisecond: a hundredth of what a
    # spring holds.
    np.testing.assert_allclose(given[:-1], held[0] - held[1:], atol=0.03 * np.max(held))
    assert np.max(held) > 2.0  # J


def test_springs_top_out_as_often_and_as_fast_as_they_swing():
    """Two springs swing about their rest at 10 Hz, one of them faster than 5 m/s where
    it lets go."""
    run = dataclasses.replace(make_run(duration=1.0), hardware=IDEAL)
    time, turning = run.time + 0.02, 2.0 * np.pi * 10.0
    amplitudes = np.array([0.02, 0.1, 0.0, 0.0])  # m
    qpos, qvel = run.qpos.copy(), run.qvel.copy()
    qpos[:, 10::4] = amplitudes * np.sin(turning * time[:, None])
    qvel[:, 9::4] = turning * amplitudes * np.cos(turning * time[:, None])
    np.testing.assert_array_equal(
        dataclasses.replace(run, qpos=qpos).spring_compression, qpos[:, 10::4]
    )
    ground = account(dataclasses.replace(run, qpos=qpos, qvel=qvel)).ground
    slow, fast = turning * amplitudes[:2]
    # one more or less at the ends of a second
    assert ground.top_outs == pytest.approx(20.0, abs=1.0)
    assert ground.hard_top_outs == pytest.approx(10.0, abs=1.0)
    # seen up to a millisecond late
    assert ground.top_out_speed == pytest.approx(fast, rel=0.01)
    assert ground.top_out_mean == pytest.approx((slow + fast) / 2.0, rel=0.01)
