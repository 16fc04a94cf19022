"""Every rule passes a run that keeps it and fails one that does not: runs whose figures
are known in closed form."""

import math

import numpy as np
import pytest

from bp2_rl.evaluation.benchmarks.tries.rules import (
    assess_braking,
    assess_launch,
    assess_motion,
    assess_push,
    assess_run,
    assess_stand,
    assess_straightness,
    assess_turn,
)


@pytest.fixture
def moving(make_run):
    """A run of these forward and leftward speeds (m/s, in its heading's frame) and this
    yaw rate (rad/s) over time."""

    def make(duration, forward, left=0.0, yaw_rate=0.0, **changes):
        run = make_run(duration=duration)
        forward, left, yaw_rate = (
            np.broadcast_to(np.asarray(x, float), run.time.shape)
            for x in (forward, left, yaw_rate)
        )
        yaw = np.cumsum(yaw_rate) * run.dt
        qpos, qvel = run.qpos.copy(), np.zeros_like(run.qvel)
        qvel[:, 0] = np.cos(yaw) * forward - np.sin(yaw) * left
        qvel[:, 1] = np.sin(yaw) * forward + np.cos(yaw) * left
        qpos[:, :2] = np.cumsum(qvel[:, :2], axis=0) * run.dt
        qpos[:, 3], qpos[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
        return make_run(duration=duration, qpos=qpos, qvel=qvel, **changes)

    return make


def braked(moving, deceleration, floor=0.0, seconds=12.0):
    """10 m/s for a second, then less."""
    time = np.arange(round(1000 * seconds)) * 1e-3
    return moving(
        seconds, np.maximum(10.0 - deceleration * np.maximum(time - 1.0, 0.0), floor)
    )


# --- Braking and launches -------------------------------------------------------------


def test_a_stop_as_commanded_passes_with_its_distance(moving):
    """v^2 / 2a = 25 m, less what is left at 0.3 m/s; a mean of 0.25 s may move that by
    3 cm."""
    assessed = assess_braking(braked(moving, 2.0), since=1.0, deceleration=2.0)
    assert (assessed.passed, assessed.said) == (True, "25 m")
    assert assessed.measured["distance"] == pytest.approx(25.0 - 0.3**2 / 4.0, abs=0.05)
    assert assessed.measured["speed"] == pytest.approx(10.0)
    assert assessed.measured["allowed"] == pytest.approx(37.5)


def test_a_stop_that_takes_too_long_fails(moving):
    assessed = assess_braking(braked(moving, 2.0), since=1.0, deceleration=4.0)
    assert (assessed.passed, assessed.said) == (False, "25 m")
    assert assessed.measured["allowed"] == pytest.approx(18.75)


def test_a_robot_that_walks_on_has_not_stopped(moving):
    assessed = assess_braking(
        braked(moving, 2.0, floor=0.4), since=1.0, deceleration=2.0
    )
    assert (assessed.passed, assessed.said, assessed.measured["distance"]) == (
        False,
        "no stop",
        None,
    )
    assert assessed.measured["slowest"] == pytest.approx(0.4)


def test_a_run_that_ended_before_the_brake_has_measured_nothing(moving):
    assessed = assess_braking(moving(0.8, 10.0), since=1.0, deceleration=2.0)
    assert not assessed.passed
    assert set(assessed.measured.values()) == {2.0, None}


def test_a_launch_passes_from_nine_tenths_of_the_speed_on(make_run):
    run = make_run(duration=6.0, speed=9.6, acceleration=3.0)
    assessed = assess_launch(run, speed=10.0, acceleration=3.0)
    assert (assessed.passed, assessed.said) == (True, "3.0 s")
    assert assessed.measured["time"] == pytest.approx(3.0, abs=0.002)
    assessed = assess_launch(run, speed=10.7, acceleration=3.0)
    assert (assessed.passed, assessed.said, assessed.measured["time"]) == (
        False,
        "9.6 m/s",
        None,
    )


# --- Turns ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "passed"),
    [(0.5, True), (0.43, True), (0.42, False), (0.57, True), (0.58, False)],
)
def test_a_turn_is_as_fast_as_told_within_its_error(moving, rate, passed):
    assessed = assess_turn(moving(4.0, 6.0, yaw_rate=rate), yaw_rate=0.5, since=2.0)
    assert assessed.passed is passed
    assert assessed.said == f"{2.0 * rate:.0%}"
    assert assessed.measured["yaw_rate"] == pytest.approx(rate, rel=1e-3)
    assert assessed.measured["radius"] == pytest.approx(6.0 / rate, rel=1e-3)


def test_a_turn_to_the_wrong_side_or_not_begun_fails(moving):
    assert not assess_turn(
        moving(4.0, 6.0, yaw_rate=0.5), yaw_rate=-0.5, since=2.0
    ).passed
    short = assess_turn(moving(1.5, 6.0, yaw_rate=0.5), yaw_rate=0.5, since=2.0)
    assert not short.passed
    assert (short.said, short.measured["yaw_rate"]) == ("not begun", None)


