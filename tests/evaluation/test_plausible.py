"""Robots that BP2 may be: their ranges, and how values become a robot and its ground."""

import math

import numpy as np
import pytest
from synthetic import make_run

from bp2_rl.evaluation.plausible import (
    BestSecond,
    best_second,
    on_the_belt,
    plausible_robot,
    read_assumptions,
    read_posterior,
    road,
)
from bp2_rl.evaluation.races import TRACK
from bp2_rl.learning.policy import load_policy
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import BUILT, REAL
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.measuring import time_at
from bp2_rl.simulation.rollout import RunRequest, rollout
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import window_means
from bp2_rl.simulation.world import World

ASSUMPTIONS = read_assumptions()
CONDITIONS = {
    "corner_power": float(np.multiply(BUILT.corner_speed, BUILT.peak_torque)),
    "weak_braking": 0.0,
    "belt_supply": 1.0,
    "slope": 0.01,
    "roughness": 0.02,
}
ASSUMED = {
    name: CONDITIONS[name] if name in CONDITIONS else BUILT.parameter(name)
    for name in ASSUMPTIONS
}
"""The values of the built robot."""


def test_the_built_robots_values_give_the_built_robot():
    assert plausible_robot(ASSUMED) == BUILT
    assert road(ASSUMED) == World(Terrain("rough", 0.01, cell=0.1, slope=0.01))
    outside = {
        name
        for name, value in ASSUMED.items()
        if not ASSUMPTIONS[name].range[0] <= value <= ASSUMPTIONS[name].range[1]
    }
    # 120 Nm x 14.7 rad/s is a watt less than was measured; the slope is this test's own
    assert outside == {"corner_power", "slope"}


def test_the_real_robot_is_one_that_ships():
    """`REAL` is a row of the file, to three digits."""
    names = ASSUMPTIONS.keys() - CONDITIONS.keys()
    rows = [[one[name] for name in names] for one in read_posterior(2000)]
    off = np.divide(rows, [REAL.parameter(name) for name in names]) - 1.0
    assert np.min(np.max(np.abs(off), axis=1)) < 0.005


def test_built_runs_on_the_real_robot_what_the_papers_bp2_ran():
    ramp = Ramp(15.5, acceleration=bp2.LAUNCH_ACCELERATION, hold=6.0)
    run = rollout(load_policy("built"), ramp, hardware="real")
    assert run.metrics.best_speed == pytest.approx(bp2.OUTDOOR_TOP_SPEED, rel=0.02)
    assert time_at(run, TRACK) == pytest.approx(bp2.SPRINT_100M_TIME, rel=0.02)


def test_a_treadmill_has_no_air_and_may_have_mains():
    windy = ASSUMED | {"headwind": 2.0, "belt_supply": 0.25}
    belt = on_the_belt(windy)
    assert (belt.losses.drag_area, belt.losses.headwind) == (0.0, 0.0)
    assert belt.losses.bus_sag == pytest.approx(0.25 * BUILT.losses.bus_sag)
    assert belt.losses.bus_power_out == pytest.approx(4.0 * BUILT.losses.bus_power_out)
    assert plausible_robot(windy).losses.headwind == 2.0


def test_an_envelope_never_ends_before_its_corner():
    slow = ASSUMED | {"peak_torque": 100.0, "no_load_speed": 18.2, "weak_braking": 0.7}
    robot = plausible_robot(slow | {"corner_power": 1950.0})
    assert robot.corner_speed == pytest.approx(0.95 * 18.2)
    assert robot.braking_speed == pytest.approx(26.0)
    # the least that a range can draw is no speed that hardware may have
    assert plausible_robot(slow | {"weak_braking": 1e-4}).braking_speed == math.inf


@pytest.mark.parametrize("name", ["peak_torque", "spring_damping"])
def test_places_in_a_range_and_values_are_inverse(name):
    one = ASSUMPTIONS[name]
    assert tuple(one.at(np.array([0.0, 1.0]))) == pytest.approx(one.range)
    assert one.share_of(one.at(0.3)) == pytest.approx(0.3)
    middle = math.sqrt(math.prod(one.range)) if one.even_in == "log" else 110.0
    assert one.at(0.5) == pytest.approx(middle)


def test_the_mean_of_every_second_is_a_convolution():
    speed = np.random.default_rng(0).normal(size=2500)
    expected = np.convolve(speed, np.full(1000, 1e-3), "valid")
    np.testing.assert_allclose(window_means(speed, 1000), expected, atol=1e-12)


def test_the_best_second_and_its_peaks_are_those_of_a_known_run():
    # 12 m/s for a second, 10 m/s before and after; power only while it runs 12 m/s
    run = make_run(duration=6.0, speed=10.0, acceleration=5.0)
    fast = slice(3000, 4000)
    run.qvel[fast, 0] = 12.0
    run.qvel[fast, 6 + 8 + 1] = 10.0  # the right hind hip's speed
    run.torque[fast, 7] = 90.0
    run.torque[fast, 8] = -50.0  # brakes: no power out
    request = RunRequest(Ramp(10.0))
    found = best_second(request, run)
    assert found.speed == pytest.approx(12.0)
    assert found.told == pytest.approx(10.0)
    assert found.powers == (pytest.approx(900.0), 0.0)
    short = make_run(duration=0.5)
    assert best_second(request, short) == BestSecond(0.0, 0.0, (0.0, 0.0), None)


def test_robots_that_ship_lie_in_their_ranges_and_come_by_their_weight():
    robots = read_posterior(200)
    assert robots == read_posterior(200)
    for name, one in ASSUMPTIONS.items():
        values = np.array([robot[name] for robot in robots])
        low, high = one.range
        slack = 1e-5 * (high - low)  # six digits are written
        assert np.all((low - slack <= values) & (values <= high + slack)), name
    assert len({tuple(robot.values()) for robot in robots}) >= 100
