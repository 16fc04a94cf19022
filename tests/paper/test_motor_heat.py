"""Heat in the motors, against closed forms; motors at ambient temperature are unchanged
to the last bit."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from bp2_rl.base.errors import UserError
from bp2_rl.paper.motor_heat import (
    ENVELOPE_TEMPERATURE,
    RISE,
    WAYS,
    Temperatures,
    advance,
    calibrated,
    heat_ratio,
    heated,
    rise,
    warming,
)
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot.actuator import (
    Actuator,
    Bus,
    joint_torque,
    torque_limits,
    winding_heat,
)
from bp2_rl.robot.hardware import BUILT, IDEAL

MOTOR = MotorHeat()
COOLED = dataclasses.replace(MOTOR, winding_to_case=0.8)
EVEN = dataclasses.replace(COOLED, copper_growth=0.0, magnet_loss=0.0)
POWERS = np.array([0.0, 20.0, 150.0, 280.0])  # W
STEP = 0.4  # s, ten times what a run takes


def cold(shape: tuple[int, ...] = POWERS.shape) -> Temperatures:
    return Temperatures.uniform(MOTOR.air, shape)


def course(
    motor: MotorHeat, powers: np.ndarray, seconds: float, step: float = STEP
) -> Temperatures:
    now = cold(powers.shape)
    for _ in range(round(seconds / step)):
        now = advance(motor, now, powers, step)
    return now


def test_constant_heat_warms_as_the_exponentials_of_the_2x2_matrix():
    n = dataclasses.replace(EVEN, iron_loss=12.0)
    matrix = np.array(
        [
            [
                -1.0 / n.to_case / n.winding_capacity,
                1.0 / n.to_case / n.winding_capacity,
            ],
            [
                1.0 / n.to_case / n.case_capacity,
                -(1 / n.to_case + 1 / n.case_to_air) / n.case_capacity,
            ],
        ]
    )
    found = course(n, POWERS, 172.0)
    for i, power in enumerate(POWERS):
        steady = -np.linalg.solve(
            matrix, [power / n.winding_capacity, 12.0 / n.case_capacity]
        )
        exact = steady - expm(172.0 * matrix) @ steady + MOTOR.air
        assert (found.winding[i], found.case[i]) == pytest.approx(exact, rel=1e-6)


def test_a_winding_that_gives_nothing_away_heats_ever_faster():
    """T - T_0 = (e^(a r0 t) - 1) / a with r0 = P_0 / C_w."""
    shut = dataclasses.replace(COOLED, winding_to_case=1e6)
    a, rate = MOTOR.copper_growth, POWERS / MOTOR.winding_capacity
    exact = np.expm1(a * rate * 86.0) / a
    np.testing.assert_allclose(
        course(shut, POWERS, 86.0).winding - MOTOR.air, exact, rtol=1e-6
    )


def test_the_heat_that_goes_in_in_the_end_goes_out_through_the_case():
    """No change of the iron loss with temperature, none of the copper's: T_c = T_a + (P
    + P_fe) R_ca.

    After 20 times the slow time constant, which is 1.2 times that of the case alone.
    """
    found = course(
        dataclasses.replace(EVEN, iron_loss=5.0),
        POWERS,
        25.0 * MOTOR.case_capacity * MOTOR.case_to_air,
        step=10.0,
    )
    case = MOTOR.air + (POWERS + 5.0) * MOTOR.case_to_air
    np.testing.assert_allclose(found.case, case, rtol=1e-6)
    np.testing.assert_allclose(found.winding, case + POWERS * EVEN.to_case, rtol=1e-6)


@pytest.mark.parametrize("excess", [0.8, 1.2])
def test_too_much_heat_has_no_steady_state(excess):
    """With a P_0 (R_wc + R_ca) >= 1 the winding's own growth feeds more heat than a
    rise drives out."""
    # quick to settle
    n = dataclasses.replace(
        COOLED, magnet_loss=0.0, winding_capacity=20.0, case_capacity=20.0
    )
    resistance = n.to_case + n.case_to_air
    power = np.array([excess / n.copper_growth / resistance])
    earlier, later = (
        course(n, power, seconds, step=2.0) for seconds in (1000.0, 4000.0)
    )
    if excess < 1.0:
        rise = power * resistance / (1.0 - excess)
        # e^-20: its slow time constant is 200 s
        np.testing.assert_allclose(later.winding - n.air, rise, rtol=1e-6)
    else:
        assert (
            warming(n, later, power).winding > warming(n, earlier, power).winding > 1.0
        )


def test_heat_is_stored_or_leaves_and_nothing_else():
    now, put_in, out, step = cold(), np.zeros(4), np.zeros(4), 0.1
    n = dataclasses.replace(COOLED, iron_loss=7.0)
    for _ in range(200):
        middle = advance(n, now, POWERS, 0.5 * step)
        now = advance(n, now, POWERS, step)
        put_in += step * (POWERS * heat_ratio(n, middle) + 7.0)
        out += step * (middle.case - n.air) / n.case_to_air
    # The midpoint rule's error is that of 1/24 (step / time constant)^2.
    stored = n.winding_capacity * (now.winding - n.air) + n.case_capacity * (
        now.case - n.air
    )
    np.testing.assert_allclose(stored + out, put_in, rtol=1e-7)


# --- The envelope ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "hardware",
    [IDEAL, BUILT, dataclasses.replace(BUILT, braking_speed=30.0, gear_ratio=9.1)],
)
def test_a_motor_at_the_envelopes_temperature_is_the_same_to_the_last_bit(hardware):
    motors = Actuator.from_hardware(hardware)
    same = heated(motors, COOLED, Temperatures.uniform(ENVELOPE_TEMPERATURE, (12,)))
    rng = np.random.default_rng(0)
    before, q, qd, target = (
        rng.normal(size=(4, 500, 12)) * np.array([80.0, 0.5, 12.0, 0.7])[:, None, None]
    )
    asked = before, q, qd, target, 0.0 * qd, 1e-3
    np.testing.assert_array_equal(
        joint_torque(same, *asked), joint_torque(motors, *asked)
    )
    np.testing.assert_array_equal(
        np.array(torque_limits(same, qd, 0.9)), np.array(torque_limits(motors, qd, 0.9))
    )
    np.testing.assert_array_equal(
        winding_heat(same, before), winding_heat(motors, before)
    )


@pytest.mark.parametrize(
    ("speed", "cold_torque", "hot_torque"),
    [(14.7, 120.0, 81.0), (18.0, 61.0, 50.0), (20.0, 25.0, 32.0)],
)
def test_a_hot_motor_is_weaker_at_the_corner_and_stronger_near_its_no_load_speed(
    speed, cold_torque, hot_torque
):
    """The winding at +155 K, the magnets at +77 K; numbers worked out by hand to a
    newton metre."""
    motors = Actuator.from_hardware()
    hot = heated(motors, COOLED, Temperatures(np.array([180.0]), np.array([102.0])))
    assert torque_limits(motors, np.array([speed]))[1] == pytest.approx(
        cold_torque, abs=0.6
    )
    assert torque_limits(hot, np.array([speed]))[1] == pytest.approx(
        hot_torque, abs=0.6
    )
    assert np.all(hot.no_load_speed > motors.no_load_speed)


def test_a_hot_envelope_is_the_motors_equation_with_its_resistance_and_flux():
    """tau = kt (V - ke w) / R within the flux's share of the peak, from the constants
    of the cold motor."""
    motors, t = (
        Actuator.from_hardware(),
        Temperatures(np.array([140.0]), np.array([90.0])),
    )
    k = 1.0 - MOTOR.magnet_loss * (90.0 - 25.0)
    resistance = 1.0 + MOTOR.copper_growth * (140.0 - 25.0)
    cold_stall = motors.peak_torque / (1.0 - motors.corner_speed / motors.no_load_speed)
    qd = np.linspace(-40.0, 40.0, 801)
    line = cold_stall * k / resistance * (1.0 - k * qd / motors.no_load_speed)
    peak = k * motors.peak_torque
    found = torque_limits(heated(motors, COOLED, t), qd)
    np.testing.assert_allclose(
        found[1], np.clip(line, -peak, peak), rtol=1e-12, atol=1e-10
    )


def test_the_hot_motors_heat_is_the_networks():
    motors, t = (
        Actuator.from_hardware(),
        Temperatures(np.array([140.0, 60.0]), np.array([90.0, 30.0])),
    )
    torque = np.array([60.0, -90.0])
    heat = winding_heat(heated(motors, COOLED, t), torque)
    np.testing.assert_allclose(
        heat, winding_heat(motors, torque) * heat_ratio(COOLED, t), rtol=1e-12
    )


def test_a_hot_motor_takes_more_from_the_bus_and_gets_no_more_than_there_is():
    motors = dataclasses.replace(Actuator.from_hardware(), bus=Bus(3000.0, 1000.0, 0.0))
    hot = heated(
        motors,
        COOLED,
        Temperatures(np.linspace(25.0, 180.0, 12), np.linspace(25.0, 60.0, 12)),
    )
    rest = np.zeros(12)
    asked = rest, rest, rest, np.full(12, 0.4), rest, 1e-3
    drawn = [np.sum(winding_heat(m, joint_torque(m, *asked))) for m in (motors, hot)]
    assert drawn == pytest.approx([3000.0, 3000.0])  # at rest all of it is heat
    assert np.sum(joint_torque(hot, *asked)) < np.sum(joint_torque(motors, *asked))


def test_a_motor_that_may_not_even_be_as_warm_as_the_air_is_refused():
    with pytest.raises(
        UserError, match=r"--heat.limit \(20 C\) must be above --heat.air \(25 C\)"
    ):
        MotorHeat(limit=20.0)
    with pytest.raises(
        UserError, match=r"--heat.winding-capacity must be from 10 to 1e\+06, got 0"
    ):
        MotorHeat(winding_capacity=0.0)


# --- The motor that heats as the paper's ----------------------------------------------

HEAT = 147.0  # W, of a rear hip's winding


def test_the_calibrated_motor_heats_by_86_times_1_8_kelvins():
    motor = calibrated(MOTOR, HEAT)
    assert dataclasses.replace(motor, winding_to_case=None) == MOTOR
    assert rise(motor, np.array([HEAT])) == pytest.approx(154.8, rel=1e-7)
    warmed = course(motor, np.array([HEAT]), 86.0)
    # steps of 0.4 s beside those of 2 s: a Runge-Kutta step's error is below 1e-6
    assert warmed.winding == pytest.approx(25.0 + 154.8, rel=1e-6)


def test_a_motor_that_is_given_stays_as_it_is():
    motor = MotorHeat(winding_to_case=0.7)
    assert calibrated(motor, HEAT) is motor


@pytest.mark.parametrize("heat", [60.0, 130.0])
def test_a_gait_too_gentle_for_the_copper_is_given_less_of_it(heat):
    """Of a winding that gives nothing away T - T_0 = (e^(a r0 t) - 1) / a: r0 is 1.408
    K/s."""
    motor = calibrated(MOTOR, heat)
    assert motor.winding_to_case == WAYS[1]
    a = MOTOR.copper_growth
    start = np.log1p(a * RISE) / (a * 86.0)
    assert start == pytest.approx(1.41, abs=0.005)
    # next to nothing is given away
    assert motor.winding_capacity == pytest.approx(heat / start, rel=1e-3)
    assert rise(motor, np.array([heat])) == pytest.approx(RISE, rel=1e-7)


def test_a_gait_without_heat_is_given_the_least_copper():
    assert calibrated(MOTOR, 0.0).winding_capacity == pytest.approx(10.0)
