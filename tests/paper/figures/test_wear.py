"""The wear of a robot in a run, against the run itself, and its figure."""

import numpy as np
import pytest
from runs import no_action, run_one

from bp2_rl.base.errors import UserError
from bp2_rl.learning.policy import load_policy
from bp2_rl.paper.figures.settings import WearFigureSettings
from bp2_rl.paper.figures.wear import WEAK, measure_wear, wear, wear_of
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.robot.hardware import BUILT
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.schedule import Ramp


@pytest.fixture(scope="module")
def trot():
    """Return a run towards 2 m/s without a policy, until the robot falls."""
    return run_one(
        no_action, Ramp(2.0, acceleration=4.0, hold=0.5), EnvConfig(), hardware=BUILT
    )


def test_what_a_run_wears_is_of_its_steady_part(trot):
    found = measure_wear("trot", 4.0, trot, weak_fell_at=1.5)
    assert (found.policy, found.landing_reward, found.fell_at, found.weak_fell_at) == (
        "trot",
        4.0,
        trot.fell_at,
        1.5,
    )
    assert found.overspeed == 0.0
    heaviest = np.max(trot.foot_force[..., 2]) / (35.8 * 9.81)
    assert 0.3 < found.plate_force < heaviest
    assert found.landing is not None
    assert 0.0 < found.landing < 8.0


def test_weak_brakes_are_the_drives_line():
    speeds = np.linspace(-21.0, 21.0, 12)
    lower, upper = torque_limits(Actuator.from_hardware(WEAK), speeds)
    np.testing.assert_allclose(lower[speeds < -14.7], -upper[speeds > 14.7][::-1])
    np.testing.assert_allclose(lower[speeds > 14.7], -upper[speeds > 14.7], atol=1e-9)


def test_a_policy_that_is_none_is_named(tmp_path):
    with pytest.raises(UserError, match="no policy"):
        wear(WearFigureSettings((tmp_path,)))


def test_the_gentle_policy_lands_softly_within_the_motors_speed_and_needs_no_strong_brakes():
    """What docs/notes/reality.md says of the policy that ships."""
    found = wear_of("gentle", load_policy("gentle"), 15.5)
    assert (found.fell_at, found.weak_fell_at) == (None, None)
    assert found.speed > 11.5
    assert found.landing is not None
    assert found.landing < 2.5
    assert found.overspeed < 0.001
    assert found.room > 0.015
