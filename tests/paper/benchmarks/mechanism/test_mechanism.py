"""The mechanism benchmark on forces that are known: what is measured, said and
shown."""

import numpy as np
import pytest

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.paper.benchmarks import speeds
from bp2_rl.paper.benchmarks.mechanism.benchmark import (
    mechanism,
    ramp_to_mechanism,
    say_coverage,
)
from bp2_rl.paper.benchmarks.mechanism.forces import (
    HIPS_AND_KNEES,
    TERMS,
    THROUGH,
    WITHIN,
    Forces,
)
from bp2_rl.paper.benchmarks.mechanism.measured import (
    MechanismAtSpeed,
    MechanismMetrics,
    measure_forces,
)
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.benchmarks.speeds import whole_strides

STRIDES, N = 4, 400
HIP = slice(0, None, 2)


def known(legs: float = 0.02) -> Forces:
    """Four strides: the spring covers 0.4 of a hip's main torque, the knee 0.3, and the
    leg across `legs`."""
    phase = 2 * np.pi * STRIDES * np.arange(N) / N
    main = np.sin(phase)[:, None] * np.full(8, 100.0)
    within, through = np.zeros((len(WITHIN), N, 8)), np.zeros((len(THROUGH), N, 8))
    within[WITHIN.index("spring")] = -0.4 * main
    within[WITHIN.index("other joint")] = -0.3 * main
    within[WITHIN.index("trunk x")] = through[THROUGH.index("same pair")] = -legs * main
    terms = np.zeros((len(TERMS), N, 22))
    terms[TERMS.index("main inertial")][:, HIPS_AND_KNEES] = main
    terms[TERMS.index("coupled inertial")][:, HIPS_AND_KNEES] = np.sum(within, axis=0)
    terms[TERMS.index("active")] = terms[0] + terms[1]
    terms[TERMS.index("main inertial"), :, 0] = terms[
        TERMS.index("ground reaction"), :, 0
    ] = 5.0
    terms[TERMS.index("gravity"), :, 2] = terms[
        TERMS.index("ground reaction"), :, 2
    ] = 350.0
    terms[TERMS.index("centrifugal"), :, 2] = terms[TERMS.index("passive"), :, 2] = (
        -35.0 * np.cos(phase)
    )
    return Forces(terms, within, through)


def test_shares_are_those_at_the_peaks_by_source():
    found = measure_forces(known(), STRIDES, 1e-3)
    assert found.closure < 1e-12
    assert found.frequency == pytest.approx(10.0)
    assert found.peaks == 4 * 2 * STRIDES
    assert found.covered == pytest.approx(0.72)
    assert found.own == pytest.approx(0.7)
    assert found.legs == pytest.approx(0.02)
    assert found.within["spring"] == pytest.approx(0.4)
    hip = found.motors["hind hip"]
    # u is 0.28 of the main torque; without the trunk's help it would be 0.30.
    assert (hip.peak, hip.fixed_peak) == pytest.approx((28.0, 30.0))
    assert (hip.rms, hip.fixed_rms) == pytest.approx((28.0 / 2**0.5, 30.0 / 2**0.5))
    assert found.saved_at_hips == pytest.approx(1 - 28 / 30)


def test_closure_tells_a_term_that_lacks():
    forces = known()
    forces.terms[TERMS.index("active"), 7, HIPS_AND_KNEES[0]] += 1.0
    assert np.argmax(forces.closure) == 7
    assert measure_forces(forces, STRIDES, 1e-3).closure == pytest.approx(1.0 / 350.0)


def test_whole_strides_go_from_touchdown_to_touchdown(make_run):
    run = make_run(duration=6.0)
    found = whole_strides(run, most=3)
    assert found is not None
    part, strides = found
    assert strides == 3
    touching = run.foot_force[:, 2, 2] > 0.0
    period = np.diff(np.flatnonzero(touching[1:] & ~touching[:-1])).mean()
    assert len(part) == pytest.approx(3 * period, abs=3)
    assert whole_strides(run.between(1.0, 1.05)) is None


# --- The benchmark --------------------------------------------------------------------


@pytest.fixture
def ran(monkeypatch):
    """What was tried; a robot told 8 m/s falls if asked to."""
    asked = []

    def run(policy, one):
        speed = one.schedule.target[0]
        asked.append((speed, one.hardware))
        if policy.card.seed == 13 and speed == 8.0:
            return MechanismAtSpeed(speed, 2.0, 1.5, None)
        forces = known(legs=0.001 * speed)
        return MechanismAtSpeed(
            speed, speed, None, measure_forces(forces, STRIDES, 1e-3)
        )

    monkeypatch.setattr(
        speeds,
        "simulate_all",
        lambda _, policy, tries: [run(policy, one) for one in tries],
    )
    return asked


def evaluate(policy, setup):
    return mechanism(policy, ramp_to_mechanism(policy, setup), setup)


def test_five_speeds_are_taken_apart(make_policy, ran, assert_fits):
    evaluation = evaluate(make_policy(), DeepSetup(speed=15.0))
    assert [speed for speed, _ in ran] == [3.0, 5.5, 8.0, 10.74, 15.0]
    assert [at.commanded_speed for at in evaluation.metrics.speeds] == [
        3.0,
        5.5,
        8.0,
        10.74,
        15.0,
    ]
    assert evaluation.good
    assert (
        evaluation.verdict
        == "Within a leg coupling covers 70 %, between legs +0.3 to +1.5 %: small."
    )
    assert [picture.name for picture in evaluation.pictures] == ["sources"]
    assert (
        from_json(MechanismMetrics, to_json(evaluation.metrics)) == evaluation.metrics
    )
    assert all(
        len(line) == len(table.head)
        for table in evaluation.tables
        for line in table.lines
    )
    assert set(evaluation.tiles) <= {row.label for row in evaluation.rows}
    assert evaluation.results["covered_by_other_legs"] == pytest.approx(
        [0.003, 0.0055, 0.008, 0.01074, 0.015]
    )
    assert_fits(evaluation)


def test_legs_that_carry_each_other_are_not_called_small():
    forces = measure_forces(known(legs=-0.2), STRIDES, 1e-3)
    told = say_coverage(MechanismMetrics((MechanismAtSpeed(9.0, 9.0, None, forces),)))
    assert told.endswith("between legs -20.0 %: not small.")


def test_the_quick_version_runs_two_speeds_of_the_robot_asked_for(
    make_policy, ran, assert_fits
):
    evaluation = evaluate(
        make_policy(), DeepSetup(speed=15.0, quick=True, robot="ideal")
    )
    assert [speed for speed, _ in ran] == [8.0, 15.0]
    assert not ran[0][1].solid_legs
    assert_fits(evaluation)


def test_a_fall_is_told_and_the_other_speeds_stay(make_policy, ran, assert_fits):
    evaluation = evaluate(make_policy(seed=13), DeepSetup(speed=15.0))
    assert not evaluation.good
    assert len(evaluation.metrics.found) == 4
    assert {row.label: row.value for row in evaluation.rows}["Fall"] == "at 1.50 s"
    assert_fits(evaluation)
    nothing = MechanismMetrics(evaluation.metrics.speeds[2:3])
    assert say_coverage(nothing) == "No speed was run through: nothing to take apart."
