"""Co-design on meshes coarse enough to be solved in seconds."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.optimiser import collocation
from bp2_rl.optimiser.collocation import cold_guess, solve
from bp2_rl.optimiser.problem import Problem, motor_coordinates
from bp2_rl.optimiser.solution import NotSolved, Solution, resample
from bp2_rl.paper.trajectories.codesign import (
    PARAMETERS,
    Chain,
    Codesign,
    CodesignSettings,
    DesignBounds,
    find_designs,
    optimise_design,
    read_solution,
    solve_chain,
    solve_chains,
    start_chain,
)
from bp2_rl.robot.actuator import Actuator, torque_limits

# Half the points of Hermite-Simpson.
PROBLEM = dataclasses.replace(
    CodesignSettings().problem, scheme="trapezoid", intervals=6
)
SETTINGS = CodesignSettings(problem=PROBLEM, starts=1)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("codesign")


@pytest.fixture(scope="session")
def design(folder):
    """Return the design found from the only start."""
    return find_designs(SETTINGS, folder)[0][1]


def test_a_free_design_is_cheaper_than_bp2_and_within_its_bounds(design):
    fixed = solve(PROBLEM, resample(design.problem, design.motion, PROBLEM))
    # 1 %: far beyond what IPOPT leaves open, far less than what is gained
    assert design.cost < 0.99 * fixed.cost
    for name, (low, high) in SETTINGS.bounds.of(PARAMETERS).items():
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
            "bounds.gear_ratio must be two numbers with 0 < low < high, got 9 and 8",
        ),
        (
            {"spring_stiffness": (-1.0, 8e3)},
            "bounds.spring_stiffness must be two numbers with 0 < low < high",
        ),
        (
            {"leg_length": (0.3, float("inf"))},
            "bounds.leg_length must be two numbers with 0 < low < high",
        ),
        (
            {"leg_length": (0.2, 0.4)},
            "bounds.leg_length begins too low: .* must exceed shank",
        ),
    ],
)
def test_bounds_without_a_design_are_refused(bounds, says):
    with pytest.raises(UserError, match=says) as refused:
        DesignBounds(**bounds)
    assert "\n" not in str(refused.value)


def lengthening() -> Chain:
    """Return a chain of three problems, whose legs grow longer."""
    lengths = (0.3, 0.35, 0.4)
    problems = tuple(PROBLEM.on(leg_length=length) for length in lengths)
    return Chain(problems, (), SETTINGS.bounds)


def test_an_interrupted_chain_goes_on_where_it_stood(tmp_path, monkeypatch):
    """Two of three values were solved when it stopped: only the third is solved, from
    the second's trajectory."""
    chain = lengthening()
    calls = []

    def fake(problem, guess, options):
        calls.append(problem.hardware.bp2.leg_length)
        assert not options.free
        if len(calls) == 3:
            raise KeyboardInterrupt
        return dataclasses.replace(TROT, problem=problem)

    TROT = _made_up(chain.problems[0])
    monkeypatch.setattr(collocation, "solve", fake)
    with pytest.raises(KeyboardInterrupt):
        solve_chains([chain], tmp_path, 1)
    solve_chains([chain], tmp_path, 1)
    lengths = [problem.hardware.bp2.leg_length for problem in chain.problems]
    assert calls == [*lengths, lengths[2]]


def test_a_failure_is_passed_over(tmp_path, monkeypatch):
    up = lengthening()
    starts = []

    def fake(problem, guess, options):
        starts.append(guess.durations[0])
        if problem == up.problems[1]:
            raise NotSolved("no trajectory")
        return dataclasses.replace(made_up, problem=problem)

    made_up = _made_up(up.problems[0])
    monkeypatch.setattr(collocation, "solve", fake)
    assert solve_chain(up, tmp_path) is not None
    assert read_solution(up.parts[1], tmp_path) is None
    # the third began where the first had ended
    assert starts[2] == made_up.motion.durations[0]


def test_starts_differ_in_design_and_guess():
    chains = [start_chain(SETTINGS, seed) for seed in range(4)]
    assert chains[0] == Chain((PROBLEM,), PARAMETERS, SETTINGS.bounds)
    assert len({chain.problems[0].hardware.bp2.leg_length for chain in chains}) == 4
    for chain in chains[1:]:
        for name, (low, high) in SETTINGS.bounds.of(PARAMETERS).items():
            assert low < chain.problems[0].hardware.parameter(name) < high


def _made_up(problem: Problem):
    """Return a solution that satisfies nothing, with durations of its own."""
    guess = cold_guess(problem, seed=7)
    return Solution(
        problem=problem,
        motion=guess,
        cost=1.0,
        violation=0.0,
        iterations=1,
        seconds=0.1,
    )


def test_the_optimum_is_told_on_each_mesh_and_resumed_solves_nothing_again(
    tmp_path, monkeypatch
):
    settings = dataclasses.replace(SETTINGS, confirm=(8, 10))

    def fake(problem, guess, options):
        assert set(options.free) == set(PARAMETERS)
        return _made_up(problem)

    monkeypatch.setattr(collocation, "solve", fake)
    rows = optimise_design(settings, tmp_path)
    assert [row.intervals for row in rows] == [6, 8, 10]
    monkeypatch.setattr(collocation, "solve", None)  # calling it would fail
    assert optimise_design(settings, tmp_path) == rows
    save_config(tmp_path / "codesign.json", Codesign(settings, rows))
    assert load_config(Codesign, tmp_path / "codesign.json").meshes == rows
