"""The figure of what holds the optimiser back, and of a policy beside it."""

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.problem import CostWeights
from bp2_rl.optimiser.solution import NotSolved
from bp2_rl.paper.figures import binding as module
from bp2_rl.paper.figures.binding import binding, describe_run
from bp2_rl.paper.figures.settings import BindingFigureSettings
from bp2_rl.paper.trajectories.comparison import running_cost
from bp2_rl.paper.trajectories.shadow_prices import find_shadow_prices
from bp2_rl.robot.bp2 import TOTAL_MASS
from bp2_rl.robot.hardware import IDEAL


def test_the_running_cost_is_the_papers():
    # One motor of eight at half its torque and a quarter of its speed, one foot with a
    # body weight and a half.
    torque, qd, force = np.zeros((1, 8)), np.zeros((1, 8)), np.zeros((1, 8))
    torque[0, 3], qd[0, 3], force[0, 5] = 60.0, -0.25 * 21.4, 1.5 * 353.0
    assert running_cost(torque, qd, force, IDEAL, CostWeights()) == pytest.approx(
        0.125**2 + 0.5**2 + 1.5**2
    )
    assert pytest.approx(353.0, abs=0.5) == TOTAL_MASS * 9.81


def test_a_runs_gait_is_that_of_its_strides(busy_run):
    gait = describe_run(busy_run)
    assert gait.speed == pytest.approx(
        float(np.mean(busy_run.ground_velocity[-1000:, 0])), rel=0.05
    )
    assert 0.0 < gait.duty < 1.0
    assert gait.rms_torque <= gait.peak_torque <= np.max(np.abs(busy_run.torque))


def test_speeds_are_weighed_and_drawn(monkeypatch):
    few = {name: module.LIMIT_CHANGES[name] for name in ("peak torque", "friction")}
    monkeypatch.setattr(module, "LIMIT_CHANGES", few)
    drawn = binding(BindingFigureSettings(speeds=(10.0,), intervals=4))
    numbers = drawn.results
    (ten,) = numbers.speeds
    assert ten.prices["speed"] > 0.5  # it costs to be faster
    assert ten.prices["peak torque"] <= 1e-6 < numbers.greatest.prices["peak torque"]
    assert numbers.greatest.speed > 13.2
    # R without smoothness, over time, beside the objective, which has it and counts
    # segments alike.
    assert ten.gait.running_cost == pytest.approx(ten.cost, rel=0.5)
    assert list(drawn.pictures) == ["binding"]


def test_no_greatest_speed_loses_nothing(monkeypatch):
    def search(start, changes, *, greatest=False):
        if greatest:
            raise NotSolved("lost")
        return find_shadow_prices(start, changes)

    monkeypatch.setattr(module, "find_shadow_prices", search)
    monkeypatch.setattr(
        module, "LIMIT_CHANGES", {"friction": module.LIMIT_CHANGES["friction"]}
    )
    drawn = binding(BindingFigureSettings(speeds=(10.0,), intervals=4))
    (prices,) = drawn.tables
    assert prices.head[-1] == "greatest, not found"
    assert {line[0]: line[-1] for line in prices.lines} == {
        "friction": "",
        "speed": "",
        "cost": "",
    }


@pytest.mark.parametrize("speeds", [(), (10.0, 10.0), (13.0, 10.0)])
def test_speeds_in_no_order_are_refused(speeds):
    with pytest.raises(UserError, match="name the slowest first"):
        BindingFigureSettings(speeds=speeds)
