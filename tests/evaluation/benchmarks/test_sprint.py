import dataclasses

import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks import run as module
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.run import (
    SprintLaunch,
    measure_first_metres,
    ramp_to_sprint,
    sprint,
    sprint_metrics,
)
from bp2_rl.evaluation.benchmarks.sensitivity import ramp_to_sensitivity
from bp2_rl.evaluation.benchmarks.sprint_figure import sprint_pictures
from bp2_rl.evaluation.races import BOLT_SPLITS
from bp2_rl.robot import bp2
from bp2_rl.robot.model import foot_geom_ids, load_model
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.simulation.measuring import (
    foot_centres,
    foot_edges,
    time_at,
    track_position,
    trunk_edges,
)


@pytest.fixture
def make_race(make_run):
    """Return a maker of runs of constant acceleration to a top speed, which end with
    the first sample beyond 100 m."""

    def make(acceleration=5.0, speed=10.0, duration=20.0, **changes):
        run = make_run(duration=duration)
        time = run.time
        rising = np.minimum(time, speed / acceleration)
        qpos, qvel = run.qpos.copy(), run.qvel.copy()
        qpos[:, 0] = 0.5 * acceleration * rising**2 + speed * (time - rising)
        qvel[:, 0] = acceleration * rising
        whole = make_run(
            **({"duration": duration, "qpos": qpos, "qvel": qvel} | changes)
        )
        past = np.flatnonzero(qpos[:, 0] >= 100.0)
        return whole.between(0.0, time[past[0]] + run.dt) if len(past) else whole

    return make


def crossing(distance, acceleration, speed):
    """Return the time to cover a distance at constant acceleration to a top speed,
    s."""
    reached = 0.5 * speed**2 / acceleration
    return (
        (2 * distance / acceleration) ** 0.5
        if distance < reached
        else speed / acceleration + (distance - reached) / speed
    )


# --- The clock ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("acceleration", "speed"), [(5.0, 10.0), (2.4, 8.2), (6.0, 15.3)]
)
def test_times_and_splits_of_a_constant_acceleration(make_race, acceleration, speed):
    m = sprint_metrics(make_race(acceleration, speed), acceleration)
    times = [crossing(10.0 * k, acceleration, speed) for k in range(1, 11)]
    # A straight line between samples is off by a dt^2 / 8 of the way, 1e-6 m: 1e-7 s at
    # these speeds.
    assert m.time == pytest.approx(times[-1], abs=1e-6)
    assert [split.time for split in m.splits] == pytest.approx(times, abs=1e-6)
    assert [split.distance for split in m.splits] == [10.0 * k for k in range(1, 11)]
    assert [split.speed for split in m.splits] == pytest.approx(
        10.0 / np.diff([0.0, *times]), rel=1e-5
    )
    assert m.sprint_acceleration == acceleration


@pytest.mark.parametrize(
    ("acceleration", "speed", "launch"),
    [
        (2.38, 10.0, ((10.0 / 2.38) ** 0.5, (10.0 * 2.38) ** 0.5, 2.38, 2.38)),
        (5.0, 10.0, ((10.0 / 5.0) ** 0.5, (10.0 * 5.0) ** 0.5, 5.0, 5.0)),
        # off at 5 m/s: 1 s for 5 m, at 5 m/s; but 10 m/s2 would have been needed to
        # take as long from rest
        (1e6, 5.0, (1.0, 5.0, 5.0, 10.0)),
    ],
)
def test_both_accelerations_of_a_launch(make_race, acceleration, speed, launch):
    measured = measure_first_metres(make_race(acceleration, speed))
    assert dataclasses.astuple(measured) == pytest.approx(launch, rel=1e-4)


def test_a_race_not_run_to_its_end_has_no_time(make_race):
    m = sprint_metrics(make_race(speed=10.0, duration=4.5), 5.0)  # 35 m
    assert m.time is None
    assert [split.distance for split in m.splits] == [10.0, 20.0, 30.0]


def test_a_fall_before_five_metres_has_no_launch(make_race):
    m = sprint_metrics(make_race(acceleration=5.0, duration=1.0, fell_at=1.0), 5.0)
    assert (m.launch, m.splits) == (SprintLaunch(), ())


def test_the_clock_runs_along_the_first_heading(make_race):
    straight, turned, turn = make_race(), make_race(), 0.4
    heading = np.array([np.cos(turn), np.sin(turn)])
    turned.qpos[:, :2] = (3.0, -2.0) + straight.qpos[:, :1] * heading
    turned.qpos[:, 3], turned.qpos[:, 6] = np.cos(turn / 2), np.sin(turn / 2)
    assert time_at(turned, 70.0) == pytest.approx(time_at(straight, 70.0), abs=1e-9)
    np.testing.assert_allclose(track_position(turned)[1], 0.0, atol=1e-9)


def test_the_world_record_is_one():
    assert BOLT_SPLITS[-1] == 9.58
    # 0.81 s from 60 to 70 m
    assert 10.0 / min(np.diff(BOLT_SPLITS)) == pytest.approx(12.35, abs=0.01)


# --- The lane -------------------------------------------------------------------------


