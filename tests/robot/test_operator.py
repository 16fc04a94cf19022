import math

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.robot.operator import HeadingHold


def test_operator_turns_back_to_the_line():
    operator = HeadingHold(heading_gain=2.0, lane_gain=0.1, limit=0.3)
    straight = np.array([5.0, 0.0, 0.0])
    # points left: turn right
    np.testing.assert_allclose(operator.steer(straight, 0.0, 0.1), (5.0, 0.0, -0.2))
    # is left: turn right
    np.testing.assert_allclose(operator.steer(straight, 1.0, 0.0), (5.0, 0.0, -0.1))
    # no more than the limit
    np.testing.assert_allclose(operator.steer(straight, -10.0, -1.0), (5.0, 0.0, 0.3))


@pytest.mark.parametrize("command", [(5.0, 0.0, 0.4), (5.0, 0.5, 0.0)])
def test_operator_leaves_turns_and_sidesteps_alone(command):
    np.testing.assert_array_equal(
        HeadingHold().steer(np.array(command), 1.0, 0.2), command
    )


@pytest.mark.parametrize("speed", [1.0, 5.0, 12.0])
def test_a_robot_that_obeys_comes_back_to_its_lane(speed):
    operator, y, yaw, widest = HeadingHold(), 1.0, 0.0, 1.0
    for _ in range(60 * 200):
        rate = operator.steer(np.array([speed, 0.0, 0.0]), y, yaw)[2]
        yaw += 0.005 * rate
        y += 0.005 * speed * math.sin(yaw)
        widest = min(widest, y)
    assert abs(y) < 0.05  # from 1 m; slowest at a walk, where there is time
    assert widest > -0.1  # hardly overshoots


@pytest.mark.parametrize(
    ("wrong", "flag"),
    [
        ({"heading_gain": math.nan}, "--operator.heading-gain"),
        ({"lane_gain": math.inf}, "--operator.lane-gain"),
        ({"limit": -0.1}, "--operator.limit"),
    ],
)
def test_impossible_operators_are_refused(wrong, flag):
    with pytest.raises(UserError, match=flag):
        HeadingHold(**wrong)
