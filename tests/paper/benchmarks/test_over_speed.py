"""The benchmarks at several speeds, on strides whose forces and energies are known."""

import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import pytest
from known_strides import SAMPLES, STRIDES, known_forces, known_ledger
from synthetic import make_run

from bp2_rl.paper.benchmarks import speeds
from bp2_rl.paper.benchmarks.efficiency import benchmark as efficiency
from bp2_rl.paper.benchmarks.efficiency.measured import (
    EfficiencyAtSpeed,
    EfficiencyMetrics,
    measure_energy,
)
from bp2_rl.paper.benchmarks.mechanism import benchmark as mechanism
from bp2_rl.paper.benchmarks.mechanism.forces import (
    MechanismAtSpeed,
    MechanismMetrics,
    measure_forces,
)
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.paper.benchmarks.registry import BENCHMARKS


def forces_at(speed: float) -> MechanismAtSpeed:
    forces = measure_forces(known_forces(legs=0.001 * speed), STRIDES, 1e-3)
    return MechanismAtSpeed(speed, speed, None, forces)


def energy_at(speed: float) -> EfficiencyAtSpeed:
    run = make_run(speed=5.0, acceleration=1e6, duration=8.0)
    part = run.between(1.0, 1.0 + 1e-3 * SAMPLES)
    energy = measure_energy(part, known_ledger(100.0 * speed), strides=16)
    return EfficiencyAtSpeed(speed, speed, None, energy)


@dataclasses.dataclass(frozen=True)
class Case:
    name: str
    at: Callable[[float], Any]
    fallen: Any
    commands: tuple[float, ...]
    short: tuple[float, ...]
    holds: tuple[float, float]  # s, and in the quick version
    picture: str
    verdict: str


CASES = (
    Case(
        "mechanism",
        forces_at,
        MechanismAtSpeed(8.0, 2.0, 1.5, None),
        commands=(3.0, 5.5, 8.0, 10.74, 15.0),
        short=(8.0, 15.0),
        holds=(5.0, 5.0),
        picture="sources",
        verdict="Within a leg coupling covers 70 %, between legs +0.3 to +1.5 %: small.",
    ),
    Case(
        "efficiency",
        energy_at,
        EfficiencyAtSpeed(8.0, 2.0, 1.5, None),
        commands=(2.0, 4.0, 6.0, 8.0, 10.74, 12.0, 14.0, 15.0),
        short=(10.74, 15.0),
        holds=(10.0, 3.0),
        picture="efficiency",
        # net work 40 W and heat 100 W over 1766 W; driving 975 W, by the closed form of
        # test_efficiency
        verdict="15.0 m/s cost 0.55 of m g d in work, and 0.08 to 0.61 of the battery.",
    ),
)


@pytest.fixture(params=CASES, ids=lambda case: case.name)
def case(request) -> Case:
    return request.param


@pytest.fixture
def evaluate(monkeypatch, make_policy, case):
    """Evaluate a policy on known runs, and return the runs that were asked for; with
    seed 13 the robot that is commanded 8 m/s falls."""
    asked = []

    def run(policy, one):
        asked.append(one)
        speed = one.schedule.target[0]
        fell = policy.card.seed == 13 and speed == 8.0
        return case.fallen if fell else case.at(speed)

    def evaluate(seed=0, **setup):
        policy, chosen = make_policy(seed=seed), DeepBenchmarkOptions(**setup)
        benchmark = BENCHMARKS[case.name]
        ramp = benchmark.schedule(policy, chosen)
        return benchmark.run(policy, ramp, chosen), asked

    monkeypatch.setattr(
        speeds, "simulate_all", lambda _, policy, ones: [run(policy, o) for o in ones]
    )
    return evaluate


def test_the_measurement_reaches_other_processes():
    for benchmark in (mechanism.MECHANISM, efficiency.EFFICIENCY):
        there = pickle.loads(pickle.dumps(benchmark.measure_run))
        assert there.__self__ == benchmark


def told(asked):
    return tuple(one.schedule.target[0] for one in asked)


def test_all_speeds_are_told(case, evaluate, assert_report):
    evaluation, asked = evaluate(speed=15.0)
    assert told(asked) == case.commands
    assert {one.schedule.hold for one in asked} == {case.holds[0]}
    assert evaluation.good
    assert evaluation.verdict == case.verdict
    assert [picture.name for picture in evaluation.pictures] == [case.picture]
    assert evaluation.results["speeds"] == list(case.commands)
    assert_report(evaluation)


def test_the_quick_version_runs_two_speeds_of_the_robot_asked_for(
    case, evaluate, assert_report
):
    evaluation, asked = evaluate(speed=15.0, quick=True, robot="ideal")
    assert told(asked) == case.short
    assert {one.schedule.hold for one in asked} == {case.holds[1]}
    assert not asked[0].hardware.solid_legs
    assert_report(evaluation)


def test_a_fall_is_told_and_the_other_speeds_stay(case, evaluate, assert_report):
    evaluation, _ = evaluate(seed=13, speed=15.0)
    assert not evaluation.good
    assert len(evaluation.metrics.found) == len(case.commands) - 1
    assert evaluation.results["falls"] == 1
    assert {row.label: row.value for row in evaluation.rows}["Fall"] == "at 1.50 s"
    assert_report(evaluation)


def test_one_speed_alone_can_be_asked_for(evaluate, assert_report):
    """The slowest: all costs and shares are single bars and points."""
    evaluation, asked = evaluate(speed=1.0)
    assert told(asked) == (1.0,)
    assert_report(evaluation)


def test_legs_that_carry_each_other_are_not_called_small():
    forces = measure_forces(known_forces(legs=-0.2), STRIDES, 1e-3)
    metrics = MechanismMetrics((MechanismAtSpeed(9.0, 9.0, None, forces),))
    assert mechanism.say_coverage(metrics).endswith("between legs -20.0 %: not small.")


def test_where_all_fell_there_is_nothing_to_say():
    fallen = CASES[0].fallen, CASES[1].fallen
    of_forces, of_energy = MechanismMetrics(fallen[:1]), EfficiencyMetrics(fallen[1:])
    assert mechanism.say_coverage(of_forces).startswith("No speed was run through")
    assert efficiency.say_cost(of_energy).startswith("No speed was run through")
