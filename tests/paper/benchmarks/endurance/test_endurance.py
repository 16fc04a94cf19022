"""The benchmark on robots whose heat is known: what is put in, what is predicted, what
is shown."""

import functools

import numpy as np
import pytest

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.paper.benchmarks.endurance import benchmark as module
from bp2_rl.paper.benchmarks.endurance import calibration
from bp2_rl.paper.benchmarks.endurance.benchmark import (
    draw_robots,
    endurance,
    ramp_to_endurance,
)
from bp2_rl.paper.benchmarks.endurance.calibration import seconds_to
from bp2_rl.paper.benchmarks.endurance.heating import (
    AveragingWindow,
    EnduranceResult,
    HeatedRun,
    HeatingCourse,
)
from bp2_rl.paper.benchmarks.endurance.measured import EnduranceMetrics
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, winding_heat
from bp2_rl.robot.hardware import BUILT
from bp2_rl.settings.env import RandomizationConfig

REMEMBERED = {
    name: functools.cache(getattr(calibration, name))
    for name in ("calibrated", "family")
}
HOTTEST = conventions.MOTOR_NAMES.index("RL_hip")


@pytest.fixture(autouse=True)
def roughly(monkeypatch):
    """A rougher calibration, long steps, few robots: every call of a law is checked,
    and so it is slow."""
    # s: a straight line between them is off by 0.02 s
    monkeypatch.setattr(calibration, "STEP", 5.0)
    monkeypatch.setattr(calibration, "HOUR", 600.0)
    monkeypatch.setattr(module, "SCAN", (9.5, 12.0))
    monkeypatch.setattr(module, "ROBOTS", 2)
    monkeypatch.setattr(calibration, "HALVINGS", 16)
    for name, remembered in REMEMBERED.items():
        monkeypatch.setattr(module, name, remembered)


@pytest.fixture
def ran(monkeypatch):
    """What was tried, of robots whose torque goes with speed and stays as it is while
    they warm."""
    asked = []

    def run(policy, one):
        asked.append(one)
        torque = np.array([10.0, 45.0, 40.0] * 4) * one.speed / 10.74
        torque[HOTTEST] = 51.0 * one.speed / 10.74
        heat = winding_heat(Actuator.from_hardware(one.robot), torque)
        time = min(float(np.min(seconds_to(one.network, heat, one.limit))), one.longest)
        too_hot = 0.0 < time < one.longest
        n = int(time / one.pace)
        winding = np.linspace(
            25.0,
            np.where(np.arange(12) == HOTTEST, one.limit if too_hot else 100.0, 90.0),
            n + 2,
        )
        window = AveragingWindow(
            one.speed, _each(heat), _each(torque), _each(0.1 * torque), (0.1,) * 12
        )
        cause = "winding" if too_hot else "none"
        hot = _each(winding[-1])
        endured = EnduranceResult(
            one.speed, one.pace, time, cause, window, window, hot, (30.0,) * 12, 0
        )
        course = HeatingCourse(
            _each(one.pace * (0.5 + np.arange(n))),
            tuple(map(_each, winding[1:-1])),
            ((30.0,) * 12,) * n,
            ((0.1,) * 12,) * n,
            (one.speed,) * n,
        )
        cloud = np.linspace(-1.0, 1.0, 40)[:, None]
        return HeatedRun(
            endured,
            course,
            np.linspace(0.0, time, 40),
            20.0 * cloud + 0 * heat,
            cloud * torque,
        )

    monkeypatch.setattr(
        module, "run_hot", lambda policy, tries: [run(policy, one) for one in tries]
    )
    return asked


def _each(values):
    return tuple(float(value) for value in values)


def evaluate(policy, setup):
    return endurance(policy, ramp_to_endurance(policy, setup), setup)


def test_the_papers_86_s_are_put_in_and_the_top_speeds_are_predicted(
    make_policy, ran, assert_fits
):
    evaluation = evaluate(make_policy(), DeepSetup(speed=15.0))
    metrics = evaluation.metrics
    assert metrics.is_input
    slow, top = metrics.held
    # 180 C are 0.2 K more than 1.8 K/s make of 25 C in 86 s.
    assert slow.result.seconds == pytest.approx(86.1, abs=0.1)
    # for here the torque stays
    assert slow.by_cold_gait == pytest.approx(slow.result.seconds)
    # Endurance goes with the heat, which goes with the square of torque: a little less,
    # as conduction has less time.
    assert 0.85 < top.result.seconds / 86.1 * (15.0 / 10.74) ** 2 < 1.0
    assert (
        conventions.MOTOR_NAMES[slow.hottest]
        == conventions.MOTOR_NAMES[top.motor]
        == "RL_hip"
    )
    assert slow.disagreement == 0.0
    assert evaluation.good
    assert evaluation.verdict.startswith("10.74 m/s: 86 s, RL_hip too hot; 15 m/s: ")
    assert set(evaluation.tiles) <= {row.label for row in evaluation.rows}
    assert [at.commanded_speed for at in metrics.speeds] == [9.5, 10.74, 12.0, 15.0]
    times = [at.seconds for at in metrics.speeds if at.seconds is not None]
    assert times == sorted(times, reverse=True)
    assert len(metrics.drawn_times) == len({one.friction for one in metrics.drawn}) == 2
    assert {one.pace for one in ran} == {1.0, module.PACE}
    assert from_json(EnduranceMetrics, to_json(metrics)) == metrics
    assert all(
        len(line) == len(table.head)
        for table in evaluation.tables
        for line in table.lines
    )
    assert_fits(evaluation)


