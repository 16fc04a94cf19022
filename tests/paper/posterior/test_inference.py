"""The posterior against closed forms, and its intervals against known truths."""

import numpy as np
import pytest

from bp2_rl.paper.posterior.inference import (
    ERRORS,
    EVIDENCE,
    PRINTED,
    Draws,
    Emulator,
    as_dared,
    effective,
    likelihood,
    logs_of,
    quantiles,
    sprint_time,
    weights,
)
from bp2_rl.paper.posterior.runs import RobotRun
from bp2_rl.paper.posterior.study import (
    Fitted,
    calibrate,
    choose,
    leading,
    weigh_again,
)

SLOPES = np.array(
    [[0.3, -0.1, 0.0], [0.1, 0.1, 0.1], [0.35, -0.1, 0.1], [-0.2, 0.1, -0.1]]
)
"""d ln number / d place, of a world with three assumptions."""


def run_there(shares):
    return PRINTED + (shares - 0.5) @ SLOPES.T


@pytest.fixture(scope="module")
def known():
    shares = np.random.default_rng(0).uniform(size=(80, 3))
    logs = run_there(shares)
    return Fitted(shares, {"built": logs}, (Emulator(shares, logs),))


def draws_of(logs, **changed):
    count = len(logs)
    parts = {
        "shares": np.zeros((count, 1)),
        "policy": np.zeros(count, int),
        "expected": logs,
        "std": np.zeros_like(logs),
        "logs": logs,
        "dared": np.ones(count),
        "chance": np.ones(count),
    }
    return Draws(**parts | changed)


def test_weights_are_bayes_rule_of_normal_numbers():
    # A normal prior and a normal error: the mean is weighted by precision.
    rng = np.random.default_rng(1)
    spread = 0.08
    logs = (
        PRINTED
        + np.array([0.1, 0.0, 0.0, 0.0])
        + spread * rng.normal(size=(200_000, 4))
    )
    by = weights(draws_of(logs), PRINTED, ("belt",))
    error = EVIDENCE["belt"].error
    precision = 1.0 / spread**2 + 1.0 / error**2
    mean = float(by @ logs[:, 0]) - PRINTED[0]
    assert mean == pytest.approx(0.1 / spread**2 / precision, abs=1e-3)
    variance = float(by @ (logs[:, 0] - PRINTED[0] - mean) ** 2)
    assert variance == pytest.approx(1.0 / precision, rel=0.02)
    # what was not measured stays as assumed
    assert float(by @ logs[:, 1]) == pytest.approx(PRINTED[1], abs=2e-3)


def test_a_robot_that_falls_has_no_weight():
    by = weights(
        draws_of(np.tile(PRINTED, (2, 1)), chance=np.array([1.0, 0.0])), PRINTED
    )
    assert by.tolist() == [1.0, 0.0]


def test_daring_less_slows_the_road_and_the_race_alone():
    logs = np.log([[14.0, 1500.0, 12.0, 11.5]])
    shown = np.exp(as_dared(logs, np.array([0.9])))[0]
    assert shown[:3] == pytest.approx([14.0, 1500.0, 10.8])
    assert shown[3] / 11.5 == pytest.approx(sprint_time(10.8) / sprint_time(12.0))
    # two straight lines
    assert sprint_time(10.74) == pytest.approx(11.57, abs=0.005)


def test_equal_weights_give_plain_quantiles():
    values = np.random.default_rng(2).normal(size=1001)
    found = quantiles(values, np.full(1001, 1.0 / 1001))
    assert found == pytest.approx(np.quantile(values, (0.05, 0.5, 0.95)), abs=0.02)
    assert effective(np.full(7, 0.3)) == pytest.approx(7.0)
    assert effective(np.array([1.0, 0.0])) == 1.0


