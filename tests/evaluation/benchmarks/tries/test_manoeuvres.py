import dataclasses
import math

import numpy as np
import pytest
from matplotlib.colors import to_hex
from synthetic import still_policy

from bp2_rl.base.plotting import FALL
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.evaluation.benchmarks.tries import benchmark as module
from bp2_rl.evaluation.benchmarks.tries.benchmark import (
    TryOutcome,
    count_tries,
    hardest,
    level_speed,
    manoeuvres,
    outcome_of,
    simulate_all,
    tries_figure,
)
from bp2_rl.evaluation.benchmarks.tries.rules import (
    Assessment,
)
from bp2_rl.evaluation.benchmarks.tries.tasks import all_manoeuvres
from bp2_rl.evaluation.report import folder
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.operator import HEADING_HOLD, HeadingHold
from bp2_rl.simulation.schedule import Course, Ramp

TOP, LEVEL_SPEED = Ramp(15.0), 14.0


@pytest.fixture(scope="module")
def asked():
    return all_manoeuvres(TOP, LEVEL_SPEED, IDEAL, HEADING_HOLD, seed=3)


def group(asked, name):
    return [manoeuvre for manoeuvre in asked if manoeuvre.group == name]


def outcome(passed=True, fell_at=None, **fields):
    said = {
        "group": "a",
        "asked": "1",
        "rule": "none",
        "did": "x",
        "measured": {"offset": 0.1},
    }
    return TryOutcome(**(said | {"passed": passed, "fell_at": fell_at} | fields))


# --- What is asked --------------------------------------------------------------------


def test_every_manoeuvre_is_asked_once(asked):
    names = [(manoeuvre.group, manoeuvre.asked) for manoeuvre in asked]
    assert len(names) == len(set(names)) == 95


@pytest.mark.parametrize(
    ("name", "speed"), [("Brake from 10.74 m/s", 10.74), ("Brake from the top", 15.0)]
)
def test_a_brake_falls_from_the_speed_at_the_deceleration(asked, name, speed):
    decelerations = (2.0, 4.0, 6.0, 8.0)
    for brake, deceleration in zip(group(asked, name), decelerations, strict=True):
        since, schedule = brake.assess.keywords["since"], brake.schedule
        told = [schedule.command(since + t)[0] for t in (0.0, 1.0)]
        assert told == pytest.approx([speed, speed - deceleration])
        assert schedule.steady_from == pytest.approx(since + speed / deceleration)
        assert schedule.duration == pytest.approx(schedule.steady_from + 2.0)


@pytest.mark.parametrize("speed", [3, 6, 10, 13])
def test_a_turn_is_asked_by_its_lateral_acceleration(asked, speed):
    turns = group(asked, f"Turn at {speed} m/s")
    last = [turn.schedule.command(turn.schedule.duration) for turn in turns]
    np.testing.assert_allclose(
        [speed * command[2] for command in last], (1.0, 2.0, 3.0, 4.0)
    )
    assert [turn.assess.keywords["since"] for turn in turns] == pytest.approx(
        [turn.schedule.steady_from + 1.0 for turn in turns]
    )


@pytest.mark.parametrize("size", [0.5, 1.0, 1.5])
def test_pushes_come_from_eight_directions_at_speed(asked, size):
    pushes = [one.world.pushes[0] for one in group(asked, f"Push of {size:g} m/s")]
    angles = 0.25 * np.pi * np.arange(8)
    np.testing.assert_allclose(
        [(push.forward, push.left) for push in pushes],
        size * np.stack((np.cos(angles), np.sin(angles)), axis=-1),
        atol=1e-12,
    )


@pytest.mark.parametrize(("fell_at", "speed"), [(None, 9.0), (7.5, 15.0)])
def test_what_is_reached_on_level_ground_is_what_others_are_compared_with(
    asked, make_policy, make_run, monkeypatch, fell_at, speed
):
    launch, slope = group(asked, "Launch, friction 0.8")[0], group(asked, "Slope")[0]
    compared = launch.assess.keywords["speed"], slope.assess.keywords["level"]
    assert compared == (LEVEL_SPEED, LEVEL_SPEED)
    assert {one.schedule.target[0] for one in (launch, slope)} == {15.0}
    run = make_run(speed=9.0, acceleration=5.0, fell_at=fell_at)
    monkeypatch.setattr(module, "simulate", lambda *_: iter([run]))
    level = level_speed(make_policy(), TOP, IDEAL, HEADING_HOLD)
    assert level == pytest.approx(speed)