def test_drawn_robots_are_within_the_ranges_of_training_and_the_seeds_own():
    ranges, robots = RandomizationConfig(), draw_robots(BUILT, 20, seed=1)
    for robot in robots:
        assert (
            ranges.friction[0] <= robot.friction / BUILT.friction <= ranges.friction[1]
        )
        assert ranges.mass[0] <= robot.mass_scale <= ranges.mass[1]
        assert (
            ranges.strength[0]
            <= robot.parameter("peak_torque") / BUILT.parameter("peak_torque")
            <= ranges.strength[1]
        )
        assert ranges.latency[0] <= robot.losses.latency <= ranges.latency[1]
    assert draw_robots(BUILT, 3, seed=1) == robots[:3]
    assert draw_robots(BUILT, 3, seed=2) != robots[:3]


def test_the_quick_version_runs_both_speeds_fast_and_nothing_else(
    make_policy, ran, assert_fits
):
    evaluation = evaluate(
        make_policy(), DeepSetup(speed=15.0, quick=True, robot="ideal")
    )
    assert [(one.speed, one.pace) for one in ran] == [
        (10.74, 1.0),
        (10.74, module.PACE),
        (15.0, module.PACE),
    ]
    assert all(
        held.full is None and held.limitless is None for held in evaluation.metrics.held
    )
    assert evaluation.metrics.held[0].result.seconds == pytest.approx(86.1, abs=0.1)
    assert_fits(evaluation)


def test_with_a_motor_given_nothing_is_put_in(make_policy, ran):
    motor = MotorHeat(winding_capacity=300.0, winding_to_case=0.4, air=40.0)
    evaluation = evaluate(make_policy(), DeepSetup(speed=15.0, quick=True, heat=motor))
    assert evaluation.metrics.heat == motor
    assert not evaluation.metrics.is_input
    assert "predicted" in evaluation.rows[0].meaning
    assert "input" not in evaluation.tables[0].lines[0]
    assert "(given)" in evaluation.conditions["motor heat"]


def test_a_motor_that_lasts_is_said_to(make_policy, ran):
    evaluation = evaluate(make_policy(), DeepSetup(speed=12.0, hold=20.0))
    assert [held.result.seconds for held in evaluation.metrics.held] == [20.0, 20.0]
    assert evaluation.verdict == "10.74 m/s: 20 s, not ended; 12 m/s: 20 s, not ended"


def test_a_policy_whose_top_is_the_papers_speed_is_run_at_it_once(make_policy, ran):
    evaluation = evaluate(make_policy(), DeepSetup(speed=10.74))
    assert len(evaluation.metrics.held) == 1


def test_a_robot_that_falls_on_its_way_up_has_endured_nothing(make_policy, monkeypatch):
    """And has no heat to calibrate a motor on: the report comes all the same."""

    def run(policy, one):
        window = AveragingWindow(
            0.0, (0.0,) * 12, (0.0,) * 12, (0.0,) * 12, (0.0,) * 12
        )
        endured = EnduranceResult(
            one.speed,
            one.pace,
            0.0,
            "fall",
            window,
            window,
            (25.0,) * 12,
            (25.0,) * 12,
            0,
        )
        return HeatedRun(
            endured,
            HeatingCourse((), (), (), (), ()),
            np.zeros(0),
            np.zeros((0, 12)),
            np.zeros((0, 12)),
        )

    monkeypatch.setattr(
        module, "run_hot", lambda policy, tries: [run(policy, one) for one in tries]
    )
    evaluation = evaluate(make_policy(), DeepSetup(speed=15.0))
    assert not evaluation.good
    assert evaluation.verdict == "10.74 m/s: 0 s, fell; 15 m/s: 0 s, fell"
    assert all(at.fell for at in evaluation.metrics.speeds)
