"""Shadow prices by the multipliers of one solve, against problems that were solved
again."""

import dataclasses

import pytest

from bp2_rl.optimiser.collocation import GREATEST_SPEED, optimise, solve
from bp2_rl.optimiser.problem import Problem
from bp2_rl.paper.trajectories.shadow_prices import (
    LIMIT_CHANGES,
    LOSS_CHANGES,
    ShadowPrices,
    find_shadow_prices,
)
from bp2_rl.robot.hardware import BUILT

NAMES = "rotor inertia", "foot clearance"


@pytest.fixture(scope="module")
def priced() -> ShadowPrices:
    """Return the shadow prices of a trot on a mesh that is solved in a moment."""
    coarse = solve(Problem(speed=10.0, intervals=4))
    return find_shadow_prices(coarse, {name: LIMIT_CHANGES[name] for name in NAMES})


def test_a_price_is_what_solving_again_says(priced):
    start, change = priced.solution, LIMIT_CHANGES["rotor inertia"]
    less, more = (
        solve(change(start.problem, factor), start.motion).cost
        for factor in (0.995, 1.005)
    )
    # Central differences over 1 %: what is of third order in them is below a per cent.
    assert priced.prices["rotor inertia"] == pytest.approx(
        (more - less) / 0.01, rel=0.01
    )
    # At this speed feet clear the ground by far, so that nobody pays for it.
    assert abs(priced.prices["foot clearance"]) < 1e-6


def test_the_greatest_speed_gains_as_much_as_is_said(priced):
    fast = find_shadow_prices(
        priced.solution,
        {"no-load speed": LIMIT_CHANGES["no-load speed"]},
        greatest=True,
    )
    speed, problem = fast.solution.problem.speed, fast.solution.problem
    faster = optimise(
        problem.on(no_load_speed=1.005 * 21.4), fast.solution.motion, GREATEST_SPEED
    )
    more = faster.solution.problem.speed
    # One-sided, so its own curvature counts.
    assert fast.prices["no-load speed"] == pytest.approx(
        (more - speed) / 0.005, rel=0.05
    )


@pytest.mark.parametrize("name", [*LIMIT_CHANGES, *LOSS_CHANGES])
def test_a_change_is_none_without_a_factor(name):
    problem = dataclasses.replace(Problem(), hardware=BUILT)
    change = (LIMIT_CHANGES | LOSS_CHANGES)[name]
    assert change(problem, 1.001) != problem
    assert change(problem, 1.0).hardware.losses.gear_efficiency == pytest.approx(
        BUILT.losses.gear_efficiency
    )