# m to the side: 0.61 m less half of the trunk's 0.44 m are 0.39 m
@pytest.mark.parametrize(("side", "kept"), [(0.3, True), (0.4, False)])
def test_the_trunks_way_is_measured_from_the_line(make_race, side, kept):
    run = make_race()
    run.qpos[:, 1] = side * np.sin(run.time)
    lane = sprint_metrics(run, 5.0).lane
    assert lane.trunk_offset == pytest.approx(side, abs=1e-6)
    assert lane.trunk_reach == pytest.approx(side + 0.22, abs=1e-6)
    assert lane.kept is kept


@pytest.mark.parametrize("yaw", [0.2, -0.2, 2.0])
def test_a_turned_trunk_is_wider(make_race, yaw):
    run = make_race()
    run.qpos[1:, 3], run.qpos[1:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    edges = trunk_edges(run)
    corners = np.array([[x, y] for x in (-0.4, 0.4) for y in (-0.22, 0.22)])
    across = corners @ np.array([np.sin(yaw), np.cos(yaw)])
    np.testing.assert_allclose(edges[5], (across.min(), across.max()), atol=1e-12)
    np.testing.assert_allclose(edges[0], (-0.22, 0.22), atol=1e-12)


def test_feet_are_where_mujoco_has_them(make_run):
    model = load_model(visual=False)
    data, run = mujoco.MjData(model), make_run(duration=0.01)
    run.qpos[:] += np.random.default_rng(0).normal(scale=0.2, size=run.qpos.shape)
    run.qpos[:, 3:7] /= np.linalg.norm(run.qpos[:, 3:7], axis=1, keepdims=True)
    for state, centres in zip(run.qpos, foot_centres(run), strict=True):
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(
            centres, data.geom_xpos[foot_geom_ids(model)], atol=1e-12
        )


def test_a_foot_beside_the_lane_leaves_it(make_race):
    run = make_race()
    run.qpos[500, 11] = 0.9  # the front left leg to the side
    lane, foot = sprint_metrics(run, 5.0).lane, foot_centres(run)[500, 1, 1]
    assert lane.foot_reach == pytest.approx(foot + bp2.FOOT_RADIUS)
    assert foot_edges(run)[500, 1] == pytest.approx(lane.foot_reach)
    assert lane.trunk_reach == pytest.approx(0.22)
    assert lane.foot_reach > 0.61
    assert not lane.kept


# --- The benchmark --------------------------------------------------------------------


def test_a_sprint_ends_at_the_line(make_policy, make_race, monkeypatch, assert_fits):
    asked = []

    def simulate(policy, requests, *, backend):
        asked.extend(requests)
        return [make_race()]

    monkeypatch.setattr(module, "simulate", simulate)
    policy, setup = (
        make_policy(results={"topspeed": {"commanded_speed": 10.0}}),
        BenchmarkOptions(operator=HeadingHold(limit=0.1)),
    )
    evaluation = sprint(policy, ramp_to_sprint(policy, setup), setup)
    (request,) = asked
    schedule = request.schedule
    assert (schedule.target, schedule.acceleration, schedule.duration) == (
        (10.0, 0.0, 0.0),
        3.0,
        30.0,
    )
    assert (request.finish, request.operator) == (100.0, setup.operator)
    assert evaluation.verdict.startswith("100 m in 11.00 s, inside one lane; ran 100.")
    assert evaluation.good
    assert evaluation.results["time_100m"] == 11.0
    assert evaluation.results["splits"][0] == 2.0
    assert_fits(evaluation)


@pytest.mark.parametrize(
    ("setup", "speed", "acceleration"),
    [
        (BenchmarkOptions(), 12.0, 6.0),
        (BenchmarkOptions(speed=9.0, acceleration=3.0), 9.0, 3.0),
    ],
)
def test_a_sprint_starts_as_its_card_says(make_policy, setup, speed, acceleration):
    measured = {
        "sprint": {"commanded_speed": 12.0, "sprint_acceleration": 6.0},
        "topspeed": {"commanded_speed": 10.0},
    }
    ramp = ramp_to_sprint(make_policy(results=measured), setup)
    assert (ramp.target[0], ramp.acceleration) == (speed, acceleration)


@pytest.mark.parametrize("schedule", [ramp_to_sprint, ramp_to_sensitivity])
def test_a_start_that_takes_longer_than_the_race_is_refused(make_policy, schedule):
    with pytest.raises(UserError, match=r"--acceleration 0\.3 reaches 10 m/s after"):
        schedule(make_policy(), BenchmarkOptions(speed=10.0, acceleration=0.3))


@pytest.mark.parametrize("fell_at", [None, 0.002])
def test_the_figure_can_be_drawn_of_a_race_and_of_the_shortest_fall(
    make_race, assert_drawn, fell_at
):
    run = (
        make_race() if fell_at is None else make_race(duration=fell_at, fell_at=fell_at)
    )
    race, times = sprint_pictures(run, sprint_metrics(run, 5.0).time)
    assert [axes.get_title(loc="left") for axes in race.figure.axes] == [
        "Speed",
        "Lane of 1.22 m",
    ]
    for picture in (race, times):
        assert_drawn(picture.figure)
    ranked = [label.get_text() for label in times.figure.axes[0].get_yticklabels()]
    assert ("this policy, 11 s" in ranked) == (fell_at is None)
    assert ranked[0] == "Bolt, Berlin 2009, 9.58 s"