def test_a_fall_leaves_no_numbers():
    ran = RobotRun("built", 13.0, 11.0, 12.0, 1500.0, 1400.0)
    fell = RobotRun("built", 13.0, 2.0, float("nan"), 900.0, 800.0)
    logs = logs_of([ran, fell])
    np.testing.assert_allclose(np.exp(logs[0]), [13.0, 1400.0, 11.0, 12.0])
    assert np.isnan(logs[1]).all()


def test_an_emulator_finds_a_smooth_law_and_who_falls(known):
    rng = np.random.default_rng(3)
    new = rng.uniform(0.1, 0.9, size=(50, 3))
    emulator = known.emulators[0]
    np.testing.assert_allclose(emulator.predict(new)[0], run_there(new), atol=2e-3)
    assert emulator.run_chance(new).tolist() == [1.0] * 50
    logs = run_there(known.shares)
    logs[known.shares[:, 0] > 0.5] = np.nan
    chance = Emulator(known.shares, logs).run_chance(np.array([[0.05] * 3, [0.95] * 3]))
    assert chance[0] > 0.7 > 0.3 > chance[1]


def test_nine_tenths_of_known_truths_lie_in_their_intervals(known):
    checks = calibrate(known, 4000, truths=80)
    for name in ("road", "100 m"):
        # 80 truths: two standard deviations are 7 %
        assert 0.82 <= checks.of(name)["coverage"] <= 0.98
        assert checks.of(name)["width"] < 0.9
    assert np.all(checks.error < 5e-3)


def test_likelihood_falls_with_the_distance_in_errors():
    shown = PRINTED + np.outer([0.0, 1.0, 2.0], ERRORS)
    # each of four numbers is off by so many standard deviations
    assert likelihood(shown, PRINTED) == pytest.approx(np.exp([0.0, -2.0, -8.0]))


def test_an_unsure_emulator_weighs_as_the_error_it_adds():
    # Bayes' rule with what is unknown integrated out: errors add in squares.
    logs = np.tile(PRINTED + 0.1, (1, 1))
    std = 0.75 * ERRORS[None]
    exact = np.prod(0.8 * np.exp(-0.5 * (0.1 / (1.25 * ERRORS)) ** 2))
    assert likelihood(logs, PRINTED, std=std) == pytest.approx([exact])


def test_the_combination_that_a_number_sees_is_found():
    rng = np.random.default_rng(4)
    shares = rng.uniform(size=(20_000, 3))
    seen = np.exp(-0.5 * ((shares[:, 0] - shares[:, 1]) / 0.05) ** 2)
    draws = draws_of(np.tile(PRINTED, (20_000, 1)), shares=shares)
    (parts, left), *_ = leading(draws, seen / seen.sum(), ("a", "b", "c"))
    assert {name: abs(part) for name, part in parts.items()} == pytest.approx(
        {"a": 0.707, "b": 0.707}, abs=0.02
    )
    assert parts["a"] * parts["b"] < 0.0
    # of a difference: 0.05 over sqrt(2), in standard deviations of a place
    assert left == pytest.approx(0.05 / np.sqrt(2.0) * np.sqrt(12.0), rel=0.05)


def test_draws_that_were_emulated_rightly_keep_their_weight(known):
    chosen = choose(known, 50)
    assert len(chosen.shares) == 50
    logs = np.exp(run_there(chosen.shares))
    runs = [
        RobotRun(policy, belt, road, time, power, 2.0 * power)
        for policy, (belt, power, road, time) in zip(chosen.policies, logs, strict=True)
    ]
    values = [{"a": float(x)} for x in chosen.shares[:, 0]]
    rows = weigh_again(chosen, values, runs)
    again = np.array([row["weight"] for row in rows])
    assert again.mean() == pytest.approx(1.0)
    assert effective(again) > 45
    assert rows[0].keys() >= {"a", "policy", "weight", "road"}
    fallen = [RobotRun("built", 0.0, 0.0, float("nan"), 0.0, 0.0), *runs[1:]]
    assert weigh_again(chosen, values, fallen)[0]["weight"] == 0.0
