"""The efficiency benchmark on powers that are known, and on a robot that trots without
a policy."""

import numpy as np
import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.env.observations import layout_of
from bp2_rl.learning.policy import load_policy
from bp2_rl.paper.benchmarks import speeds
from bp2_rl.paper.benchmarks.efficiency.benchmark import (
    account_energy,
    efficiency,
    ramp_to_efficiency,
    say_cost,
)
from bp2_rl.paper.benchmarks.efficiency.measured import (
    KINDS,
    EfficiencyAtSpeed,
    EfficiencyMetrics,
    measure_energy,
)
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.robot.hardware import BUILT, HardwareSpec
from bp2_rl.robot.model import load_model
from bp2_rl.simulation.account import CAUSES, Ledger
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp

N = 4001  # ms of four cycles a second, and the one that is left out
HIND_KNEES = (8, 11)
WEIGHT_SPEED = 36.0 * 9.81 * 5.0


def known(amplitude: float = 300.0) -> Ledger:
    """The hind knees drive and brake in turn, like a sine; their windings heat by 50 W
    each; springs likewise."""
    sine = np.sin(2 * np.pi * 4.0 * 1e-3 * np.arange(N))
    motors, copper = np.zeros((N, 12)), np.zeros((N, 12))
    motors[:, HIND_KNEES] = (amplitude * sine + 20.0)[:, None]
    copper[:, HIND_KNEES] = 50.0
    lost = {cause: np.zeros(N) for cause in CAUSES} | {
        "copper": np.full(N, 100.0),
        "air": np.full(N, 40.0),
    }
    bus = np.sum(motors + copper, axis=1)
    stored = bus - 140.0
    energy = np.concatenate([[0.0], np.cumsum(stored[:-1]) * 1e-3])
    springs = np.repeat(200.0 * sine[:, None], 4, axis=1)
    return Ledger(bus, lost, stored, energy, motors, copper, springs)


def test_costs_are_means_of_what_is_driven_and_braked(make_run):
    """Of P = a sin + c positive and negative parts are (sqrt(a2 - c2) + c (pi / 2 +
    asin(c / a))) / pi and so on."""
    run = make_run(speed=5.0, acceleration=1e6, duration=8.0).between(
        1.0, 1.0 + 1e-3 * N
    )
    found = measure_energy(run, known(), strides=16)
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
        1.0, 1.0 + 1e-3 * N
    )
    ledger = known()
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
    run = make_run(speed=0.05, duration=8.0).between(1.0, 1.0 + 1e-3 * N)
    assert measure_energy(run, known(), strides=16) is None


# --- A robot that runs ----------------------------------------------------------------


def test_work_is_what_is_lost_and_stored():
    """A shipped policy at 3 m/s: C MuJoCo's own energies at both ends leave what steps
    of 1 ms lose."""
    policy = load_policy(asset_path("policies/ideal"), layout_of=layout_of)
    ramp = Ramp((3.0, 0.0, 0.0), acceleration=5.0, hold=1.4)
    at = account_energy(ramp, next(simulate(policy, [RunRequest(ramp, BUILT)])))
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


# --- The benchmark --------------------------------------------------------------------


@pytest.fixture
def ran(monkeypatch, make_run):
    """What was tried; a robot of a policy of seed 13 that is told 8 m/s falls."""
    asked: list[tuple[float, float, HardwareSpec]] = []
    run = make_run(speed=5.0, acceleration=1e6, duration=8.0).between(
        1.0, 1.0 + 1e-3 * N
    )

    def account(policy, one):
        speed = one.schedule.target[0]
        asked.append((speed, one.schedule.hold, one.hardware))
        if policy.card.seed == 13 and speed == 8.0:
            return EfficiencyAtSpeed(speed, 2.0, 1.5, None)
        energy = measure_energy(run, known(100.0 * speed), strides=16)
        return EfficiencyAtSpeed(speed, speed, None, energy)

    monkeypatch.setattr(
        speeds,
        "simulate_all",
        lambda _, policy, tries: [account(policy, one) for one in tries],
    )
    return asked


def evaluate(policy, setup):
    return efficiency(policy, ramp_to_efficiency(policy, setup), setup)


def test_costs_are_told_over_speed(make_policy, ran, assert_fits):
    evaluation = evaluate(make_policy(), DeepSetup(speed=15.0))
    commands = [2.0, 4.0, 6.0, 8.0, 10.74, 12.0, 14.0, 15.0]
    assert [speed for speed, *_ in ran] == commands
    assert {hold for _, hold, _ in ran} == {10.0}
    assert [at.commanded_speed for at in evaluation.metrics.speeds] == commands
    assert evaluation.good
    last = evaluation.metrics.found[-1][1]
    assert evaluation.results["mechanical_cost"][-1] == pytest.approx(
        last.positive, rel=1e-3
    )
    assert f"cost {last.positive:.2f} of m g d in work" in evaluation.verdict
    assert (
        from_json(EfficiencyMetrics, to_json(evaluation.metrics)) == evaluation.metrics
    )
    assert all(
        len(line) == len(table.head)
        for table in evaluation.tables
        for line in table.lines
    )
    assert [joint.name for joint in last.joints] == list(KINDS)
    assert set(evaluation.tiles) <= {row.label for row in evaluation.rows}
    assert [picture.name for picture in evaluation.pictures] == ["efficiency"]
    assert_fits(evaluation)


def test_the_quick_version_runs_two_speeds_for_a_short_time(
    make_policy, ran, assert_fits
):
    evaluation = evaluate(
        make_policy(), DeepSetup(speed=15.0, quick=True, robot="ideal")
    )
    assert [(speed, hold) for speed, hold, _ in ran] == [(10.74, 3.0), (15.0, 3.0)]
    assert not ran[0][2].solid_legs
    assert_fits(evaluation)


def test_a_fall_is_told_and_the_other_speeds_stay(make_policy, ran, assert_fits):
    evaluation = evaluate(make_policy(seed=13), DeepSetup(speed=15.0))
    assert not evaluation.good
    assert len(evaluation.metrics.found) == 7
    assert {row.label: row.value for row in evaluation.rows}["Fall"] == "at 1.50 s"
    assert_fits(evaluation)
    nothing = EfficiencyMetrics(evaluation.metrics.speeds[3:4])
    assert say_cost(nothing) == "No speed was run through: nothing to account for."


def test_one_speed_alone_can_be_asked_for(make_policy, ran, assert_fits):
    """The slowest: all costs are bars and points."""
    evaluation = evaluate(make_policy(), DeepSetup(speed=1.0))
    assert [speed for speed, *_ in ran] == [1.0]
    assert_fits(evaluation)
