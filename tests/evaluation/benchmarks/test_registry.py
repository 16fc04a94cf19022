import dataclasses
import re

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.cli import eval as command
from bp2_rl.evaluation.benchmarks import run as module
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.registry import ALL, BENCHMARKS, choose
from bp2_rl.evaluation.benchmarks.run import (
    ramp_to_topspeed,
    topspeed,
)
from bp2_rl.robot.operator import HeadingHold


@pytest.fixture
def asked(monkeypatch, make_run):
    """Replace the simulation by a known run; return the simulator and the request of
    each run."""
    calls = []

    def simulate(policy, requests, *, backend):
        calls.append((backend, requests[0]))
        return [make_run(duration=3.0)]

    monkeypatch.setattr(module, "simulate", simulate)
    return calls


# --- Which, with which flags ----------------------------------------------------------


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_is_given_what_is_chosen_of_it(name):
    chosen = BenchmarkOptions(operator=HeadingHold(limit=0.1), speed=3.0)
    if name == "posterior":
        chosen = BenchmarkOptions(robots=3)
    assert choose(name, chosen) == {name: chosen}


@pytest.mark.parametrize(
    ("name", "flag", "wrong"),
    [
        ("topspeed", "robots", BenchmarkOptions(robots=3)),
        ("sprint", "hold", BenchmarkOptions(hold=3.0)),
        ("sprint", "robots", BenchmarkOptions(robots=3)),
        ("convergence", "backend", BenchmarkOptions(backend="drake")),
        ("sensitivity", "backend", BenchmarkOptions(backend="drake")),
        ("manoeuvres", "backend", BenchmarkOptions(backend="drake")),
        ("manoeuvres", "hold", BenchmarkOptions(hold=3.0)),
        ("manoeuvres", "acceleration", BenchmarkOptions(acceleration=3.0)),
        ("manoeuvres", "sensor-noise", BenchmarkOptions(sensor_noise=True)),
    ],
)
def test_a_flag_that_a_benchmark_does_not_know_is_refused(name, flag, wrong):
    with pytest.raises(
        UserError,
        match=f"--{flag} does not apply to --benchmark {name}, which takes .*--speed",
    ):
        choose(name, wrong)


def test_an_unknown_benchmark_is_refused_with_those_there_are():
    with pytest.raises(
        UserError,
        match=re.escape(
            f"--benchmark dash: there are {', '.join(BENCHMARKS)}, and all"
        ),
    ):
        choose("dash", BenchmarkOptions())


def test_all_gives_each_benchmark_the_flags_that_it_knows():
    everything = BenchmarkOptions(
        backend="drake",
        robot="ideal",
        speed=5.0,
        acceleration=1.0,
        hold=2.0,
        robots=7,
        seed=1,
        terrain="slope:0.1",
        sensor_noise=True,
        operator=HeadingHold(1.0),
    )
    chosen = choose("all", everything)
    # posterior has robots of BP2 alone
    assert list(chosen) == [name for name in BENCHMARKS if name != "posterior"]
    for name in chosen:
        assert set(chosen[name].chosen) == set(BENCHMARKS[name].flags)
        assert chosen[name].speed == 5.0


# --- Top speed ------------------------------------------------------------------------


def run(policy, setup):
    return topspeed(policy, ramp_to_topspeed(policy, setup), setup)


@pytest.mark.parametrize(
    ("backend", "more", "acceleration", "hold"),
    [
        ("mujoco", {}, 2.4, 20.0),
        ("mujoco", {"acceleration": 3.0, "hold": 1.5}, 3.0, 1.5),
        ("drake", {}, 2.4, 20.0),
    ],
)
def test_topspeed_ramps_to_the_speed_and_holds_it(
    make_policy, asked, backend, more, acceleration, hold
):
    if backend == "drake":
        pytest.importorskip("pydrake")
    operator = HeadingHold(heading_gain=1.0)
    evaluation = run(
        make_policy(),
        BenchmarkOptions(backend=backend, speed=6.0, operator=operator, **more),
    )
    ((name, request),) = asked
    schedule = request.schedule
    assert (name, request.operator) == (backend, operator)
    assert (schedule.target, schedule.acceleration, schedule.hold) == (
        (6.0, 0.0, 0.0),
        acceleration,
        hold,
    )
    assert evaluation.metrics.best_speed == pytest.approx(5.0)
    assert evaluation.results["best_speed"] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("setup", "seed", "said"),
    [
        (BenchmarkOptions(speed=6.0), None, "without noise"),
        (
            BenchmarkOptions(speed=6.0, seed=7, sensor_noise=True),
            7,
            "with the noise of training, seed 7: joints 0.01 rad and 0.3 rad/s",
        ),
    ],
)
def test_topspeed_says_how_noisy_its_sensors_are(make_policy, asked, setup, seed, said):
    evaluation = run(make_policy(), setup)
    [(_, request)] = asked
    assert request.noise_seed == seed
    assert request.name.endswith(", noisy sensors") is setup.sensor_noise
    assert evaluation.conditions["sensors"].startswith(said)


@pytest.mark.parametrize(("speed", "runs"), [(5.1, True), (4.9, False)])
def test_a_robot_that_is_slower_than_half_the_command_does_not_run(
    make_policy, make_run, monkeypatch, speed, runs
):
    ran = make_run(speed=speed)
    told = dataclasses.replace(ran, command=np.full_like(ran.command, 10.0))
    monkeypatch.setattr(module, "simulate", lambda *_, **__: [told])
    assert run(make_policy(), BenchmarkOptions(speed=10.0)).good is runs


def test_the_command_offers_all_benchmarks_there_are():
    assert tuple(command.BENCHMARKS) == (*BENCHMARKS, ALL)
