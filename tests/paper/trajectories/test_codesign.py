"""Co-design on meshes coarse enough to be solved in seconds."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import load_config
from bp2_rl.optimiser import collocation
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import motor_coordinates
from bp2_rl.optimiser.solution import NotSolved, Solution, resample
from bp2_rl.paper.cli import trajectories
from bp2_rl.paper.trajectories.codesign import (
    Codesign,
    CodesignSettings,
    DesignBounds,
    find_design,
    start_problem,
)
from bp2_rl.robot.actuator import Actuator, torque_limits

# Half the points of Hermite-Simpson.
PROBLEM = dataclasses.replace(
    CodesignSettings().problem, scheme="trapezoid", intervals=6
)
SETTINGS = CodesignSettings(problem=PROBLEM, starts=1)


BOUNDS = vars(SETTINGS.bounds)


@pytest.fixture(scope="session")
def design():
    """Return the design found from the first start."""
    return find_design(SETTINGS, seed=0)


def test_a_free_design_is_cheaper_than_bp2_and_within_its_bounds(design):
    fixed = solve(PROBLEM, resample(design.problem, design.motion, PROBLEM))
    # 1 %: far beyond what IPOPT leaves open, far less than what is gained
    assert design.cost < 0.99 * fixed.cost
    for name, (low, high) in BOUNDS.items():
        value = design.problem.hardware.parameter(name)
        # IPOPT widens every bound by 1e-8
        assert low * (1 - 1e-7) <= value <= high * (1 + 1e-7)


def test_the_found_design_costs_the_same_when_it_is_given(design):
    given = solve(design.problem, design.motion)
    assert given.problem.hardware == design.problem.hardware
    # Both programs end within IPOPT's tolerance (1e-7, scaled) of the same optimum.
    assert given.cost == pytest.approx(design.cost, rel=1e-5)


def test_the_motor_stays_the_same_behind_every_gear():
    """Power over motor speed is what the motor can do; the gear has no part in it."""
    shares = np.linspace(-1.2, 1.2, 49)  # of the no-load speed
    powers = []
    for gear in (5.0, 8.5, 14.0):
        hardware = PROBLEM.on(gear_ratio=gear).hardware
        speed = shares * hardware.joint_no_load_speed
        low, high = torque_limits(Actuator.from_hardware(hardware), speed)
        powers.append((low * speed, high * speed))
        assert hardware.reflected_inertia == pytest.approx(
            PROBLEM.hardware.parameter("rotor_inertia") * gear**2
        )
    # round-off of W
    np.testing.assert_allclose(powers[0], powers[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(powers[2], powers[1], rtol=1e-9, atol=1e-9)


def test_the_found_motion_stays_within_the_motor_behind_the_found_gear(design):
    """The program's own envelope, held against the actuator of the simulator."""
    hardware, motors = (
        design.problem.hardware,
        motor_coordinates(design.problem.stride.legs),
    )
    qd, tau = design.motion.v[..., motors], design.motion.tau
    low, high = torque_limits(Actuator.from_hardware(hardware), qd)
    # Nm: constr_viol_tol of 1e-8 times the torque scale of 100 Nm, with room
    slack = 1e-4
    assert np.all(tau <= high + slack)
    assert np.all(tau >= low - slack)
    assert (
        np.max(np.abs(qd))
        <= design.problem.speed_margin * hardware.joint_no_load_speed + 1e-4
    )


@pytest.mark.parametrize(
    ("bounds", "says"),
    [
        (
            {"gear_ratio": (9.0, 8.0)},
            "bounds.gear_ratio must be a range",
        ),
        (
            {"spring_stiffness": (-1.0, 8e3)},
            "bounds.spring_stiffness must be positive, got -1",
        ),
        (
            {"leg_length": (0.2, 0.4)},
            "bounds.leg_length begins too low: .* must exceed shank",
        ),
    ],
)
def test_bounds_without_a_design_are_refused(bounds, says):
    with pytest.raises(UserError, match=says):
        DesignBounds(**bounds)


def test_starts_differ_in_design():
    problems = [start_problem(SETTINGS, seed) for seed in range(4)]
    assert problems[0] == PROBLEM
    assert len({problem.hardware.bp2.leg_length for problem in problems}) == 4
    for problem in problems[1:]:
        for name, (low, high) in BOUNDS.items():
            assert low < problem.hardware.parameter(name) < high


def test_the_cheapest_start_goes_on_to_each_mesh_and_what_there_is_is_left(
    tmp_path, monkeypatch
):
    """The second of two starts is the cheaper, and the second mesh loses its design."""
    costs = iter([2.0, 1.0, 1.0])

    def fake(problem, guess, options):
        asked.append((problem.intervals, problem.hardware.bp2.leg_length))
        assert options.free == BOUNDS
        if problem.intervals == 10:
            raise NotSolved("lost")
        return Solution(
            problem=problem,
            motion=guess,
            cost=next(costs),
            violation=0.0,
            iterations=1,
            seconds=0.1,
        )

    asked: list[tuple[int, float]] = []
    monkeypatch.setattr(collocation, "solve", fake)
    words = ["codesign", "--starts", "2", "--confirm", "8", "10", "--workers", "1"]
    assert trajectories.main([*words, "--out", str(tmp_path)]) != 0
    best = start_problem(CodesignSettings(), 1).hardware.bp2.leg_length
    assert asked[2:] == [(8, best), (10, best)]
    kept = load_config(Codesign, tmp_path / "codesign.json").meshes
    assert [(row.intervals, row.leg_length) for row in kept] == [(8, best)] * 2
