"""The endurance benchmark on robots whose heat is known: what is calibrated, predicted
and shown."""

import numpy as np
import pytest

from bp2_rl.paper.benchmarks.endurance import benchmark as module
from bp2_rl.paper.benchmarks.endurance.benchmark import (
    endurance,
    ramp_to_endurance,
)
from bp2_rl.paper.benchmarks.endurance.heating import (
    AveragingWindow,
    EnduranceResult,
    HeatedRun,
    HeatingCourse,
)
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.paper.motor_heat import course
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, winding_heat

HOTTEST = conventions.MOTOR_NAMES.index("RL_hip")


@pytest.fixture
def ran(monkeypatch):
    """Replace the runs by known ones, whose torque goes with speed and does not change
    with heat; return the runs that are asked for."""
    asked = []

    def run(policy, one):
        speed = one.rise.target[0]
        asked.append((speed, one.pace))
        torque = np.array([10.0, 45.0, 40.0] * 4) * speed / 10.74
        torque[HOTTEST] = 51.0 * speed / 10.74
        heat = winding_heat(Actuator.from_hardware(one.robot), torque)
        times, warmed = course(one.motor, heat, one.longest or 1.0)
        hottest = np.array([now.winding[HOTTEST] for now in warmed])
        too_hot = one.longest > 0.0 and hottest[-1] >= one.motor.limit
        time = (
            float(np.interp(one.motor.limit, hottest, times))
            if too_hot
            else one.longest
        )
        n = int(time / one.pace)
        winding = np.linspace(
            25.0,
            np.where(
                np.arange(12) == HOTTEST, one.motor.limit if too_hot else 100.0, 90.0
            ),
            n + 2,
        )
        window = AveragingWindow(
            speed, _each(heat), _each(torque), _each(0.1 * torque), (0.1,) * 12
        )
        cause = "winding" if too_hot else "none"
        endured = _endured(one, window, time, cause, _each(winding[-1]))
        shown = HeatingCourse(
            _each(one.pace * (0.5 + np.arange(n))), tuple(map(_each, winding[1:-1]))
        )
        cloud = np.linspace(-1.0, 1.0, 40)[:, None]
        return HeatedRun(
            endured,
            shown,
            np.linspace(0.0, time, 40),
            20.0 * cloud + 0 * heat,
            cloud * torque,
        )

    monkeypatch.setattr(
        module, "run_hot", lambda policy, tries: [run(policy, one) for one in tries]
    )
    return asked


def _endured(one, window, seconds, cause, winding) -> EnduranceResult:
    return EnduranceResult(
        commanded_speed=one.rise.target[0],
        speed=window.speed,
        pace=one.pace,
        seconds=seconds,
        cause=cause,
        motor="RL_hip",
        hottest="RL_hip",
        hottest_winding=max(winding),
        hottest_case=30.0,
        mean_rate=1.8,
        torque_growth=1.0,
        rate_growth=1.0,
        on_envelope=(0.1, 0.1),
        outside_envelope=0,
        first=window,
        last=window,
        winding=winding,
        case=(30.0,) * 12,
    )


def _each(values):
    return tuple(float(value) for value in values)


def evaluate(policy, setup):
    return endurance(policy, ramp_to_endurance(policy, setup), setup)


def test_the_papers_86_s_are_put_in_and_the_top_speeds_are_predicted(
    make_policy, ran, assert_report
):
    evaluation = evaluate(make_policy(), DeepBenchmarkOptions(speed=15.0))
    metrics = evaluation.metrics
    assert metrics.is_input
    slow, top = metrics.held
    # 180 C are 0.2 K more than 1.8 K/s make of 25 C in 86 s.
    assert slow.result.seconds == pytest.approx(86.1, abs=0.1)
    # Endurance goes with the heat, which goes with the square of torque: a little less,
    # as conduction has less time.
    assert 0.85 < top.result.seconds / 86.1 * (15.0 / 10.74) ** 2 < 1.0
    # for here the torque stays
    assert slow.accelerated.seconds == pytest.approx(slow.result.seconds)
    assert evaluation.good
    assert evaluation.verdict.startswith("10.74 m/s: 86 s, RL_hip too hot; 15 m/s: ")
    assert ran == [(10.74, 1.0)] + [
        (speed, pace) for pace in (1.0, module.PACE) for speed in (10.74, 15.0)
    ]
    assert evaluation.results["at_top"]["accelerated_seconds"] == pytest.approx(
        top.accelerated.seconds, rel=1e-3
    )
    assert_report(evaluation)


def test_the_quick_version_runs_both_speeds_fast_and_nothing_else(
    make_policy, ran, assert_report
):
    evaluation = evaluate(
        make_policy(), DeepBenchmarkOptions(speed=15.0, quick=True, robot="ideal")
    )
    assert ran == [(10.74, 1.0), (10.74, module.PACE), (15.0, module.PACE)]
    assert all(held.full is None for held in evaluation.metrics.held)
    assert evaluation.metrics.held[0].result.seconds == pytest.approx(86.1, abs=0.1)
    assert_report(evaluation)


def test_with_a_motor_given_nothing_is_put_in(make_policy, ran):
    motor = MotorHeat(winding_capacity=300.0, winding_to_case=0.4, air=40.0)
    evaluation = evaluate(
        make_policy(), DeepBenchmarkOptions(speed=15.0, quick=True, heat=motor)
    )
    assert evaluation.metrics.heat == motor
    assert not evaluation.metrics.is_input
    assert evaluation.rows[0].value == "predicted"
    assert "(given)" in evaluation.conditions["motor heat"]


def test_a_motor_that_lasts_is_said_to(make_policy, ran):
    evaluation = evaluate(make_policy(), DeepBenchmarkOptions(speed=12.0, hold=20.0))
    assert [held.result.seconds for held in evaluation.metrics.held] == [20.0, 20.0]
    assert evaluation.verdict == "10.74 m/s: 20 s, not ended; 12 m/s: 20 s, not ended"


def test_a_policy_whose_top_is_the_papers_speed_is_run_at_it_once(make_policy, ran):
    evaluation = evaluate(make_policy(), DeepBenchmarkOptions(speed=10.74))
    assert len(evaluation.metrics.held) == 1


def test_a_robot_that_falls_on_its_way_up_has_endured_nothing(make_policy, monkeypatch):
    """And has no heat to calibrate a motor on: the report comes all the same."""

    def run(policy, one):
        still = AveragingWindow(0.0, *((0.0,) * 12,) * 4)
        endured = _endured(one, still, 0.0, "fall", (25.0,) * 12)
        return HeatedRun(
            endured,
            HeatingCourse((), ()),
            np.zeros(0),
            np.zeros((0, 12)),
            np.zeros((0, 12)),
        )

    monkeypatch.setattr(
        module, "run_hot", lambda policy, tries: [run(policy, one) for one in tries]
    )
    evaluation = evaluate(make_policy(), DeepBenchmarkOptions(speed=15.0))
    assert not evaluation.good
    assert evaluation.verdict == "10.74 m/s: 0 s, fell; 15 m/s: 0 s, fell"
