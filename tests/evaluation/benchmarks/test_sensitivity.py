import dataclasses
import math
import operator

import pytest

from bp2_rl.evaluation.benchmarks import sensitivity as module
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.sensitivity import (
    AS_ASSUMED,
    RobotMetrics,
    compare_robots,
    ramp_to_sensitivity,
    robot_metrics,
    robots_of,
    sensitivity,
    sensitivity_picture,
)
from bp2_rl.evaluation.benchmarks.variants import VariantRun
from bp2_rl.evaluation.report import folder
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec

ROBOT = RobotMetrics(
    AS_ASSUMED,
    told=16.0,
    best_speed=15.0,
    mean_speed=14.9,
    fell_at=None,
    stop_hits=0,
    leg_contact_time=0.0,
    leg_depth=0.0,
    time_100m=9.5,
    fell_in_sprint_at=None,
    lane_kept=True,
)
SLOW = dataclasses.replace(
    ROBOT,
    name="slow",
    best_speed=14.0,
    mean_speed=13.9,
    time_100m=20.0,
    lane_kept=False,
)
FELL = dataclasses.replace(
    ROBOT, name="fell", best_speed=16.0, mean_speed=None, fell_at=8.0
)
FELL_RACING = dataclasses.replace(
    ROBOT, name="fell racing", best_speed=17.0, time_100m=None, fell_in_sprint_at=2.0
)


def test_each_other_robot_differs_in_one_property():
    robots = robots_of(IDEAL)
    assert robots.pop(AS_ASSUMED) == IDEAL
    for name, robot in robots.items():
        changed = [
            f.name
            for f in dataclasses.fields(HardwareSpec)
            if getattr(robot, f.name) != getattr(IDEAL, f.name)
        ]
        assert len(changed) == (2 if "spring stops" in name else 1), name
    # as assumed, it is no other robot
    for name, assumed in (
        ("joint stops 20 ms", IDEAL),
        ("no air", IDEAL),  # it runs in none
        ("friction 0.8", BUILT),
    ):
        assert name not in robots_of(assumed)


@pytest.mark.parametrize(
    ("name", "parameter", "value"),
    [
        ("spring stops x 10", "spring_stop_stiffness", 300e3),
        ("spring stops x 10", "rebound_stiffness", 1.5e6),
        ("spring travel -10 mm", "spring_travel", 0.12),
        ("mass +10 %", "mass_scale", 1.1),
        ("spring damping 50 N s/m", "spring_damping", 50.0),
        ("no-load speed -10 %", "no_load_speed", 0.9 * 21.4),
        ("bus sag 5 %/kW", "losses.bus_sag", 0.05),
        ("bus 6 kW", "losses.bus_power_out", 6e3),
        ("charging 1 kW", "losses.bus_power_in", 1e3),
        ("drag area 0.4 m\u00b2", "losses.drag_area", 0.4),
        ("no air", "losses.drag_area", 0.0),
    ],
)
def test_what_was_found_decisive_is_among_the_robots(name, parameter, value):
    robot = robots_of(BUILT)[name]
    assert operator.attrgetter(parameter)(robot) == pytest.approx(value)


def test_a_robot_is_shown_at_the_command_under_which_it_ran_fastest(make_run):
    """Told 6 m/s it falls, told 5 it runs 4.5, told 4 it runs 4."""

    def ran(speed, **changes):
        run = make_run(speed=speed, acceleration=10.0, **changes)
        return VariantRun(run.metrics, None, lane_kept=True)

    fell, told = ran(5.9, duration=4.0, fell_at=4.0), (6.0, 5.0, 4.0)
    found = robot_metrics("weak", told, [fell, ran(4.5), ran(4.0)], fell)
    assert (found.told, found.best_speed) == (5.0, pytest.approx(4.5))
    assert (found.fell_at, found.fell_in_sprint_at, found.lane_kept) == (
        None,
        4.0,
        False,
    )
    lost = robot_metrics("lost", told, [fell, fell, fell], fell)
    assert (lost.told, lost.mean_speed, lost.fell_at) == (6.0, None, 4.0)


def test_ranges_are_those_of_the_robots_that_fell_in_neither_run():
    m = compare_robots([ROBOT, SLOW, FELL, FELL_RACING], 16.0)
    assert (m.upright, m.best_speeds, m.times_100m) == (2, (14.0, 15.0), (9.5, 20.0))
    late = dataclasses.replace(ROBOT, time_100m=None)
    m = compare_robots([late, FELL], 16.0)
    assert (m.upright, m.best_speeds, m.times_100m) == (1, (15.0, 15.0), None)
    m = compare_robots([FELL], 16.0)
    assert (m.upright, m.best_speeds, m.times_100m) == (0, None, None)


def test_every_robot_is_held_at_top_speed_and_raced_under_the_policys_own_controller(
    make_policy, make_run, simulated, assert_fits
):
    asked = []
    sprinted = make_run(duration=25.0, speed=10.0, acceleration=5.0)
    held = sprinted.between(0.0, 7.0)

    def run(one):
        asked.append((one.name, one.hardware, one.finish, one.schedule))
        return sprinted if one.finish == 100.0 else held

    simulated(module, run)
    policy, setup = (
        make_policy(results={"sprint": {"sprint_acceleration": 3.5}}),
        BenchmarkOptions(speed=10.0, robot="ideal"),
    )
    evaluation = sensitivity(policy, ramp_to_sensitivity(policy, setup), setup)
    robots = robots_of(policy.card.env.hardware)
    for finish, acceleration, told in (
        (math.inf, 2.4, [10.0, 9.0, 8.0]),
        (100.0, 3.5, [10.0]),
    ):
        runs = [run for run in asked if run[2] == finish]
        assert {name: hardware for name, hardware, *_ in runs} == robots
        assert all(run[3].acceleration == acceleration for run in runs)
        speeds = [run[3].target[0] for run in runs]
        assert speeds == pytest.approx(told * len(robots))
    assert {run[3].hold for run in asked if run[2] == math.inf} == {5.0}
    assert evaluation.good
    assert evaluation.results["lanes_kept"] == len(robots)
    assert folder.card_results(evaluation)["sprint"].startswith(
        "from a stand; the command rises at 3.5 m/s²"
    )
    assert evaluation.results["best_speeds"]["mass +10 %"] == pytest.approx(10.0)
    assert evaluation.results["times_100m"]["friction 0.6"] == pytest.approx(11.0)
    assert_fits(evaluation)


@pytest.mark.parametrize(
    "robots", [[ROBOT, SLOW, FELL, FELL_RACING], [FELL, FELL_RACING]]
)
def test_the_figure_can_be_drawn_whoever_falls(robots, assert_drawn):
    figure = sensitivity_picture(robots).figure
    assert_drawn(figure)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == [
        robot.name for robot in robots
    ]
    crosses = [
        sum(line.get_marker() == "X" for line in axes.lines) for axes in figure.axes
    ]
    assert crosses == [
        sum(r.fell_at is not None for r in robots),
        sum(r.time_100m is None for r in robots),
    ]
