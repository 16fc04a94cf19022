"""The efficiency benchmark on powers that are known, and on a robot that trots without
a policy."""

import numpy as np
import pytest
from known_strides import CAUSES, SAMPLES, known_ledger

from bp2_rl.base.assets import asset_path
from bp2_rl.env.observations import layout_of
from bp2_rl.learning.policy import load_policy
from bp2_rl.paper.benchmarks.efficiency.benchmark import (
    EFFICIENCY,
)
from bp2_rl.paper.benchmarks.efficiency.measured import (
    EfficiencyAtSpeed,
    measure_energy,
)
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import load_model
from bp2_rl.simulation.account import Ledger
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp

WEIGHT_SPEED = 36.0 * 9.81 * 5.0


def test_costs_are_means_of_what_is_driven_and_braked(make_run):
    """Of P = a sin + c positive and negative parts are (sqrt(a2 - c2) + c (pi / 2 +
    asin(c / a))) / pi and so on."""
    run = make_run(speed=5.0, acceleration=1e6, duration=8.0).between(
        1.0, 1.0 + 1e-3 * SAMPLES
    )
    found = measure_energy(run, known_ledger(), strides=16)
    assert found is not None
    root, angle = np.sqrt(300.0**2 - 20.0**2), np.arcsin(20.0 / 300.0)
    positive, braking = (
        (root + side * 20.0 * (np.pi / 2 + side * angle)) / np.pi
        for side in (1.0, -1.0)
    )
    assert found.weight_speed == pytest.approx(WEIGHT_SPEED)
    assert found.positive * WEIGHT_SPEED == pytest.approx(2 * positive, rel=1e-4)
    assert found.braking * WEIGHT_SPEED == pytest.approx(2 * braking, rel=1e-4)
    assert found.net * WEIGHT_SPEED == pytest.approx(40.0)
    assert found.lost["air"] * WEIGHT_SPEED == pytest.approx(40.0)
    assert found.spring * WEIGHT_SPEED == pytest.approx(4 * 200.0 / np.pi, rel=1e-4)
    assert found.spring_share == pytest.approx(
        800.0 / (800.0 + 2 * np.pi * positive), rel=1e-4
    )
    for told, returned in (("nothing", 0.0), ("half", 0.5), ("everything", 1.0)):
        drawn = getattr(found.electrical, told) * WEIGHT_SPEED
        assert drawn == pytest.approx(
            2 * positive + 100.0 - returned * 2 * braking, rel=1e-4
        )
    knee = {joint.name: joint for joint in found.joints}["hind knee"]
    assert (knee.peak, knee.hardest) == pytest.approx((320.0, 280.0), rel=1e-4)
    assert (knee.positive, knee.copper) == pytest.approx((positive, 50.0), rel=1e-3)
    driving = 0.5 + angle / np.pi  # of the time
    assert knee.efficiency == pytest.approx(
        positive / (positive + 50.0 * driving), rel=1e-3
    )
    assert {joint.name: joint for joint in found.joints}["fore hip"].efficiency is None
    assert abs(found.stored) + abs(found.integration) < 1e-9
    assert found.closure < 1e-12


def test_a_work_that_was_not_booked_is_left_over(make_run):
    run = make_run(speed=5.0, acceleration=1e6, duration=8.0).between(
        1.0, 1.0 + 1e-3 * SAMPLES
    )
    ledger = known_ledger()
    ledger.lost["air"][:] = 30.0
    found = measure_energy(run, ledger, strides=16)
    assert found is not None
    assert found.integration * WEIGHT_SPEED == pytest.approx(10.0)
    # where nothing is larger than the windings' heat
    assert found.closure == pytest.approx(10.0 / 100.0, rel=0.01)


def test_what_motors_share_lies_between_all_and_nothing_returned(make_run):
    run = make_run(speed=5.0, acceleration=1e6, duration=8.0).between(1.0, 1.5)
    rng = np.random.default_rng(0)
    motors, copper = (
        300.0 * rng.standard_normal((500, 12)),
        rng.uniform(0.0, 50.0, (500, 12)),
    )
    lost = {cause: np.zeros(500) for cause in CAUSES} | {"copper": copper.sum(axis=1)}
    bus, zeros = np.sum(motors + copper, axis=1), np.zeros(500)
    found = measure_energy(
        run, Ledger(bus, lost, zeros, zeros, motors, copper, np.zeros((500, 4))), 1
    )
    assert found is not None
    e = found.electrical
    assert e.everything < e.bus < e.nothing
    assert e.half == pytest.approx(0.5 * (e.everything + e.nothing))


def test_a_robot_that_goes_nowhere_has_no_cost_of_transport(make_run):
    run = make_run(speed=0.05, duration=8.0).between(1.0, 1.0 + 1e-3 * SAMPLES)
    assert measure_energy(run, known_ledger(), strides=16) is None


# --- A robot that runs ----------------------------------------------------------------


def test_work_is_what_is_lost_and_stored():
    """A shipped policy at 3 m/s: C MuJoCo's own energies at both ends leave what steps
    of 1 ms lose."""
    policy = load_policy(asset_path("policies/ideal"), layout_of=layout_of)
    ramp = Ramp((3.0, 0.0, 0.0), acceleration=5.0, hold=1.4)
    request = RunRequest(ramp, BUILT)
    at = EFFICIENCY.measure_run(request, next(simulate(policy, [request])))
    assert isinstance(at, EfficiencyAtSpeed)
    energy = at.energy
    assert energy is not None
    assert at.fell_at is None
    assert energy.strides >= 1
    assert energy.weight_speed == pytest.approx(
        float(load_model(BUILT).body_mass.sum()) * 9.81 * at.speed
    )
    assert energy.closure < 1e-6
    resisted = sum(cost for cause, cost in energy.lost.items() if cause != "copper")
    assert energy.net == pytest.approx(
        resisted + energy.stored + energy.integration, rel=1e-9
    )
    assert abs(energy.integration) < 0.02 * energy.positive
    e = energy.electrical
    assert energy.net < e.everything < e.bus < e.nothing
    for joint in energy.joints:
        assert -1e-9 < joint.positive <= joint.peak
        assert joint.efficiency is None or 0.0 < joint.efficiency < 1.0
    per_leg = 2.0 * sum(joint.positive for joint in energy.joints)
    # but for the last ms
    assert per_leg == pytest.approx(energy.positive * energy.weight_speed, rel=0.01)
