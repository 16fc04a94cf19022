"""The shipped policy in a session to be steered: set on its feet once."""

import math

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.learning.policy import load_policy
from bp2_rl.play.session import Session
from bp2_rl.robot.hardware import IDEAL


@pytest.fixture(scope="session")
def standing():
    policy = load_policy(asset_path("policies/ideal"))
    with pytest.MonkeyPatch.context() as patch:
        # s: it need not be quite still
        patch.setattr("bp2_rl.simulation.simulator.SETTLING_TIME", 0.5)
        return Session(policy, IDEAL)


@pytest.fixture
def session(standing):
    standing.friction, standing.falls, standing.best = IDEAL.friction, 0, math.inf
    standing.reset()
    return standing
