"""Runs whose motors warm up, against closed forms and, where heat has no effect,
against the same run without heating."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from runs import kick, no_action, run_one

from bp2_rl.env.controller import motors_of
from bp2_rl.paper.benchmarks.endurance.heating import (
    UPDATE,
    WINDOW,
    Heating,
    HeatingTry,
    measure_heat,
)
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot.actuator import Actuator, winding_heat
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.operator import HEADING_HOLD
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import RobotSetup, Simulator

MOTOR = MotorHeat()
# heat stays in the winding
SHUT = MotorHeat(winding_capacity=10.0, winding_to_case=1e6)
# Nm; the last leg's hip is the hottest motor
TORQUE = np.array([10.0, 70.0, 40.0] * 4) + np.arange(12)
HOTTEST = 10
START = 8.5  # s
COLD = Actuator.from_hardware()


def seconds_to_limit(limit: float) -> float:
    """Return the time in which an adiabatic winding reaches a limit, s: ln(1 + a dT) /
    (a r0)."""
    a, rate = (
        MOTOR.copper_growth,
        winding_heat(COLD, TORQUE[HOTTEST]) / SHUT.winding_capacity,
    )
    return math.log1p(a * (limit - MOTOR.air)) / (a * rate)


@pytest.fixture
def watched(make_run):
    """Return a maker of synthetic trots under a constant torque, watched by `Heating`;
    the speed may drop at a time."""

    def watch(pace=1.0, limit=180.0, slower_from=math.inf, seconds=14.0):
        run = make_run(
            duration=seconds, torque=np.tile(TORQUE, (round(1e3 * seconds), 1))
        )
        slow = run.time >= slower_from
        run.qpos[slow, 0] -= 0.06 * 5.0 * (run.time[slow] - slower_from)
        motor = dataclasses.replace(SHUT, limit=limit)
        heating = Heating(motor, COLD, start=START, pace=pace)
        simulator = Simulator([RobotSetup(EnvConfig())])
        for k in range(len(run)):
            simulator.qpos[0] = run.qpos[k]
            if heating(simulator, 0, TORQUE):
                return measure_heat(run.between(0.0, run.time[k + 1]), heating)
        return measure_heat(run, heating)

    return watch


@pytest.mark.parametrize("pace", [1.0, 4.0])
def test_a_run_ends_when_a_winding_is_at_its_limit_whatever_the_pace(watched, pace):
    hot = watched(pace=pace)
    run = hot.endured
    assert run.cause == "winding"
    # Between two updates the time is that of a straight line: off by a r (pace x 50
    # ms)^2 / 8, 1e-3 s at a pace of 4.
    assert run.seconds == pytest.approx(seconds_to_limit(180.0), rel=3e-4)
    assert int(np.argmax(run.winding)) == HOTTEST
    # K: at 60 K/s
    assert run.winding[HOTTEST] == pytest.approx(180.0, abs=60.0 * pace * UPDATE * 1e-3)
    assert set(run.case) == {25.0}
    assert run.first.heat == pytest.approx(tuple(winding_heat(COLD, TORQUE)), abs=1e-4)
    # over one sample less than the window
    assert run.first.speed == pytest.approx(5.0, rel=2e-3)
    assert (
        len(hot.course.time)
        == len(hot.course.winding)
        == math.floor(run.seconds / pace + 1e-6)
    )
    np.testing.assert_allclose(np.diff(hot.course.time), pace)
    assert np.all(np.diff([row[HOTTEST] for row in hot.course.winding]) > 0.0)
    assert hot.time[0] >= 0.0
    assert hot.time[-1] <= run.seconds + pace * UPDATE * 1e-3


def test_a_run_that_gets_slower_than_it_was_cold_has_no_torque_margin_left(watched):
    run = watched(slower_from=10.0, limit=1000.0).endured
    assert run.cause == "torque margin"
    # By 6 %: the mean of a second is 5 % slow after 5/6 of a second, 1.5 s after the
    # clock started.
    assert run.seconds == pytest.approx(1.5 + 5.0 / 6.0, abs=2 * UPDATE * 1e-3)


def test_a_run_that_nothing_ends_was_long_enough(watched):
    run = watched(limit=1000.0, seconds=11.0).endured
    assert run.cause == "none"
    assert run.seconds == pytest.approx(2.5)


def test_a_robot_that_falls_before_the_clock_starts_has_endured_nothing(make_run):
    heating = Heating(SHUT, COLD, start=START)
    hot = measure_heat(make_run(duration=3.0, fell_at=3.0), heating)
    assert (hot.endured.cause, hot.endured.seconds) == ("fall", 0.0)
    assert set(hot.endured.winding) == {25.0}
    assert len(hot.time) == len(hot.course.time) == 0


# --- In C MuJoCo ----------------------------------------------------------------------


@pytest.mark.parametrize("hardware", [IDEAL, BUILT])
def test_heat_of_which_nothing_comes_leaves_the_run_as_it_was_to_the_last_bit(hardware):
    """Motors heat, and get an envelope anew, but neither copper nor magnets mind."""
    config, ramp = EnvConfig(hardware=hardware), Ramp((1.0, 0.0, 0.0), hold=0.3)
    indifferent = dataclasses.replace(SHUT, copper_growth=0.0, magnet_loss=0.0)
    heating = Heating(indifferent, motors_of(config), start=0.1, pace=1.0)
    plain, watched = (
        run_one(no_action, ramp, config, watch=watch) for watch in (None, heating)
    )
    assert np.max(heating.history[-1].winding) > 25.1
    for name in ("qpos", "qvel", "torque", "foot_force"):
        np.testing.assert_array_equal(getattr(watched, name), getattr(plain, name))


@pytest.mark.parametrize("hardware", [IDEAL, BUILT])
def test_torque_never_leaves_the_envelope_of_the_moment(hardware, make_policy):
    """As hot as it gets: a winding warms by hundreds of kelvins within a second of
    rough running."""
    policy = SimpleNamespace(card=make_policy(env=EnvConfig(hardware=hardware)).card)
    run = _run(policy, hardware, kick)
    cold = _run(policy, hardware, kick, copper_growth=0.0, magnet_loss=0.0)
    assert max(run.endured.winding) > 150.0
    assert run.endured.outside_envelope == 0
    assert np.max(np.abs(run.torque[len(run.torque) // 2 :])) < np.max(
        np.abs(cold.torque)
    )


def _run(policy, hardware, action, **motor):
    config = policy.card.env
    cold = motors_of(dataclasses.replace(config, hardware=hardware))
    hot = dataclasses.replace(
        SHUT, case_capacity=50.0, winding_to_case=0.2, limit=1000.0, **motor
    )
    heating = Heating(hot, cold, start=0.05, pace=60.0)
    return measure_heat(
        run_one(action, Ramp((0.5, 0.0, 0.0), hold=0.6), config, watch=heating), heating
    )


def test_a_try_starts_its_clock_after_a_cold_lap_in_steady_gait():
    one = HeatingTry(
        IDEAL,
        HEADING_HOLD,
        Ramp((10.74, 0.0, 0.0), 2.4),
        SHUT,
        longest=80.0,
        pace=8.0,
    )
    assert one.start == pytest.approx(10.74 / 2.4 + 2.0 + WINDOW, abs=UPDATE * 1e-3)
    assert one.ramp.duration - one.start == pytest.approx(10.0, abs=UPDATE * 1e-3)
