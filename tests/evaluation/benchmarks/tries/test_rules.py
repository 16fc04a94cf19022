"""Every rule passes a run that keeps the rule and fails a run that does not; the runs
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
    """Return a maker of runs with given forward and leftward speeds (m/s, in the
    heading's frame) and yaw rate (rad/s) over time."""

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


def braked(moving, deceleration, floor, seconds=12.0):
    """Return a run at 10 m/s for a second that then decelerates down to `floor`,
    m/s."""
    time = np.arange(round(1000 * seconds)) * 1e-3
    return moving(
        seconds, np.maximum(10.0 - deceleration * np.maximum(time - 1.0, 0.0), floor)
    )


# --- Braking and launches -------------------------------------------------------------


@pytest.mark.parametrize(
    ("deceleration", "floor", "judged", "measured"),
    [
        # v^2 / 2a = 25 m, less what is left at 0.3 m/s; a mean of 0.25 s may move that
        # by 3 cm
        (2.0, 0.0, (True, "25 m"), (10.0, 0.0, 25.0 - 0.3**2 / 4.0, 37.5)),
        # too long
        (4.0, 0.0, (False, "25 m"), (10.0, 0.0, 25.0 - 0.3**2 / 4.0, 18.75)),
        # it walks on
        (2.0, 0.4, (False, "no stop"), (10.0, 0.4, None, 37.5)),
    ],
)
def test_a_stop_is_as_short_as_commanded(moving, deceleration, floor, judged, measured):
    run = braked(moving, 2.0, floor)
    assessed = assess_braking(run, since=1.0, deceleration=deceleration)
    assert (assessed.passed, assessed.result) == judged
    names = "speed", "slowest", "distance", "allowed"
    assert tuple(assessed.measured[name] for name in names) == tuple(
        None if value is None else pytest.approx(value, abs=0.05) for value in measured
    )


@pytest.mark.parametrize(
    ("speed", "judged", "time"),
    [(10.0, (True, "3.0 s"), 3.0), (10.7, (False, "9.6 m/s"), None)],
)
def test_a_launch_passes_from_nine_tenths_of_the_speed_on(
    make_run, speed, judged, time
):
    run = make_run(duration=6.0, speed=9.6, acceleration=3.0)
    assessed = assess_launch(run, speed=speed, acceleration=3.0)
    assert (assessed.passed, assessed.result) == judged
    assert assessed.measured["time"] == (time and pytest.approx(time, abs=0.002))


# --- Turns ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "passed"),
    [(0.5, True), (0.43, True), (0.42, False), (0.57, True), (0.58, False)],
)
def test_a_turn_is_as_fast_as_told_within_its_error(moving, rate, passed):
    assessed = assess_turn(moving(4.0, 6.0, yaw_rate=rate), yaw_rate=0.5, since=2.0)
    assert (assessed.passed, assessed.result) == (passed, f"{2.0 * rate:.0%}")
    assert assessed.measured["yaw_rate"] == pytest.approx(rate, rel=1e-3)
    assert assessed.measured["radius"] == pytest.approx(6.0 / rate, rel=1e-3)


@pytest.mark.parametrize(
    ("seconds", "forward", "rate", "told", "passed", "said"),
    [
        (4.0, 6.0, 0.5, {"yaw_rate": -0.5}, False, "-100%"),  # the wrong side
        # too slow ahead, and too wide as well
        (4.0, 5.0, 0.5, {"yaw_rate": 0.5, "speed": 6.0}, False, "5.0 m/s"),
        (4.0, 5.0, 0.4, {"yaw_rate": 0.5, "speed": 6.0}, False, "80%"),
        # on the spot: in a circle of radius v / omega, 2 r is the farthest from the
        # start
        (8.0, 0.24, 1.0, {"yaw_rate": 1.0, "within": 0.5}, True, "100%, 0.5 m"),
        (8.0, 0.26, 1.0, {"yaw_rate": 1.0, "within": 0.5}, False, "100%, 0.5 m"),
        (8.0, 0.0, 0.8, {"yaw_rate": 1.0, "within": 0.5}, False, "80%, 0.0 m"),
    ],
)
def test_a_turn_keeps_its_side_its_speed_and_its_spot(
    moving, seconds, forward, rate, told, passed, said
):
    run = moving(seconds, forward, yaw_rate=rate)
    assessed = assess_turn(run, since=1.0 if "within" in told else 2.0, **told)
    assert (assessed.passed, assessed.result) == (passed, said)
    if "within" in told:
        assert assessed.measured["wander"] == pytest.approx(
            2.0 * forward / rate, abs=0.005
        )


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
    assessed = assess_motion(moving(3.0, 0.0), command=(1.0, 0.0, 0.0), since=1.0)
    assert not assessed.passed
    assert assessed.measured["cost_of_transport"] is None


def test_a_stand_neither_creeps_nor_chatters(moving):
    """A sine of 100 Hz and amplitude A has A / sqrt 2 in the mean; one of 0.5 Hz is no
    chatter."""
    still, creeping = moving(10.0, 0.0019), moving(10.0, 0.0021)
    assert assess_stand(still, quiet=False).passed
    assessed = assess_stand(creeping, quiet=False)
    assert (assessed.passed, assessed.result) == (False, "2.1 cm")
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
    assert (assessed.passed, assessed.result) == (False, "50 m run")


def test_a_push_leaves_an_offset(moving):
    assessed = assess_push(moving(4.0, 10.0, left=0.1))
    assert assessed.passed
    assert assessed.measured["offset"] == pytest.approx(0.4, rel=1e-3)


@pytest.mark.parametrize(
    ("seconds", "speed", "passed"),
    [(2.0, 9.1, True), (2.0, 8.9, False), (0.5, 10.0, False)],
)
def test_bad_ground_takes_no_more_than_a_tenth_of_the_speed(
    moving, seconds, speed, passed
):
    assessed = assess_run(moving(seconds, speed), level=10.0)
    measured = pytest.approx(speed if seconds > 1.0 else 0.0)
    assert (assessed.passed, assessed.measured["speed"]) == (passed, measured)
