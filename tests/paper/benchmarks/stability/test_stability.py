"""The stability benchmark on gaits whose sections, spectra and touchdowns are known."""

import dataclasses
import math

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.paper.benchmarks.stability import benchmark as module
from bp2_rl.paper.benchmarks.stability.benchmark import ramp_to_stability, stability
from bp2_rl.paper.benchmarks.stability.measured import (
    PushMetrics,
    RadiusMetrics,
    Steady,
    measure_landings,
    measure_section,
    with_sections,
)
from bp2_rl.paper.benchmarks.stability.tries import summarize
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.settings.env import EnvConfig

FREQUENCY = 4.0  # Hz


@pytest.fixture
def make_steady(make_run):
    def make(seed=0, noise=0.02, duration=12.0) -> Steady:
        """Pitch beats twice a stride, roll and yaw once; noise of a stride is that of
        its first sample."""
        run = make_run(
            duration=duration,
            speed=5.0,
            acceleration=1e6,
            frequency=FREQUENCY,
            duty=0.3,
        )
        clock, rng = FREQUENCY * run.time, np.random.default_rng(seed)
        turn, qvel = 2.0 * np.pi * clock, run.qvel.copy()
        qvel[:, 3] = 0.4 * np.sin(turn)
        qvel[:, 4] = 0.6 * np.cos(2.0 * turn) + 0.2 * np.cos(turn)
        qvel[:, 5] = 0.1 * np.cos(turn)
        qvel[:, 3:6] += (
            noise * rng.standard_normal((200, 3))[np.floor(clock + 0.5).astype(int)]
        )
        return Steady(dataclasses.replace(run, qvel=qvel), clock)

    return make


def test_sections_show_the_noise_and_not_the_stride(make_steady):
    section = measure_section([make_steady(seed) for seed in range(4)])
    assert section is not None
    assert section.strides in (46, 47, 48)
    assert np.median(section.scatter) == pytest.approx(0.02 * math.sqrt(3.0), rel=0.15)
    assert max(section.over_scatter) < 4.0 * section.floor
    assert section.inliers == pytest.approx(0.95, abs=4 * section.inlier_error)
    quiet = measure_section([make_steady(noise=0.0)])
    assert quiet is not None
    assert quiet.scatter == pytest.approx((0.0,), abs=1e-9)


def test_touchdowns_that_keep_time_jitter_by_less_than_a_sample(make_steady):
    landings = measure_landings([make_steady()], 1.0 / FREQUENCY)
    assert [landing.leg for landing in landings] == ["FR", "FL", "RR", "RL"]
    for landing, phase in zip(landings, (0.5, 0.0, 0.0, 0.5), strict=True):
        # Force passes 5 % of the weight some ms after the touchdown itself.
        assert 0.0 <= (landing.phase - phase) % 1.0 < 0.02
        assert landing.jitter < 2e-4
        assert landing.floor == pytest.approx(1e-3 * FREQUENCY / math.sqrt(6.0))


# --- The whole benchmark, with made-up runs -------------------------------------------


@pytest.fixture
def asked(monkeypatch, make_steady):
    """Replace the tests by known results without any robot; return the list of tests
    that are asked for."""
    tries = []

    def run(policy, one):
        tries.append(one)
        noisy, quiet = (
            [make_steady(seed, duration=6.0) for seed in range(2)],
            make_steady(noise=0.0, duration=6.0),
        )
        radius = RadiusMetrics("deviations", 300, 0.9, 0.85, 0.95, 0.1)
        pushes = tuple(
            PushMetrics(p, w, 1.0 + p, 1.25 + p)
            for p in (0.0, 0.5)
            for w in np.linspace(0, 5, 4).tolist()
        )
        radii = () if one.extent is module.QUICK else (radius, radius)
        extent = dataclasses.replace(one.extent, robots=2)
        one = dataclasses.replace(one, extent=extent)
        metrics = summarize(one, noisy, radii, pushes)
        return with_sections(metrics, noisy, quiet)

    monkeypatch.setattr(module, "try_speed", run)
    monkeypatch.setattr(
        module,
        "in_parallel",
        lambda run, policy, tasks: [run(policy, task) for task in tasks],
    )
    return tries


def evaluate(make_policy, setup):
    policy = make_policy(env=EnvConfig())
    return stability(policy, ramp_to_stability(policy, setup), setup)


def test_the_papers_speed_and_the_top_are_run_at_whole_strides(
    make_policy, asked, assert_report
):
    evaluation = evaluate(make_policy, DeepBenchmarkOptions(robot="ideal", seed=3))
    assert [one.asked for one in asked] == [10.74, 15.5]
    assert all(one.robot == IDEAL and one.seed == 3 for one in asked)
    assert all(abs(one.speed - one.asked) < 1.5 for one in asked)
    assert evaluation.good
    assert "radius 0.90 (0.85 to 0.95)" in evaluation.verdict
    assert [picture.name for picture in evaluation.pictures] == ["sections"]
    card = evaluation.results["at 10.74 m/s"]
    assert (card["radius_under_noise"], card["weakest_push"]) == (0.9, 1.0)
    assert_report(evaluation)


def test_the_quick_version_runs_the_papers_speed_alone_and_faster(
    make_policy, asked, assert_report
):
    evaluation = evaluate(make_policy, DeepBenchmarkOptions(quick=True, robots=3))
    (one,) = asked
    assert (one.asked, one.rise.acceleration, one.robot) == (10.74, 5.0, BUILT)
    assert one.extent == dataclasses.replace(module.QUICK, robots=3)
    assert_report(evaluation)


def test_a_speed_that_is_named_is_the_only_one(make_policy, asked):
    evaluate(make_policy, DeepBenchmarkOptions(speed=6.0))
    assert [one.asked for one in asked] == [6.0]


def test_a_map_that_may_not_contract_is_no_good_result(make_policy, asked, monkeypatch):
    run = module.try_speed

    def grows(policy, one):
        found = run(policy, one)
        wide = dataclasses.replace(found.metrics, radius_interval=(0.8, 1.01))
        return dataclasses.replace(found, metrics=wide)

    monkeypatch.setattr(module, "try_speed", grows)
    assert not evaluate(make_policy, DeepBenchmarkOptions()).good


def test_all_may_fall(make_policy, asked, monkeypatch, assert_report):
    def falls(policy, one):
        extent = dataclasses.replace(one.extent, robots=2)
        metrics = summarize(dataclasses.replace(one, extent=extent), [], (), ())
        return with_sections(metrics, [], None)

    monkeypatch.setattr(module, "try_speed", falls)
    evaluation = evaluate(make_policy, DeepBenchmarkOptions())
    assert not evaluation.good
    assert evaluation.verdict.startswith("10.74 m/s: 2 of 2 fell; ")
    assert_report(evaluation)


def test_a_policy_without_a_stride_is_refused_in_a_line(make_policy, asked):
    policy = make_policy(env=EnvConfig(reference="none"))
    setup = DeepBenchmarkOptions(speed=5.0)
    with pytest.raises(UserError, match="no command near 5 m/s has a stride"):
        stability(policy, ramp_to_stability(policy, setup), setup)
