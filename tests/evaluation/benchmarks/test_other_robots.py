"""Benchmarks of robots other than BP2: at speeds of their own, and without what is
BP2's."""

import math

import pytest

from bp2_rl.evaluation.benchmarks.conditions import (
    cruising_speed,
    top_speed,
)
from bp2_rl.evaluation.benchmarks.fleet import ramp_to_robustness
from bp2_rl.evaluation.benchmarks.losses import ramp_to_losses
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.run import ramp_to_sprint, time_limit
from bp2_rl.evaluation.benchmarks.sensitivity import robots_of
from bp2_rl.evaluation.benchmarks.tries.tasks import (
    ManoeuvreSizes,
    all_manoeuvres,
    sizes_of,
)
from bp2_rl.robot.hardware import (
    BUILT,
    IDEAL,
    PARTS,
    Losses,
    differing,
    ideal_of,
    with_parts,
)
from bp2_rl.robot.named import find_robot
from bp2_rl.robot.operator import HEADING_HOLD
from bp2_rl.settings.env import CommandConfig
from bp2_rl.settings.presets import preset
from bp2_rl.simulation.measuring import froude_number, standing_height
from bp2_rl.simulation.schedule import Ramp

GO1 = find_robot("go1")
FASTEST = preset("relaxed", "cpu", robot="go1").env.commands.max_forward


@pytest.fixture
def go1(make_policy):
    return lambda **results: make_policy(
        env=preset("relaxed", "cpu", robot="go1").env, results=results
    )


@pytest.mark.parametrize(
    ("results", "top"),
    [
        ({"topspeed": {"best_speed": 4.0}, "judged": {"speed": 3.5}}, 4.0),
        ({"judged": {"speed": 3.5}}, 3.5),
        ({}, FASTEST),
        ({"judged": {"speed": 0.0}}, FASTEST),  # it fell
    ],
)
def test_a_top_speed_is_the_measured_one_else_the_judges_else_the_fastest_command(
    go1, results, top
):
    policy, cruise = go1(**results), pytest.approx(0.6 * top, abs=0.005)
    assert (top_speed(policy), cruising_speed(policy)) == (top, cruise)
    assert ramp_to_robustness(policy, BenchmarkOptions()).target[0] == cruise


def test_bp2_keeps_the_papers_speeds_whatever_was_measured(make_policy):
    policy = make_policy(results={"topspeed": {"best_speed": 4.0}})
    assert cruising_speed(policy) == 10.74
    assert sizes_of(BUILT, 4.0, 2.4, CommandConfig()) == ManoeuvreSizes()
    assert time_limit(15.5, BUILT) == time_limit(3.0, BUILT) == 30.0


def test_another_robots_manoeuvres_are_within_its_speed():
    commands = CommandConfig(max_yaw_rate=1.25)
    sizes = sizes_of(GO1, 3.0, 1.8, commands)
    # two digits
    assert sizes.turns == pytest.approx(
        [0.2 * 3.0, 0.4 * 3.0, 0.65 * 3.0, 0.85 * 3.0], abs=0.051
    )
    assert sizes.slow == (0.5, 1.0, 1.5, 2.0, 3.0)
    # Froude's law: a leg of 0.64 of BP2's length has 0.80 of its speeds.
    assert sizes.pushes == pytest.approx(
        [x * math.sqrt(GO1.anatomy.leg_length / 0.35) for x in (0.5, 1.0, 1.5)],
        rel=0.02,
    )
    tries = all_manoeuvres(Ramp(3.0), 3.0, GO1, HEADING_HOLD, 0, sizes)
    for one in tries:
        told = [
            one.schedule.command(x / 10)
            for x in range(round(10 * one.schedule.duration))
        ]
        assert max(command[0] for command in told) <= 3.0 + 1e-9
        assert max(abs(command[2]) for command in told) <= 1.5 * 1.25 + 1e-9
    assert {one.group for one in tries} >= {
        "Brake from 1.8 m/s",
        "Brake from the top",
        "Push of 0.4 m/s",
    }


def test_a_slow_robot_has_the_time_to_arrive(go1):
    policy = go1(topspeed={"best_speed": 2.0, "commanded_speed": 2.0})
    # s: half as long again as 100 m at 2 m/s
    assert ramp_to_sprint(policy, BenchmarkOptions()).duration == pytest.approx(75.0)


def test_another_robot_without_its_losses_stands_on_its_own_ground(go1):
    ideal = ideal_of(GO1)
    assert (ideal.losses, ideal.solid_legs, ideal.envelope) == (
        Losses(),
        False,
        "start",
    )
    assert (ideal.friction, ideal.contact_time, ideal.body) == (
        GO1.friction,
        GO1.contact_time,
        GO1.body,
    )
    assert with_parts(GO1, ideal, PARTS) == ideal
    assert with_parts(ideal, GO1, PARTS) == GO1
    assert set(differing(ideal, GO1)) == {
        "gears",
        "joint friction",
        "torque lag",
        "latency",
        "envelope throughout",
        "solid legs, tracks",
    }
    assert ideal_of(BUILT) is IDEAL
    assert ramp_to_losses(go1(), BenchmarkOptions(speed=2.0)).target[0] == 2.0


def test_the_robots_beside_another_robot_have_what_it_has():
    robots = robots_of(GO1)
    assert not [
        name
        for name in robots
        if "spring" in name or "track" in name or "100 Nm" in name
    ]
    assert robots["peak torque -20 %"].peak_torque == pytest.approx(
        (18.96, 18.96, 28.44)
    )
    assert robots["rotor inertia x 2"].rotor_inertia == pytest.approx(
        (0.01,) * 3 if isinstance(GO1.rotor_inertia, tuple) else 0.01
    )
    assert {robot.body for robot in robots.values()} == {GO1.body}


def test_the_froude_number_is_of_the_robots_own_stand():
    # m, thigh and shank each 0.9 rad off the vertical
    leg = 0.213 * math.cos(0.9) + 0.213 * math.cos(0.9) + 0.023
    assert standing_height(GO1) == pytest.approx(leg, abs=1e-6)
    assert froude_number(3.0, leg) == pytest.approx(9.0 / 9.81 / leg)
    assert standing_height(BUILT) == 0.55
