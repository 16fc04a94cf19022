"""Every figure of merit against a run for which it is known in closed form."""

import json
import math

import numpy as np
import pytest

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import MOTOR_QVEL
from bp2_rl.simulation import gait, measuring
from bp2_rl.simulation.metrics import RunMetrics

# Nm, where the back-EMF line meets the torque axis
STALL_TORQUE = 120.0 / (1.0 - 14.7 / 21.4)


def with_motor(make_run, motor, torque, speed, **changes):
    """A run in which one motor does something; torque and speed are functions of
    time."""
    run = make_run(**changes)
    torques, qvel = run.torque.copy(), run.qvel.copy()
    torques[:, motor], qvel[:, MOTOR_QVEL[motor]] = torque(run.time), speed(run.time)
    return make_run(**(changes | {"torque": torques, "qvel": qvel}))


# --- Speed ----------------------------------------------------------------------------


def test_top_speed_is_the_best_one_second_mean(make_run):
    run = make_run(duration=8.0)
    qvel = run.qvel.copy()
    qvel[:, 0] = 4.0 + np.sin(2 * np.pi * run.time / 4.0)
    m = make_run(qvel=qvel).metrics
    assert m.best_speed == pytest.approx(
        4.0 + np.sin(np.pi / 4) / (np.pi / 4), abs=1e-5
    )  # mean of a sine's top quarter
    assert m.slowest_held_speed == pytest.approx(
        4.0 - np.sin(np.pi / 4) / (np.pi / 4), abs=1e-5
    )


def test_held_speed_is_the_best_five_second_mean_of_the_hold_phase(make_run):
    run = make_run(duration=12.0)  # held from 2 s on
    qvel = run.qvel.copy()
    qvel[:, 0] = 4.0 + np.sin(2 * np.pi * run.time / 20.0)
    m = make_run(duration=12.0, qvel=qvel).metrics
    # The sine peaks at 5 s: the best five seconds are those from 2.5 to 7.5 s.
    assert m.held_speed == pytest.approx(
        4.0 + np.sin(np.pi / 4) / (np.pi / 4), abs=1e-5
    )
    late = make_run(duration=12.0, qvel=qvel, steady_from=7.0).metrics
    # Held from 7 s on it falls all the time: the first five seconds, to a sum of 1 ms.
    assert late.held_speed == pytest.approx(
        4.0 + 4 / np.pi * np.sin(np.pi * 0.95) * np.sin(np.pi / 4), abs=1e-3
    )


@pytest.mark.parametrize(("duration", "held"), [(6.999, False), (7.0, True)])
def test_a_hold_shorter_than_five_seconds_has_no_held_speed(make_run, duration, held):
    m = make_run(duration=duration, speed=5.0, acceleration=2.5).metrics
    assert m.held_speed == (pytest.approx(5.0) if held else None)


def test_a_run_shorter_than_a_second_has_no_top_speed(make_run):
    m = make_run(duration=0.9).metrics
    assert m.best_speed is None
    assert m.froude_number is None


def test_tracking_error_is_the_mean_distance_from_the_command_while_held(make_run):
    run = make_run()
    qvel = run.qvel.copy()
    qvel[:, 0] += np.where(
        run.time < 2.0, 3.0, 0.4 * np.sign(np.sin(2 * np.pi * 5.0 * run.time + 1e-9))
    )
    m = make_run(qvel=qvel).metrics
    # what happened on the ramp does not count
    assert m.tracking_error == pytest.approx(0.4, abs=1e-9)
    assert m.mean_speed == pytest.approx(5.0, abs=1e-3)


def test_hold_time_and_distance_of_a_whole_run(make_run):
    m = make_run(duration=8.0, speed=5.0, acceleration=2.5).metrics
    assert m.fell_at is None
    assert m.duration == pytest.approx(8.0)
    assert (m.steady_from, m.steady_to) == pytest.approx((2.0, 8.0))
    assert m.hold_time == pytest.approx(6.0)
    # sums of 1 ms, end sample not passed
    assert m.distance == pytest.approx(0.5 * 2.5 * 2.0**2 + 5.0 * 6.0, abs=0.02)


