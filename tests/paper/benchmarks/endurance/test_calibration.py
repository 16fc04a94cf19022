"""The motor that heats as the paper's: what one number fixes, and what it leaves
open."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.paper.benchmarks.endurance.calibration import (
    RISE,
    WAYS,
    calibrated,
    course,
    family,
    most_copper,
    rise,
    seconds_to,
    straightest,
)
from bp2_rl.paper.motor_heat import Network
from bp2_rl.paper.thermal_specs import MotorHeat

MOTOR, HEAT, TOP_HEAT = MotorHeat(), 147.0, 273.0  # W


def network(motor: MotorHeat) -> Network:
    assert motor.winding_to_case is not None
    return Network.from_spec(motor, motor.winding_to_case)


def test_the_calibrated_motor_heats_by_86_times_1_8_kelvins():
    motor = calibrated(MOTOR, HEAT)
    assert dataclasses.replace(motor, winding_to_case=None) == MOTOR
    assert rise(network(motor), np.array([HEAT])) == pytest.approx(154.8, rel=1e-9)
    # A straight line between steps of two seconds: off by some a r (2 s)^2 / 8, 4 ms.
    assert seconds_to(network(motor), np.array([HEAT]), 179.8) == pytest.approx(
        86.0, rel=1e-4
    )


def test_a_motor_that_is_given_stays_as_it_is():
    motor = MotorHeat(winding_to_case=0.7)
    assert calibrated(motor, HEAT) is motor


@pytest.mark.parametrize("heat", [0.0, 60.0, 130.0])
def test_a_gait_too_gentle_for_the_copper_is_given_less_of_it(heat):
    motor = calibrated(MOTOR, heat)
    assert motor.winding_to_case == WAYS[1]
    assert motor.winding_capacity < MOTOR.winding_capacity
    if heat:
        # next to nothing is given away
        assert rise(network(motor), np.array([heat])) == pytest.approx(RISE, rel=1e-3)


def test_the_most_copper_is_that_of_a_winding_that_gives_nothing_away():
    """T - T_0 = (e^(a r0 t) - 1) / a: r0 is 1.408 K/s, 2.26 K/s at the end."""
    a = MOTOR.copper_growth
    start = np.log1p(a * RISE) / (a * 86.0)
    assert start == pytest.approx(1.41, abs=0.005)
    assert start * (1.0 + a * RISE) == pytest.approx(2.26, abs=0.005)
    assert most_copper(MOTOR, HEAT) == pytest.approx(HEAT / start, rel=1e-3)


def test_all_of_the_family_heat_alike_in_the_mean_and_one_of_them_the_straightest():
    members = family(MOTOR, HEAT, TOP_HEAT)
    for member in members:
        n = Network.from_spec(MOTOR, member.winding_to_case).replace(
            winding_capacity=member.winding_capacity
        )
        assert rise(n, np.array([HEAT])) == pytest.approx(RISE, rel=1e-3)
        assert member.at_top == pytest.approx(
            float(seconds_to(n, np.array([TOP_HEAT]), MOTOR.limit)[0]), rel=1e-9
        )
        time, t = course(n, np.array([HEAT]), 86.0)
        slope, level = np.polyfit(time, t.winding[:, 0], 1)
        assert member.bend == pytest.approx(
            np.std(t.winding[:, 0] - slope * time - level), abs=1e-6
        )
    ways = [member.winding_to_case for member in members]
    assert ways == sorted(ways)  # the more copper, the less is given away
    best = straightest(members)
    assert 0 < members.index(best) < len(members) - 1
    assert (best.first_rate, best.last_rate) == pytest.approx((1.8, 1.8), abs=0.1)
    assert best.bend < 0.1 * members[-1].bend


def test_a_gait_that_heats_little_lasts_for_ever():
    n = Network.from_spec(MOTOR, 1.0)
    found = seconds_to(n, np.array([0.0, 20.0, 150.0, 300.0]), 180.0)
    assert list(np.isfinite(found)) == [False, False, True, True]
    assert found[3] < 0.5 * found[2]
