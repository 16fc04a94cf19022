import math
from functools import partial

import jax
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.settings.env import ControlConfig
from bp2_rl.simulation.schedule import Course, CourseLeg, Ramp


def test_ramp_reaches_its_target_at_the_acceleration_and_holds_it():
    ramp = Ramp(6.0, acceleration=2.4, hold=20.0)
    assert (ramp.steady_from, ramp.duration) == pytest.approx((2.5, 22.5))
    for time, speed in ((0.0, 0.0), (1.0, 2.4), (2.5, 6.0), (22.5, 6.0)):
        np.testing.assert_allclose(ramp.command(time), (speed, 0.0, 0.0))


def test_ramp_goes_straight_to_a_sideways_target():
    ramp = Ramp((3.0, -4.0, 0.5), acceleration=2.0)
    assert ramp.steady_from == pytest.approx(2.5)
    np.testing.assert_allclose(ramp.command(1.25), (1.5, -2.0, 0.25))


def test_a_ramp_under_a_controller_is_what_its_policy_is_told():
    """Whatever is asked for, and from when on it is told no more than that; by the
    controller's own law."""
    control = ControlConfig(launching=6.0, launching_speed=18.0)
    tell, dt = jax.jit(control.tell), 0.005
    for acceleration in (2.4, 8.0):
        asked = Ramp(15.5, acceleration, hold=1.0)
        ramp, told = asked.under(control), np.zeros(3, np.float32)
        for k in range(1, round(ramp.duration / dt)):
            told = np.asarray(tell(told, np.float32(asked.command(k * dt))))
            # Euler's steps, as the controller takes, are ahead of the law by half a
            # step's change.
            assert (
                ramp.command(k * dt)[0] - 1e-5
                <= told[0]
                <= ramp.command(k * dt)[0] + 0.02
            )
            np.testing.assert_allclose(
                tell(np.float32(ramp.command((k - 1) * dt)), ramp.command(k * dt)),
                ramp.command(k * dt),
                atol=1e-5,
            )
        assert ramp.command(ramp.steady_from - 0.02)[0] < 15.5
        assert ramp.command(ramp.steady_from).tolist() == [15.5, 0.0, 0.0]


@pytest.mark.parametrize(
    ("acceleration", "launching", "launching_speed", "arrives"),
    [
        # 6 (1 - v / 18) is 2.4 m/s2 at 10.8 m/s
        (2.4, 6.0, 18.0, 10.8 / 2.4 + 3.0 * math.log(7.2 / 2.5)),
        (8.0, 6.0, 18.0, 3.0 * math.log(18.0 / 2.5)),
        (2.4, 6.0, 1000.0, 15.5 / 2.4),  # the command is slower all along
        (8.0, 5.0, math.inf, 15.5 / 5.0),
    ],
)
def test_a_ramp_arrives_when_the_slower_of_two_laws_does(
    acceleration, launching, launching_speed, arrives
):
    ramp = Ramp(
        15.5, acceleration, launching=launching, launching_speed=launching_speed
    )
    assert ramp.steady_from == pytest.approx(arrives)
    before, after = (ramp.command(arrives + late)[0] for late in (-0.1, 0.1))
    assert before < 15.5 == after


def test_a_course_goes_straight_from_command_to_command():
    course = (
        Course().to((6.0, 0.0, 0.0), 2.0).hold(1.0).to((6.0, 0.0, 0.5), 0.5).hold(3.0)
    )
    assert (course.duration, course.steady_from) == pytest.approx((6.5, 3.5))
    for time, speed, rate in (
        (0.0, 0.0, 0.0),
        (1.0, 3.0, 0.0),
        (2.0, 6.0, 0.0),
        (3.0, 6.0, 0.0),
        (3.25, 6.0, 0.25),
        (3.5, 6.0, 0.5),
        (9.0, 6.0, 0.5),
    ):
        np.testing.assert_allclose(course.command(time), (speed, 0.0, rate))
    assert Course().hold(10.0).steady_from == 0.0


@pytest.mark.parametrize(
    "impossible",
    [
        lambda: Ramp((math.nan, 0.0, 0.0)),
        lambda: Ramp((1.0, 0.0)),
        lambda: Ramp(math.nan),
        lambda: Ramp(1.0, launching=0.0),
        lambda: Ramp(1.0, launching_speed=math.nan),
        lambda: Ramp(1.0, acceleration=0.0),
        lambda: Ramp(1.0, acceleration=-1.0),
        lambda: Ramp(1.0, hold=0.0),
        lambda: Ramp(1.0, hold=math.inf),
        # a command that the policy is never told
        lambda: Ramp(18.0).under(ControlConfig(launching=6.0, launching_speed=18.0)),
        *(
            partial(CourseLeg, (1.0, 0.0, 0.0), seconds)
            for seconds in (0.0, -1.0, math.inf, math.nan)
        ),
    ],
)
def test_impossible_ramps_and_legs_are_refused(impossible):
    with pytest.raises(UserError):
        impossible()