def test_a_fall_on_the_ramp_leaves_no_hold_to_measure(make_run):
    run = make_run(duration=1.5, fell_at=1.5)
    m = run.metrics
    assert m.fell_at == 1.5
    assert m.hold_time == 0.0
    assert m.tracking_error is None
    assert m.slowest_held_speed is None
    # the best second stands in
    assert (m.steady_from, m.steady_to) == pytest.approx((0.5, 1.5))
    assert m.mean_speed == pytest.approx(2.5 * 1.0, abs=2e-3)


def test_drift_is_measured_from_the_line_and_heading_at_the_start(make_run):
    run = make_run()
    yaw = 0.3 + 0.02 * np.sin(run.time * np.pi / 8.0)
    along, aside = run.qpos[:, 0], 0.5 * run.time / 8.0
    qpos = run.qpos.copy()
    qpos[:, 0] = 7.0 + np.cos(0.3) * along - np.sin(0.3) * aside
    qpos[:, 1] = -2.0 + np.sin(0.3) * along + np.cos(0.3) * aside
    qpos[:, 3], qpos[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    m = make_run(qpos=qpos).metrics
    assert m.lateral_drift == pytest.approx(0.5, abs=1e-3)
    assert m.heading_drift == pytest.approx(0.02, abs=1e-6)


def test_the_papers_numbers_at_its_top_speed(make_run):
    assert measuring.froude_number(10.74) == pytest.approx(21.4, abs=0.05)
    assert measuring.motor_demand(
        make_run(duration=0.1, mass=36.0), 10.74
    ) == pytest.approx(1.475, abs=0.005)


# --- Motors ---------------------------------------------------------------------------


def test_power_of_torque_and_speed_in_phase(make_run):
    torque, speed = 40.0, 6.0
    run = with_motor(
        make_run,
        4,
        lambda t: torque * np.sin(8 * np.pi * t),
        lambda t: speed * np.sin(8 * np.pi * t),
    )
    m = run.metrics
    assert m.mechanical_power == pytest.approx(torque * speed / 2, rel=1e-6)
    copper = torque**2 / 2 * 21.4 / STALL_TORQUE
    assert m.electrical_power == pytest.approx(torque * speed / 2 + copper, rel=1e-6)
    weight_speed = 36.0 * conventions.GRAVITY * 5.0
    assert m.mechanical_cost_of_transport == pytest.approx(
        torque * speed / 2 / weight_speed, rel=1e-6
    )
    assert m.electrical_cost_of_transport == pytest.approx(
        (torque * speed / 2 + copper) / weight_speed, rel=1e-6
    )
    motor = m.motors[4]
    assert motor.name == "FL_hip"
    assert (motor.peak_torque, motor.peak_speed, motor.peak_power) == pytest.approx(
        (40.0, 6.0, 240.0), rel=1e-3
    )


def test_braking_earns_nothing(make_run):
    run = with_motor(
        make_run,
        0,
        lambda t: 30.0 * np.sin(8 * np.pi * t),
        lambda t: 6.0 * np.cos(8 * np.pi * t),
    )
    # half a sine of twice w
    assert run.metrics.mechanical_power == pytest.approx(
        30.0 * 6.0 / (2 * np.pi), rel=1e-3
    )
    run = with_motor(make_run, 0, lambda t: 30.0 + 0 * t, lambda t: -6.0 + 0 * t)
    m = run.metrics
    assert m.mechanical_power == 0.0
    assert m.motors[0].peak_power == 0.0
    assert m.electrical_power == pytest.approx(30.0**2 * 21.4 / STALL_TORQUE)


def test_a_robot_that_goes_nowhere_has_no_cost_of_transport(make_run):
    run = make_run(speed=1e-6, steady_from=0.0)
    assert run.metrics.mechanical_cost_of_transport is None


@pytest.mark.parametrize(
    ("torque", "speed", "near", "outside"),
    [
        (118.7, 10.0, False, False),  # 1.3 Nm below the peak
        (118.9, 10.0, True, False),
        (120.0, 14.0, True, False),
        (120.01, 10.0, True, True),
        (-120.01, -10.0, True, True),
        (-119.0, 20.0, True, False),  # braking is flat
        (STALL_TORQUE * (1 - 18.0 / 21.4), 18.0, True, False),  # on the back-EMF line
        (STALL_TORQUE * (1 - 18.0 / 21.4) + 0.01, 18.0, True, True),
        (-STALL_TORQUE * (1 - 18.0 / 21.4) - 0.01, -18.0, True, True),
        (0.1, 21.5, True, True),  # nothing drives beyond the no-load speed
    ],
)
def test_envelope_is_compared_at_every_sample(make_run, torque, speed, near, outside):
    run = with_motor(
        make_run, 8, lambda t: torque * (t < 2.0), lambda t: speed * (t < 2.0)
    )
    m = run.metrics
    assert m.motors[8].on_envelope == (0.25 if near else 0.0)  # 2 s of 8
    assert m.on_envelope == pytest.approx(0.25 / 12 if near else 0.0)
    assert m.outside_envelope == (2000 if outside else 0)


def test_envelope_is_that_of_the_hardware_that_ran(make_run):
    geared = HardwareSpec(gear_ratio=17.0)  # twice the torque at half the speed
    run = with_motor(
        make_run, 8, lambda t: 230.0 + 0 * t, lambda t: 7.0 + 0 * t, hardware=geared
    )
    assert run.metrics.outside_envelope == 0
    run = with_motor(
        make_run, 8, lambda t: 230.0 + 0 * t, lambda t: 8.0 + 0 * t, hardware=geared
    )
    assert run.metrics.outside_envelope == 8000


# --- Legs -----------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency", "duty"), [(2.0, 0.6), (4.0, 0.25), (3.1, 0.18)])
def test_duty_factor_and_stride_frequency_of_a_trot(make_run, frequency, duty):
    m = make_run(frequency=frequency, duty=duty).metrics
    # of the half sine, in body weights: its ends lie below the thresholds
    peak = np.pi / (8 * duty)
    unseen = (
        np.arcsin(gait.TOUCH_FORCE / peak) + np.arcsin(gait.LIFT_FORCE / peak)
    ) / np.pi
    for leg in m.legs:
        # touchdowns fall on milliseconds
        assert leg.stride_frequency == pytest.approx(frequency, rel=2e-3)
        assert leg.duty_factor == pytest.approx(
            duty * (1 - unseen), abs=1e-3 * frequency
        )


def test_bounces_and_scuffs_are_not_strides(make_run):
    run = make_run()
    force = run.foot_force.copy()
    phase = (4.0 * run.time[:, None] + np.array([0.5, 0.0, 0.0, 0.5])) % 1.0
    force[(phase > 0.04) & (phase < 0.12)] = 0.0  # 20 ms in the air
    force[(phase > 0.60) & (phase < 0.63), 2] = 300.0  # 7 ms of the toe dragging
    clean, rough = run.metrics, make_run(foot_force=force).metrics
    for a, b in zip(clean.legs, rough.legs, strict=True):
        assert b.duty_factor == pytest.approx(a.duty_factor, abs=1e-9)
        assert b.stride_frequency == pytest.approx(a.stride_frequency, rel=1e-9)


def test_a_hop_longer_than_a_bounce_is_a_stride(make_run):
    run = make_run()
    force = run.foot_force.copy()
    phase = (4.0 * run.time[:, None] + np.array([0.5, 0.0, 0.0, 0.5])) % 1.0
    force[(phase > 0.05) & (phase < 0.20)] = 0.0  # 37 ms
    assert make_run(foot_force=force).metrics.legs[1].stride_frequency == pytest.approx(
        8.0, rel=0.02
    )


def test_left_and_right_are_half_a_cycle_apart_and_push_alike(make_run):
    run = make_run()
    even = run.metrics
    assert even.off_half_cycle == pytest.approx(0.0, abs=1e-3)
    assert even.uneven == pytest.approx(0.0, abs=1e-3)
    # The front left leg lands 10 ms late, of the quarter of a second that a stride
    # takes, and 4 % harder.
    force = run.foot_force.copy()
    force[:, 1] = 1.04 * np.roll(force[:, 1], 10, axis=0)
    lame = make_run(foot_force=force).metrics
    assert lame.off_half_cycle == pytest.approx(0.04, abs=1e-3)
    assert lame.uneven == pytest.approx(0.02 / 4.04 * 2, abs=1e-3)
    assert make_run(foot_force=0.0 * force).metrics.off_half_cycle is None


def test_contact_needs_more_force_to_begin_than_to_last(make_run):
    run = make_run(duration=0.4)
    weight = 36.0 * conventions.GRAVITY
    force = np.zeros((400, 4, 3))
    force[50:, :, 2] = 0.04 * weight  # between the thresholds: not yet
    force[150:, :, 2] = 0.5 * weight  # on the ground
    force[250:, :, 2] = 0.03 * weight  # between the thresholds: still
    force[350:, :, 2] = 0.01 * weight  # off
    standing = gait.contacts(make_run(duration=0.4, foot_force=force))
    np.testing.assert_array_equal(
        standing, np.tile(((run.time >= 0.1495) & (run.time < 0.3495))[:, None], 4)
    )


def test_a_standing_robot_has_duty_one_and_no_stride(make_run):
    force = np.zeros((8000, 4, 3))
    force[:, :, 2] = 36.0 * conventions.GRAVITY / 4
    m = make_run(foot_force=force).metrics
    assert [leg.duty_factor for leg in m.legs] == [1.0] * 4
    assert [leg.stride_frequency for leg in m.legs] == [None] * 4


def test_peak_force_is_the_length_of_the_vector(make_run):
    force = make_run().foot_force.copy()
    force[4000, 2] = (300.0, 0.0, 1000.0)
    m = make_run(foot_force=force).metrics
    assert (
        m.legs[2].peak_foot_force
        == m.peak_foot_force
        == pytest.approx(np.hypot(300.0, 1000.0))
    )


def test_springs_are_on_their_stop_beyond_full_travel(make_run):
    run = make_run()
    qpos = run.qpos.copy()
    # FR for 10 %, FL for 10 %, half of it together
    qpos[:800, 10], qpos[400:1200, 14] = 0.131, 0.135
    qpos[:, 18] = 0.13
    m = make_run(qpos=qpos).metrics
    assert [leg.on_stop for leg in m.legs] == pytest.approx([0.1, 0.1, 0.0, 0.0])
    assert m.on_stop == pytest.approx(0.15)
    assert [leg.stop_hits for leg in m.legs] == [1, 1, 0, 0]
    assert m.peak_spring_travel == 0.135


def test_every_arrival_of_a_spring_at_its_stop_is_a_hit(make_run):
    qpos = make_run().qpos.copy()
    for start in (0, 100, 300):  # on it from the start, and twice more
        qpos[start : start + 50, 10] = 0.131
    qpos[120:130, 22] = 0.131  # another spring at the same time
    m = make_run(qpos=qpos).metrics
    assert [leg.stop_hits for leg in m.legs] == [3, 0, 0, 1]
    assert m.stop_hits == 4


# --- As a file ------------------------------------------------------------------------


def test_metrics_survive_strict_json(make_run):
    for run in (make_run(), make_run(duration=0.5, fell_at=0.5)):
        m = run.metrics
        assert (
            from_json(RunMetrics, json.loads(json.dumps(to_json(m), allow_nan=False)))
            == m
        )


def test_legs_that_touch_are_counted_by_the_millisecond_solid_or_not(make_run):
    """Both fore legs are swung inwards so far that they cross, for 0.3 s of 8 s."""
    run = make_run(duration=8.0)
    qpos = run.qpos.copy()
    apart = make_run(qpos=qpos).metrics
    assert (apart.leg_contact, apart.leg_contact_time, apart.leg_depth) == (
        0.0,
        0.0,
        0.0,
    )
    # Legs hang straight down: lines 0.32 m apart behind, feet of 20 mm; hips 0.16 m off
    # the beams' end, 20 mm back.
    assert apart.leg_clearance == pytest.approx(0.32 - 2 * 0.02, abs=1e-12)
    assert apart.trunk_clearance == pytest.approx(
        math.hypot(0.02, 0.12) - 0.07 - 0.018, abs=1e-12
    )
    qpos[1000:1300, [7, 11]] = 0.4, -0.4
    for hardware in (HardwareSpec(), HardwareSpec(solid_legs=True)):
        crossed = make_run(qpos=qpos, hardware=hardware).metrics
        assert crossed.leg_contact_time == pytest.approx(0.3)
        assert crossed.leg_contact == pytest.approx(300 / 8000)
        assert crossed.leg_depth == pytest.approx(-crossed.leg_clearance)
        # the lower legs' axes meet
        assert crossed.leg_depth == pytest.approx(2 * 0.0145)
