"""The policy that ships as `gentle`, against what docs/notes/reality.md says of it."""

import dataclasses

from bp2_rl.learning.policy import load_policy
from bp2_rl.robot.hardware import BUILT
from bp2_rl.simulation.account import account
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import steady_window

WEAK = dataclasses.replace(BUILT, braking_speed=BUILT.no_load_speed)
"""The built robot with motors that brake no harder than they drive."""


def test_gentle_lands_softly_within_the_motors_speed_and_needs_no_strong_brakes():
    policy = load_policy("gentle")
    ramp = Ramp(15.5, hold=5.0).under(policy.card.env.control)
    requests = [RunRequest(ramp, hardware=robot) for robot in (BUILT, WEAK)]
    run, weak = simulate(policy, requests)
    assert (run.fell_at, weak.fell_at) == (None, None)
    assert run.metrics.mean_speed > 11.5
    steady = account(steady_window(run))
    assert steady.ground.landing_down is not None
    assert steady.ground.landing_down < 2.5
    assert steady.power.overspeed_share < 0.001
    assert run.metrics.leg_clearance > 0.015
