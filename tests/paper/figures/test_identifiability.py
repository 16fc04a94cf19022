"""How far the paper's numbers determine assumptions: decompositions with a known
answer, and the rows' closed forms."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.optimiser.collocation import cold_guess
from bp2_rl.optimiser.cycle import whole_cycle
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.figures import identifiability as module
from bp2_rl.paper.figures.identifiability import (
    ASSUMED,
    HEAT,
    MECHANICAL,
    PRINTED,
    RowNumbers,
    heating_rate,
    hip_heat,
    identify,
    jacobian,
    left_of_range,
    reversal,
    sprint_time,
)
from bp2_rl.paper.figures.settings import IdentifiabilityFigureSettings
from bp2_rl.paper.motor_heat import Network
from bp2_rl.paper.thermal_specs import MotorHeat

SIZE = len(PRINTED), len(ASSUMED)


def test_what_is_left_of_a_range_is_bayes_rule():
    # One row on one assumption: 1 / sqrt(1 + s^2). Two assumptions that only their sum
    # is seen of: 1 - s^2/(1 + 2 s^2).
    J = np.zeros(SIZE)
    J[0, 0], J[2, 3], J[2, 4] = 3.0, 2.0, 2.0
    left = left_of_range(J)
    assert left[0] == pytest.approx(1.0 / np.sqrt(10.0))
    assert left[[3, 4]] == pytest.approx(np.sqrt(1.0 - 4.0 / 9.0))
    assert left[5:] == pytest.approx(1.0)


def test_slopes_are_scaled_by_half_a_range_and_the_rows_uncertainty():
    one = next(one for one in ASSUMED if one.name == "rotor inertia")
    row = RowNumbers("C_z", "m g", "Fig. 4 A", 1.19, 1.2, 0.05, {one.name: -0.1})
    # From a half to twice: half the range is a factor of two.
    assert jacobian((row,))[0, ASSUMED.index(one)] == pytest.approx(
        -0.1 * np.log(2.0) / 0.05
    )
    assert all(one.low <= one.value <= one.high for one in ASSUMED)
    assert len({one.name for one in ASSUMED}) == len(ASSUMED)


def test_a_motor_without_ways_out_and_growth_heats_at_its_power():
    heat = dataclasses.replace(MotorHeat(), copper_growth=0.0, magnet_loss=0.0)
    closed = Network.from_spec(heat, 1e6)
    # 86 s of 1e8 s
    assert heating_rate(closed, 173.0) == pytest.approx(
        173.0 / closed.winding_capacity, rel=1e-5
    )
    # With growth alone (e^(a r t) - 1) / a over the time.
    growing = Network.from_spec(dataclasses.replace(heat, copper_growth=3.9e-3), 1e6)
    r = 135.0 / growing.winding_capacity
    assert heating_rate(growing, 135.0) == pytest.approx(
        np.expm1(3.9e-3 * r * 86.0) / 3.9e-3 / 86.0, rel=1e-5
    )
    assert {one.heat for one in HEAT} <= set(vars(closed))


def test_the_sprint_is_that_of_two_straight_lines():
    # docs/notes/paper.md, "The race"
    assert sprint_time(10.74, 2.38) == pytest.approx(11.57, abs=0.005)


def test_a_hips_turn_and_heat_are_read_off_the_motion():
    problem = Problem(speed=10.0, intervals=6)
    guess = cold_guess(problem)
    solution = Solution(
        problem=problem,
        motion=guess,
        cost=0.0,
        violation=0.0,
        iterations=0,
        seconds=0.0,
    )
    cycle = whole_cycle(solution)
    phase = 2.0 * np.pi * cycle.time / cycle.period
    # A hip that swings as a cosine of the phase less 0.7, on half a cycle and its
    # mirror image: speed falls through zero a quarter later than 0.7, and a torque of
    # 30 Nm throughout is 30^2 x 21.4 / 383.3 W.
    leg = problem.stride.legs.index(cycle.hind_leg)
    other = problem.stride.legs.index(problem.stride.then[leg])
    half = len(guess.v)
    for who, part in ((leg, phase[:half]), (other, phase[half:])):
        guess.v[..., 3 + 3 * who] = np.cos(part - 0.7)
        guess.tau[..., 2 * who] = 30.0
    assert reversal(solution) == pytest.approx(
        (0.7 + 0.5 * np.pi) / (2.0 * np.pi), abs=2e-3
    )
    assert hip_heat(solution) == pytest.approx(900.0 * 21.4 / 383.3, rel=1e-4)


def test_trajectories_and_greatest_speeds_make_the_rows(monkeypatch):
    # Greatest speeds by their multipliers are the business of
    # tests/paper/trajectories/test_shadow_prices.py.
    greatest = [
        ("belt", 17.0, {"drag area": 0.0}),
        ("outdoors", 16.0, {"drag area": -0.06}),
    ]
    monkeypatch.setattr(module, "_greatest", lambda cruise: greatest)
    monkeypatch.setattr(
        module,
        "MECHANICAL",
        [one for one in MECHANICAL if one.name == "rotor inertia"],
    )
    numbers = identify(IdentifiabilityFigureSettings(intervals=4))
    rows = {row.name: row for row in numbers.rows}
    assert rows["greatest power"].ours == pytest.approx(1764.0)
    assert rows["C_z"].ours == pytest.approx(1.2, abs=0.2)
    assert rows["main torque"].slopes.keys() == {"rotor inertia"}
    # nearly adiabatic
    assert rows["heating"].slopes["winding's capacity"] == pytest.approx(-1.0, abs=0.1)
    # t = d/v + v/(2a) of the paper's speed and acceleration, and -0.61 of the speed's
    # own slope.
    assert rows["100 m"].ours == pytest.approx(11.57, abs=0.005)
    assert rows["100 m"].slopes["drag area"] == pytest.approx(0.61 * 0.06, rel=0.01)
    assert numbers.left["friction"] == pytest.approx(1.0)
    assert numbers.left["drag area"] < 0.9
    assert numbers.pinned == np.sum(np.linalg.svd(jacobian(numbers.rows))[1] >= 1.0)