def test_robot_ground_and_operator_change_where_it_is_said_and_nowhere_else():
    operator = HeadingHold(heading_gain=3.0)
    asked = all_manoeuvres(TOP, LEVEL_SPEED, BUILT, operator, seed=3)
    changed = {m.group: m for m in asked if m.hardware != BUILT}
    assert {name.split(",")[0] for name in changed} == {"Launch", "Latency"}
    slippery = [m.hardware or BUILT for m in group(asked, "Launch, friction 0.6")]
    assert [robot.friction for robot in slippery] == [0.6] * 5
    late = [(m.hardware or BUILT).losses for m in group(asked, "Latency")]
    assert [losses.latency for losses in late] == [0.005, 0.010, 0.015]
    assert all(
        dataclasses.replace(losses, latency=0.005) == BUILT.losses for losses in late
    )
    assert {m.group for m in asked if m.operator != operator} == {"Straight for 100 m"}
    straight = group(asked, "Straight for 100 m")
    assert [m.operator.lane_gain for m in straight] == [
        0.4,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.4,
    ]
    assert [m.operator.limit for m in straight] == [0.5] * 6 + [0.0]
    biases = [0.0, 0.0, 0.05, -0.05, 0.5, -0.5, 0.0]
    np.testing.assert_allclose([math.degrees(m.gyro_bias) for m in straight], biases)
    rough = [m.world.terrain for m in group(asked, "Rough ground")]
    assert [2.0 * terrain.size for terrain in rough] == [0.01, 0.02, 0.03]
    assert {terrain.seed for terrain in rough} == {3}
    np.testing.assert_allclose(
        [math.degrees(m.world.terrain.slope) for m in group(asked, "Slope")],
        (2.0, 4.0, -2.0, -4.0),
    )


# --- How they are run -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("fell_at", "passed", "did"), [(None, True, "well"), (3.5, False, "fell")]
)
def test_a_robot_that_falls_fails_whatever_else_it_did(
    asked, make_run, fell_at, passed, did
):
    manoeuvre = dataclasses.replace(
        asked[0], assess=lambda run: Assessment(True, "well", {"offset": 0.0})
    )
    came = outcome_of(manoeuvre, make_run(fell_at=fell_at))
    assert (came.passed, came.did, came.fell_at) == (passed, did, fell_at)


def told_and_lasted(one, run):
    return one.asked, len(run)


def test_workers_give_the_outcomes_in_order(make_card):
    """Short stands of a robot whose policy is all zeros: it holds its pose."""
    policy = still_policy(make_card())
    [still, _] = group(
        all_manoeuvres(TOP, LEVEL_SPEED, IDEAL, HEADING_HOLD, 0), "Stand for 10 s"
    )
    stands = [
        dataclasses.replace(still, schedule=Course().hold(0.01 * n), asked=f"{n}")
        for n in (3, 5, 2, 4)
    ]
    assert simulate_all(told_and_lasted, policy, stands) == [
        ("3", 30),
        ("5", 50),
        ("2", 20),
        ("4", 40),
    ]
    [done] = simulate_all(outcome_of, policy, stands[:1])
    assert (done.asked, done.passed, done.fell_at) == ("3", True, None)
    assert simulate_all(told_and_lasted, policy, []) == []


# --- What is shown --------------------------------------------------------------------


def test_the_whole_benchmark_from_runs_that_are_known(
    make_policy, make_run, monkeypatch, simulated, assert_fits, tmp_path
):
    fast = make_run(duration=12.0, speed=10.0, acceleration=5.0)
    simulated(module, lambda one: fast)
    monkeypatch.setattr(module, "simulate", lambda *_: iter([fast]))
    policy, setup = make_policy(), BenchmarkOptions(speed=10.0, seed=5)
    evaluation = manoeuvres(policy, ramp_to_topspeed(policy, setup), setup)
    assert not evaluation.good
    assert evaluation.results["of"] == 95
    assert evaluation.results["passes"]["Latency"] == "3 of 3"
    assert evaluation.results["passes"]["Turn at 3 m/s"] == "0 of 4"
    assert evaluation.results["did"]["Push of 1 m/s"]["↑"] == "0.0 m"
    assert evaluation.conditions["rough ground's seed"] == "5"
    assert len(evaluation.tables[0].lines) == 95
    assert_fits(evaluation)
    assert folder.write_report(evaluation, tmp_path, video=False) is None
    assert folder.read_report(tmp_path).results["manoeuvres"]["of"] == 95


def test_the_hardest_is_the_last_before_the_first_that_fails():
    asked = (("2", True), ("4", True), ("6", False), ("8", True))
    tries = [outcome(passed, asked=how) for how, passed in asked]
    assert (hardest(tries), hardest(tries[2:])) == ("4", "-")


def test_falls_and_passes_are_counted():
    metrics = count_tries([outcome(), outcome(False), outcome(False, fell_at=2.0)])
    assert (metrics.passed, metrics.fell) == (1, 1)
    assert metrics.passes == {"a": "1 of 3"}


def test_the_figure_is_red_where_a_manoeuvre_failed(assert_drawn):
    tries = [
        outcome(),
        outcome(False, did="no stop"),
        outcome(False, 2.0, group="b", did="fell"),
    ]
    figure = tries_figure(count_tries(tries))
    (axes,) = figure.axes
    red = [
        patch for patch in axes.patches if to_hex(patch.get_facecolor()).upper() == FALL
    ]
    assert len(red) == 2
    assert {"no stop", "fell", "1 of 3 passed; red: failed"} <= {
        text.get_text() for text in axes.texts
    }
    assert_drawn(figure)
