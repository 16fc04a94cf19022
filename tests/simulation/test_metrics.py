"""Every figure of merit against a run for which it is known in closed form."""

import math

import numpy as np
import pytest

from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import MOTOR_QVEL
from bp2_rl.simulation import gait, measuring

# Nm, where the back-EMF line meets the torque axis
STALL_TORQUE = 120.0 / (1.0 - 14.7 / 21.4)


def with_speed(make_run, forward, **changes):
    """Return the metrics of a run whose forward speed is a function of time."""
    run = make_run(**changes)
    qvel = run.qvel.copy()
    qvel[:, 0] = forward(run.time)
    return make_run(**changes, qvel=qvel).metrics


def with_motor(make_run, motor, torque, speed, **changes):
    """Return the metrics of a run in which one motor's torque and speed are functions
    of time."""
    run = make_run(**changes)
    torques, qvel = run.torque.copy(), run.qvel.copy()
    torques[:, motor], qvel[:, MOTOR_QVEL[motor]] = torque(run.time), speed(run.time)
    return make_run(**(changes | {"torque": torques, "qvel": qvel})).metrics


# --- Speed ----------------------------------------------------------------------------


def test_top_speed_is_the_best_one_second_mean(make_run):
    m = with_speed(make_run, lambda t: 4.0 + np.sin(2 * np.pi * t / 4.0))
    mean = np.sin(np.pi / 4) / (np.pi / 4)  # of a sine's top quarter
    assert m.best_speed == pytest.approx(4.0 + mean, abs=1e-5)
    assert m.slowest_held_speed == pytest.approx(4.0 - mean, abs=1e-5)
    short = make_run(duration=0.9, speed=1e-6, steady_from=0.0).metrics
    assert short.best_speed is None
    assert short.froude_number is None
    assert short.mechanical_cost_of_transport is None  # it goes nowhere


@pytest.mark.parametrize(
    ("steady_from", "above", "tolerance"),
    [
        # The sine peaks at 5 s: the best five seconds are those from 2.5 to 7.5 s.
        (2.0, 1.0, 1e-5),
        # Held from 7 s on it falls all the time: the first five seconds, to a sum of
        # 1 ms.
        (7.0, np.sin(np.pi * 0.95), 1e-3),
    ],
)
def test_held_speed_is_the_best_five_second_mean_of_the_hold(
    make_run, steady_from, above, tolerance
):
    m = with_speed(
        make_run,
        lambda t: 4.0 + np.sin(2 * np.pi * t / 20.0),
        duration=12.0,
        steady_from=steady_from,
    )
    expected = 4.0 + above * np.sin(np.pi / 4) / (np.pi / 4)
    assert m.held_speed == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize(("duration", "held"), [(6.999, False), (7.0, True)])
def test_a_hold_shorter_than_five_seconds_has_no_held_speed(make_run, duration, held):
    m = make_run(duration=duration, speed=5.0, acceleration=2.5).metrics
    assert m.held_speed == (pytest.approx(5.0) if held else None)


def test_tracking_error_is_the_mean_distance_from_the_command_while_held(make_run):
    def speed(t):
        ripple = 0.4 * np.sign(np.sin(2 * np.pi * 5.0 * t + 1e-9))
        return np.minimum(2.5 * t, 5.0) + np.where(t < 2.0, 3.0, ripple)

    m = with_speed(make_run, speed)
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
    m = with_motor(
        make_run,
        4,
        lambda t: 40.0 * np.sin(8 * np.pi * t),
        lambda t: 6.0 * np.sin(8 * np.pi * t),
    )
    work, copper = 40.0 * 6.0 / 2, 40.0**2 / 2 * 21.4 / STALL_TORQUE
    weight_speed = 36.0 * conventions.GRAVITY * 5.0
    assert (m.mechanical_power, m.electrical_power) == pytest.approx(
        (work, work + copper), rel=1e-6
    )
    assert (
        m.mechanical_cost_of_transport,
        m.electrical_cost_of_transport,
    ) == pytest.approx((work / weight_speed, (work + copper) / weight_speed), rel=1e-6)
    motor = m.motors[4]
    assert motor.name == "FL_hip"
    assert (motor.peak_torque, motor.peak_speed, motor.peak_power) == pytest.approx(
        (40.0, 6.0, 240.0), rel=1e-3
    )


def test_braking_earns_nothing(make_run):
    out_of_phase = with_motor(
        make_run,
        0,
        lambda t: 30.0 * np.sin(8 * np.pi * t),
        lambda t: 6.0 * np.cos(8 * np.pi * t),
    )
    # half a sine of twice w
    assert out_of_phase.mechanical_power == pytest.approx(
        30.0 * 6.0 / (2 * np.pi), rel=1e-3
    )
    m = with_motor(make_run, 0, lambda t: 30.0 + 0 * t, lambda t: -6.0 + 0 * t)
    assert (m.mechanical_power, m.motors[0].peak_power) == (0.0, 0.0)
    assert m.electrical_power == pytest.approx(30.0**2 * 21.4 / STALL_TORQUE)


