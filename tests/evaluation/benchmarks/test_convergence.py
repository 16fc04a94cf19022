import pytest

from bp2_rl.evaluation.benchmarks import convergence as module
from bp2_rl.evaluation.benchmarks.convergence import (
    NUMERICS,
    compare_numerics,
    convergence,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.simulation.simulator import CONVERGED


@pytest.fixture
def runs(make_run):
    """Return a run for each choice of numerics: the usual at 5 m/s, the others faster
    by 0.1, 0.2 ... per cent."""
    return {
        name: make_run(speed=5.0 * (1.0 + 1e-3 * k), acceleration=10.0)
        for k, name in enumerate(NUMERICS)
    }


def compare_all(runs):
    return compare_numerics([run.metrics for run in runs.values()])


def test_differences_are_relative_to_the_run_as_judged(runs):
    m = compare_all(runs)
    assert [v.mean_speed_change for v in m.variants] == pytest.approx(
        [0.0, 1e-3, 2e-3, 3e-3, 4e-3], abs=1e-6
    )
    assert [v.best_speed_change for v in m.variants] == pytest.approx(
        [0.0, 1e-3, 2e-3, 3e-3, 4e-3], abs=1e-6
    )
    assert m.greatest_change == pytest.approx(4e-3, abs=1e-6)


def test_runs_too_short_for_a_best_second_are_compared_without(make_run):
    m = compare_all({name: make_run(duration=0.5, fell_at=0.5) for name in NUMERICS})
    assert [v.best_speed_change for v in m.variants] == [None] * len(NUMERICS)
    assert m.greatest_change == 0.0


def test_the_policy_is_run_under_every_numerics(
    make_policy, make_run, runs, simulated, assert_fits
):
    asked = []

    def run(one):
        asked.append((one.schedule, one.numerics))
        return runs[one.name]

    simulated(module, run)
    policy, setup = make_policy(), BenchmarkOptions(speed=6.0)
    ramp = ramp_to_topspeed(policy, setup)
    evaluation = convergence(policy, ramp, setup)
    assert [schedule for schedule, _ in asked] == [ramp] * 5
    numerics = [numerics for _, numerics in asked]
    assert numerics[0] == CONVERGED
    assert [(n.steps, n.motors_each_step) for n in numerics] == [
        (1, False),
        (1, False),
        (2, False),
        (4, False),
        (4, True),
    ]
    assert (numerics[1].iterations, numerics[1].line_search_iterations) == (200, 100)
    assert "but for '0.25 ms, motors too'" in evaluation.conditions["simulator"]
    assert evaluation.good
    assert_fits(evaluation)
    runs["0.5 ms"] = make_run(speed=4.9, acceleration=10.0)
    assert not convergence(policy, ramp, setup).good  # too great a change
