"""Pushes at all phases of a stride and rough ground: the runs that are asked for, and
the table of results."""

import collections

import pytest

from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.tries import benchmark as module
from bp2_rl.evaluation.benchmarks.tries.benchmark import (
    disturbances,
    ramp_to_disturbances,
)
from bp2_rl.evaluation.benchmarks.tries.tasks import all_disturbances
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.named import find_robot
from bp2_rl.robot.operator import HEADING_HOLD
from bp2_rl.settings.terrain import Terrain

STRIDE = 0.32  # s


@pytest.fixture(scope="module")
def asked():
    return all_disturbances(10.74, STRIDE, BUILT, HEADING_HOLD, seed=7)


def test_pushes_come_at_eight_phases_from_eight_sides_with_a_turn_to_each_side(asked):
    pushed = [one for one in asked if one.world.pushes]
    pushes = [one.world.pushes[0] for one in pushed]
    assert len(pushes) == len(set(pushes)) == 128
    assert collections.Counter(push.turn for push in pushes) == {0.5: 64, -0.5: 64}
    times = sorted({push.time for push in pushes})
    assert [time - times[0] for time in times] == pytest.approx(
        [STRIDE * phase / 8 for phase in range(8)]
    )
    assert {round(push.forward**2 + push.left**2, 12) for push in pushes} == {2.25}
    # s, in which a robot may still fall
    assert min(one.schedule.duration - one.world.pushes[0].time for one in pushed) >= 3


def test_rough_ground_has_five_seeds_of_each_of_three_cells(asked):
    grounds = [one.world.terrain for one in asked if one.world.ground]
    assert grounds == [
        Terrain("rough", 0.025, cell, seed)
        for cell in (0.1, 0.2, 0.4)
        for seed in range(7, 12)
    ]


def test_a_small_robot_has_small_disturbances():
    go1 = find_robot("go1")
    asked = all_disturbances(3.0, 0.3, go1, HEADING_HOLD, 0)
    push = asked[0].world.pushes[0]
    assert push.forward == pytest.approx(1.5 * go1.size.speed)
    assert push.turn == pytest.approx(0.5 * go1.size.rate)
    height = 2.0 * asked[-1].world.terrain.size
    assert height == pytest.approx(0.05 * go1.size.length, rel=0.02)


def test_the_sheet_from_runs_that_are_known(
    make_policy, make_run, monkeypatch, simulated, assert_fits
):
    steady, fallen = (
        make_run(duration=2.0, speed=10.74),
        make_run(duration=2.0, speed=10.74, fell_at=1.5),
    )
    monkeypatch.setattr(module, "simulate", lambda *_: iter([steady]))
    simulated(module, lambda one: fallen if "turning left" in one.group else steady)
    policy, setup = make_policy(), BenchmarkOptions()
    evaluation = disturbances(policy, ramp_to_disturbances(policy, setup), setup)
    assert evaluation.verdict == "79 of 143 disturbances without a fall."
    assert not evaluation.good
    assert {row.label: row.value for row in evaluation.rows}["Pushes"] == "64 of 128"
    assert evaluation.results["passes"]["5 cm, points 0.4 m apart"] == "5 of 5"
    assert_fits(evaluation)