@pytest.mark.parametrize(
    ("torque", "speed", "near", "outside", "gear_ratio"),
    [
        (118.7, 10.0, False, False, 8.5),  # 1.3 Nm below the peak
        (118.9, 10.0, True, False, 8.5),
        (120.0, 14.0, True, False, 8.5),
        (120.01, 10.0, True, True, 8.5),
        (-120.01, -10.0, True, True, 8.5),
        (-119.0, 20.0, True, False, 8.5),  # braking is flat
        # on the back-EMF line
        (STALL_TORQUE * (1 - 18.0 / 21.4), 18.0, True, False, 8.5),
        (STALL_TORQUE * (1 - 18.0 / 21.4) + 0.01, 18.0, True, True, 8.5),
        (-STALL_TORQUE * (1 - 18.0 / 21.4) - 0.01, -18.0, True, True, 8.5),
        (0.1, 21.5, True, True, 8.5),  # nothing drives beyond the no-load speed
        (230.0, 7.0, False, False, 17.0),  # twice the torque at half the speed
        (230.0, 8.0, True, True, 17.0),
    ],
)
def test_every_sample_is_compared_with_the_envelope_of_the_hardware_that_ran(
    make_run, torque, speed, near, outside, gear_ratio
):
    m = with_motor(
        make_run,
        8,
        lambda t: torque * (t < 2.0),
        lambda t: speed * (t < 2.0),
        hardware=HardwareSpec(gear_ratio=gear_ratio),
    )
    assert m.motors[8].on_envelope == (0.25 if near else 0.0)  # 2 s of 8
    assert m.on_envelope == pytest.approx(0.25 / 12 if near else 0.0)
    assert m.outside_envelope == (2000 if outside else 0)


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


def test_bounces_and_scuffs_are_not_strides_and_hops_are(make_run):
    run = make_run()
    phase = (4.0 * run.time[:, None] + np.array([0.5, 0.0, 0.0, 0.5])) % 1.0
    force, hop = run.foot_force.copy(), run.foot_force.copy()
    force[(phase > 0.04) & (phase < 0.12)] = 0.0  # 20 ms in the air
    force[(phase > 0.60) & (phase < 0.63), 2] = 300.0  # 7 ms of the toe dragging
    clean, rough = run.metrics, make_run(foot_force=force).metrics
    for a, b in zip(clean.legs, rough.legs, strict=True):
        assert b.duty_factor == pytest.approx(a.duty_factor, abs=1e-9)
        assert b.stride_frequency == pytest.approx(a.stride_frequency, rel=1e-9)
    hop[(phase > 0.05) & (phase < 0.20)] = 0.0  # 37 ms
    assert make_run(foot_force=hop).metrics.legs[1].stride_frequency == pytest.approx(
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
    # both front legs do: left and right are alike, front and rear are not
    force[:, 0] = 1.04 * np.roll(force[:, 0], 10, axis=0)
    level = make_run(foot_force=force).metrics
    assert level.off_half_cycle == pytest.approx(0.0, abs=1e-3)
    assert level.uneven == pytest.approx(0.0, abs=1e-3)
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


def test_every_arrival_of_a_spring_at_its_stop_is_a_hit(make_run):
    qpos = make_run().qpos.copy()
    for start in (0, 100, 300):  # on it from the start, and twice more
        qpos[start : start + 50, 10] = 0.131
    qpos[120:920, 22] = 0.135  # another spring, at the same time as the first
    qpos[:, 18] = 0.13  # at full travel, not beyond
    m = make_run(qpos=qpos).metrics
    assert [leg.stop_hits for leg in m.legs] == [3, 0, 0, 1]
    assert m.stop_hits == 4
    expected = [150 / 8000, 0.0, 0.0, 0.1]
    assert [leg.on_stop for leg in m.legs] == pytest.approx(expected)
    assert m.on_stop == pytest.approx((150 + 800 - 80) / 8000)
    assert m.peak_spring_travel == 0.135


def test_legs_that_touch_are_counted_by_the_millisecond_solid_or_not(make_run):
    """Both fore legs are swung inwards so far that they cross, for 0.3 s of 8 s."""
    run = make_run(duration=8.0)
    apart, qpos = run.metrics, run.qpos.copy()
    assert (apart.leg_contact, apart.leg_contact_time, apart.leg_depth) == (0, 0, 0)
    # Legs hang straight down: lines 0.32 m apart behind, feet of 20 mm; hips 0.16 m off
    # the beams' end, 20 mm back.
    assert (apart.leg_clearance, apart.trunk_clearance) == pytest.approx(
        (0.32 - 2 * 0.02, math.hypot(0.02, 0.12) - 0.07 - 0.018), abs=1e-12
    )
    qpos[1000:1300, [7, 11]] = 0.4, -0.4
    for hardware in (HardwareSpec(), HardwareSpec(solid_legs=True)):
        crossed = make_run(qpos=qpos, hardware=hardware).metrics
        assert crossed.leg_contact_time == pytest.approx(0.3)
        assert crossed.leg_contact == pytest.approx(300 / 8000)
        # the lower legs' axes meet
        assert crossed.leg_depth == pytest.approx(2 * 0.0145)
        assert crossed.leg_clearance == pytest.approx(-2 * 0.0145)