def test_a_turn_that_is_too_slow_ahead_says_its_speed(moving):
    slow, wide = (
        assess_turn(moving(4.0, 5.0, yaw_rate=rate), yaw_rate=0.5, since=2.0, speed=6.0)
        for rate in (0.5, 0.4)
    )
    assert (slow.passed, slow.said) == (False, "5.0 m/s")
    assert (wide.passed, wide.said) == (False, "80%")


def test_a_turn_on_the_spot_keeps_to_it(moving):
    """A circle of radius v / omega: 2 r is the farthest from the start."""
    near = assess_turn(
        moving(8.0, 0.24, yaw_rate=1.0), yaw_rate=1.0, since=1.0, within=0.5
    )
    far = assess_turn(
        moving(8.0, 0.26, yaw_rate=1.0), yaw_rate=1.0, since=1.0, within=0.5
    )
    slow = assess_turn(
        moving(8.0, 0.0, yaw_rate=0.8), yaw_rate=1.0, since=1.0, within=0.5
    )
    assert [assessed.passed for assessed in (near, far, slow)] == [True, False, False]
    assert near.measured["wander"] == pytest.approx(0.48, abs=0.005)
    assert far.said == "100%, 0.5 m"


# --- Slow motion and standing ---------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "forward", "left", "passed"),
    [
        ((1.0, 0.0, 0.0), 1.09, 0.0, True),
        ((1.0, 0.0, 0.0), 1.11, 0.0, False),
        ((1.0, 0.0, 0.0), 0.89, 0.0, False),
        ((0.0, -0.5, 0.0), 0.0, -0.5, True),
        ((0.0, -0.5, 0.0), 0.0, 0.5, False),
        ((-0.5, 0.0, 0.0), -0.46, 0.0, True),
    ],
)
def test_slow_motion_has_the_speed_that_was_told_in_its_direction(
    moving, command, forward, left, passed
):
    assessed = assess_motion(moving(3.0, forward, left), command=command, since=1.0)
    assert assessed.passed is passed
    assert assessed.measured["speed"] == pytest.approx(
        abs(forward + left) * (1 if passed or forward else -1)
    )
    assert assessed.measured["height"] == pytest.approx(0.55)


def test_a_robot_that_goes_nowhere_has_no_cost(moving):
    assert (
        assess_motion(moving(3.0, 0.0), command=(1.0, 0.0, 0.0), since=1.0).measured[
            "cost_of_transport"
        ]
        is None
    )
    assert not assess_motion(
        moving(0.5, 1.0), command=(1.0, 0.0, 0.0), since=1.0
    ).passed


def test_a_stand_neither_creeps_nor_chatters(moving):
    """A sine of 100 Hz and amplitude A has A / sqrt 2 in the mean; one of 0.5 Hz is no
    chatter."""
    still, creeping = moving(10.0, 0.0019), moving(10.0, 0.0021)
    assert assess_stand(still, quiet=False).passed
    assessed = assess_stand(creeping, quiet=False)
    assert (assessed.passed, assessed.said) == (False, "2.1 cm")
    wave = np.sin(math.tau * 100.0 * still.time)[:, None] * np.ones(12)
    slow = 50.0 * np.sin(math.tau * 0.5 * still.time)[:, None] * np.ones(12)
    for amplitude, passed in ((1.3, True), (1.5, False)):
        assessed = assess_stand(
            moving(10.0, 0.0, torque=amplitude * wave + slow), quiet=True
        )
        assert assessed.passed is passed
        # 101 samples of the mean leave a hundredth of the wave, and the slow one is
        # bent by 0.4 % within them.
        assert assessed.measured["chatter"] == pytest.approx(
            amplitude / math.sqrt(2.0), rel=0.03
        )


# --- Straightness, pushes, bad ground -------------------------------------------------


@pytest.mark.parametrize(("left", "passed"), [(0.037, True), (0.040, False)])
def test_a_straight_run_keeps_its_trunk_in_the_lane(moving, left, passed):
    """0.61 m less half of the trunk's 0.44 m are 0.39 m: in 10 s of 10 m/s, 0.039 m/s
    to the left."""
    assessed = assess_straightness(moving(10.01, 10.0, left), length=100.0)
    assert assessed.passed is passed
    assert assessed.measured["reach"] == pytest.approx(10.0 * left + 0.22, abs=0.002)
    assert assess_straightness(
        moving(10.01, 10.0, left), length=100.0, allowed=3.0
    ).passed


def test_a_run_that_does_not_arrive_is_not_straight(moving):
    assessed = assess_straightness(moving(5.0, 10.0), length=100.0)
    assert (assessed.passed, assessed.said) == (False, "50 m run")


def test_a_push_leaves_an_offset(moving):
    assessed = assess_push(moving(4.0, 10.0, left=0.1))
    assert assessed.passed
    assert assessed.measured["offset"] == pytest.approx(0.4, rel=1e-3)


def test_bad_ground_takes_no_more_than_a_tenth_of_the_speed(moving):
    assert assess_run(moving(2.0, 9.1), level=10.0).passed
    assert not assess_run(moving(2.0, 8.9), level=10.0).passed
    short = assess_run(moving(0.5, 10.0), level=10.0)
    assert (short.passed, short.measured["speed"]) == (False, None)
