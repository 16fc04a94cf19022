import math

import numpy as np
import pytest

from bp2_rl.errors import UserError
from bp2_rl.evaluation.runs.schedule import Course, Leg, Ramp


def test_ramp_reaches_its_target_at_the_acceleration_and_holds_it():
    ramp = Ramp((6.0, 0.0, 0.0), acceleration=2.4, hold=20.0)
    assert ramp.steady_from == pytest.approx(2.5)
    assert ramp.duration == pytest.approx(22.5)
    np.testing.assert_allclose(ramp.command(0.0), 0.0)
    np.testing.assert_allclose(ramp.command(1.0), (2.4, 0.0, 0.0))
    np.testing.assert_allclose(ramp.command(2.5), (6.0, 0.0, 0.0))
    np.testing.assert_allclose(ramp.command(22.5), (6.0, 0.0, 0.0))


def test_ramp_goes_straight_to_a_sideways_target():
    ramp = Ramp((3.0, -4.0, 0.5), acceleration=2.0)
    assert ramp.steady_from == pytest.approx(2.5)
    np.testing.assert_allclose(ramp.command(1.25), (1.5, -2.0, 0.25))


@pytest.mark.parametrize(
    "wrong",
    [
        {"target": (math.nan, 0.0, 0.0)},
        {"acceleration": 0.0},
        {"acceleration": -1.0},
        {"hold": 0.0},
        {"hold": math.inf},
    ],
)
def test_impossible_ramps_are_refused(wrong):
    with pytest.raises(UserError):
        Ramp(**({"target": (1.0, 0.0, 0.0)} | wrong))


def test_a_course_goes_straight_from_command_to_command():
    course = Course().to((6.0, 0.0, 0.0), 2.0).hold(1.0).to((6.0, 0.0, 0.5), 0.5).hold(3.0)
    assert course.duration == pytest.approx(6.5)
    assert course.steady_from == pytest.approx(3.5)
    for time, command in ((0.0, 0.0), (1.0, 3.0), (2.0, 6.0), (3.0, 6.0), (9.0, 6.0)):
        np.testing.assert_allclose(course.command(time)[:2], (command, 0.0))
    for time, rate in ((3.0, 0.0), (3.25, 0.25), (3.5, 0.5), (6.5, 0.5), (9.0, 0.5)):
        assert course.command(time)[2] == pytest.approx(rate)


def test_a_course_of_one_leg_is_a_ramp():
    ramp, course = Ramp((4.0, 0.0, 0.0), acceleration=2.0, hold=1.5), Course().to((4.0, 0.0, 0.0), 2.0).hold(1.5)
    assert (ramp.duration, ramp.steady_from) == (course.duration, course.steady_from)
    for time in np.linspace(0.0, 3.5, 8):
        np.testing.assert_allclose(course.command(time), ramp.command(time), atol=1e-15)


def test_a_course_that_holds_still_is_steady_from_the_start():
    assert Course().hold(10.0).steady_from == 0.0


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.inf, math.nan])
def test_impossible_legs_are_refused(seconds):
    with pytest.raises(UserError, match=r"leg\.seconds"):
        Leg((1.0, 0.0, 0.0), seconds)
