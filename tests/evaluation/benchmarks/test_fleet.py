import dataclasses
import json

import numpy as np
import pytest

from bp2_rl.base.metric import rows_of
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.evaluation.benchmarks import fleet as module
from bp2_rl.evaluation.benchmarks.fleet import (
    RobustnessMetrics,
    describe_randomization,
    fleet_figure,
    fleet_metrics,
    ramp_to_robustness,
    robots_figure,
    robustness,
    wilson_interval,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.robot.hardware import BUILT
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.settings.presets.robots import on_robot
from bp2_rl.simulation.parallel import FleetRun

DT = 5e-3


def make_fleet(speeds, fell_at=None, duration=4.0) -> FleetRun:
    """Return a fleet's run: robots rise to their speeds within a second and hold them,
    each 0.1 m farther off the line than the last."""
    speeds = np.asarray(speeds, float)
    count = len(speeds)
    time = DT * np.arange(1, round(duration / DT) + 1)
    rise = np.minimum(time, 1.0)
    return FleetRun(
        time=time,
        command=10.0 * rise,
        speed=rise[:, None] * speeds,
        offset=0.1 * np.sin(time)[:, None] * np.arange(count),
        fell_at=np.full(count, np.inf)
        if fell_at is None
        else np.asarray(fell_at, float),
        leg_room=np.linspace(-0.002, 0.03, count),
        robots={
            "friction": np.linspace(0.5, 1.1, count),
            "latency": np.linspace(0.0, 0.01, count),
            "mass": np.linspace(33.0, 39.0, count),
            "strength": np.linspace(0.9, 1.0, count),
        },
        steady_from=1.0,
    )


@pytest.mark.parametrize(
    ("successes", "trials", "interval"),
    [
        # Newcombe, Two-sided confidence intervals for the single proportion, Stat. Med.
        # 17 (1998), Table I, method 3
        (81, 263, (0.2553, 0.3662)),
        (15, 148, (0.0624, 0.1605)),
        (0, 20, (0.0, 0.1611)),
        (1, 29, (0.0061, 0.1718)),
        (200, 200, (0.9812, 1.0)),  # n / (n + z^2)
    ],
)
def test_wilson_interval_of_published_examples(successes, trials, interval):
    # as printed
    assert wilson_interval(successes, trials) == pytest.approx(interval, abs=5e-5)


def test_speeds_and_offsets_are_those_of_the_robots_that_did_not_fall():
    fleet = make_fleet(
        [9.0, 9.5, 10.0, 3.0, 10.5, 11.0], [np.inf, np.inf, np.inf, 2.0, np.inf, np.inf]
    )
    m = fleet_metrics(fleet)
    assert (m.upright, m.share) == (5, pytest.approx(5 / 6))
    assert m.share_interval == wilson_interval(5, 6)
    assert m.mean_speed is not None
    assert m.offset is not None
    # linear between the order statistics
    assert m.mean_speed == pytest.approx((9.1, 10.0, 10.9))
    assert m.offset[1] == pytest.approx(0.2, rel=1e-4)
    assert m.greatest_offset == pytest.approx(0.5, rel=1e-4)
    assert m.fallen_at == (2.0,)
    assert (m.legs_touch, m.leg_depth) == (1, pytest.approx(0.002))
    first, fallen, last = m.robots[0], m.robots[3], m.robots[5]
    assert dataclasses.astuple(first) == pytest.approx(
        (0.5, 0.0, 33.0, 0.9, 9.0, 0.0, None), abs=1e-9
    )
    assert (fallen.mean_speed, fallen.offset, fallen.fell_at) == (None, None, 2.0)
    assert (last.fell_at, last.friction) == (None, 1.1)


def test_a_fleet_of_which_none_stands_has_no_speed():
    m = fleet_metrics(make_fleet([9.0, 9.5], [0.5, 0.25]))
    assert (m.upright, m.mean_speed, m.offset, m.greatest_offset) == (
        0,
        None,
        None,
        None,
    )
    assert m.fallen_at == (0.25, 0.5)
    assert {row.label: row.value for row in rows_of(m)}["Mean speed"] == "-"


@pytest.mark.parametrize("fell_at", [None, [0.5, np.inf], [0.5, 0.6]])
def test_metrics_survive_strict_json(fell_at):
    m = fleet_metrics(make_fleet([9.0, 9.5], fell_at))
    written = json.loads(json.dumps(to_json(m), allow_nan=False))
    assert from_json(RobustnessMetrics, written) == m


@pytest.mark.parametrize("backend", ["mujoco", "drake"])
def test_the_fleet_runs_at_the_papers_outdoor_speed(
    make_policy, monkeypatch, assert_fits, backend
):
    asked = {}

    def run_fleet(policy, request, ranges, robots, seed, backend):
        asked.update(
            request=request, ranges=ranges, robots=robots, seed=seed, backend=backend
        )
        return make_fleet([9.0, 9.5])

    monkeypatch.setattr(module, "run_fleet", run_fleet)
    policy, setup = (
        make_policy(results={"topspeed": {"commanded_speed": 16.0}}),
        BenchmarkOptions(backend=backend),
    )
    if backend == "drake":
        pytest.importorskip("pydrake")
    evaluation = robustness(policy, ramp_to_robustness(policy, setup), setup)
    ramp = asked["request"].schedule
    assert (ramp.target, ramp.acceleration, ramp.hold) == ((10.74, 0.0, 0.0), 2.4, 15.0)
    assert (asked["robots"], asked["seed"], asked["backend"]) == (200, 0, backend)
    assert asked["request"].hardware.solid_legs
    # not the policy's own
    assert asked["ranges"] == on_robot(EnvConfig(), BUILT).randomization
    assert evaluation.good
    assert evaluation.trajectory is None
    assert_fits(evaluation)
    other = BenchmarkOptions(
        backend=backend, robots=7, seed=5, speed=8.0, acceleration=2.0, hold=3.0
    )
    robustness(policy, ramp_to_robustness(policy, other), other)
    ramp = asked["request"].schedule
    assert (
        asked["robots"],
        asked["seed"],
        ramp.target[0],
        ramp.acceleration,
        ramp.hold,
    ) == (7, 5, 8.0, 2.0, 3.0)


def test_numbers_of_the_design_are_named_where_they_are_drawn():
    drawn = RandomizationConfig(armature=(0.8, 1.25), spring_damping=(0.0, 3.0))
    text = describe_randomization(drawn, BUILT)
    assert "x 1 to 1, armature x 0.8 to 1.25, spring damping x 0 to 3; pushes" in text
    assert text.replace(
        ", armature x 0.8 to 1.25, spring damping x 0 to 3", ""
    ) == describe_randomization(RandomizationConfig(), BUILT)


@pytest.mark.parametrize(
    "fell_at", [None, [np.inf, 2.0, np.inf], [0.5, 2.0, 0.6], [DT, DT, DT]]
)
def test_figures_can_be_drawn_whoever_falls(fell_at, assert_drawn):
    fleet = make_fleet([9.0, 9.5, 10.0], fell_at)
    for figure in (robots_figure(fleet_metrics(fleet)), fleet_figure(fleet)):
        assert_drawn(figure)
        labels = figure.axes[0].get_legend_handles_labels()[1]
        assert any("fell" in label or "falls" in label for label in labels) == (
            fell_at is not None
        )
