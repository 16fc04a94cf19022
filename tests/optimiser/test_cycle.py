"""A whole gait cycle: that it closes, that its halves mirror each other, and that its
links are the model's."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.optimiser import sagittal
from bp2_rl.optimiser.collocation import cold_guess
from bp2_rl.optimiser.cycle import (
    center_of_mass,
    center_of_mass_velocity,
    cost_of_transport,
    leg_points,
    robot_mass,
    whole_cycle,
)
from bp2_rl.optimiser.problem import Gait, Problem, Scheme
from bp2_rl.optimiser.solution import Solution
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL


def guess(gait: Gait = "trot", scheme: Scheme = "hermite-simpson") -> Solution:
    """Return the solver's cold guess as if it were a solution."""
    problem = Problem(gait=gait, scheme=scheme, intervals=4)
    return Solution(
        problem=problem,
        motion=cold_guess(problem),
        cost=0.0,
        violation=0.0,
        iterations=0,
        seconds=0.0,
    )


def coordinates(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.uniform(-0.6, 0.6, (5, 15)) + 0.1, random.normal(size=(5, 15))


def test_a_trot_closes_after_both_halves(trot):
    cycle = whole_cycle(trot)
    motion = cycle.motion
    assert cycle.period == pytest.approx(trot.period, rel=1e-12)
    distance = np.zeros(15)
    distance[0] = trot.problem.speed * cycle.period
    # As exactly as the solver closes half a cycle, twice.
    np.testing.assert_allclose(
        motion.q[-1, -1], motion.q[0, 0] + distance, rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(motion.q[2, 0], motion.q[1, -1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(motion.tau[-1, -1], motion.tau[0, 0], rtol=0, atol=1e-4)


def test_the_second_half_is_the_first_with_left_and_right_changed(trot):
    cycle = whole_cycle(trot)
    assert cycle.standing == (("FL", "RR"), (), ("FR", "RL"), ())
    FR, FL, RR, RL = (np.arange(6 + 3 * leg - 3, 6 + 3 * leg) for leg in range(4))
    for one, other in ((FR, FL), (RR, RL)):
        np.testing.assert_array_equal(
            cycle.motion.q[2:, :, one], cycle.motion.q[:2, :, other]
        )
        np.testing.assert_array_equal(
            cycle.motion.q[2:, :, other], cycle.motion.q[:2, :, one]
        )
    np.testing.assert_array_equal(
        cycle.motion.force[2, :, 0:2], cycle.motion.force[0, :, 2:4]
    )
    assert np.all(cycle.motion.force[2, 1:-1, 1] > 0.0)  # FR stands in its turn


def test_a_whole_stride_is_its_own_cycle():
    solution = guess("two-leg")
    assert whole_cycle(solution).motion is solution.motion


@pytest.mark.parametrize(
    ("scheme", "degree"), [("hermite-simpson", 3), ("trapezoid", 1), ("paper", 0)]
)
def test_the_quadrature_is_exact_to_its_schemes_degree(scheme, degree):
    cycle = whole_cycle(guess(scheme=scheme))
    exact = cycle.period ** (degree + 1) / (degree + 1)
    assert np.sum(cycle.weights * cycle.time**degree) == pytest.approx(exact, rel=1e-12)
    beyond = cycle.period ** (degree + 2) / (degree + 2)
    assert np.sum(cycle.weights * cycle.time ** (degree + 1)) != pytest.approx(
        beyond, rel=1e-6
    )


def test_soles_are_the_models_point_feet():
    hardware = IDEAL.changed(leg_length=0.4)
    model = sagittal.build_model(conventions.LEGS, hardware, 0.0)
    for q in coordinates()[0]:
        phi = np.array(model.contact(q, sagittal.design_vector(hardware))).reshape(4, 2)
        # Two ways to the same sum, in double precision.
        np.testing.assert_allclose(
            leg_points(q, conventions.LEGS, hardware)[:, 2], phi, rtol=0, atol=1e-14
        )


@pytest.mark.parametrize(
    "change", [{}, {"mass_scale": 1.7}, {"thigh_mass": 4.0, "toe_mass": 1.0}]
)
def test_mass_times_the_centres_velocity_is_the_models_momentum(change):
    problem = Problem().on(**change)
    model = sagittal.build_model(conventions.LEGS, problem.hardware)
    for q, v in zip(*coordinates(), strict=True):
        momentum = (
            np.array(model.mass(q, sagittal.design_vector(problem.hardware))) @ v
        )[:2]
        velocity = center_of_mass_velocity(q, v, conventions.LEGS, problem.hardware)
        # Sums of some thirty products, in double precision.
        np.testing.assert_allclose(
            robot_mass(problem) * velocity, momentum, rtol=0, atol=1e-12
        )


def test_a_straight_legs_centre_of_mass_is_table_s3s():
    moment = (
        bp2.THIGH_MASS * bp2.THIGH_COM
        + bp2.SHANK_MASS * (0.35 + bp2.SHANK_LENGTH + bp2.SHANK_COM)
        + bp2.TOE_MASS * (0.70 + bp2.TOE_COM)
    )
    # A quarter is 6.15 kg of trunk and 2.8 kg of leg.
    expected = [0.0, -moment / 8.95]
    np.testing.assert_allclose(
        center_of_mass(np.zeros(15), conventions.LEGS, IDEAL),
        expected,
        rtol=0,
        atol=1e-12,
    )


def test_only_positive_work_costs_transport():
    solution = guess()
    motion = solution.motion
    v, tau = np.zeros_like(motion.v), np.zeros_like(motion.tau)
    v[..., 3], tau[..., 0] = 2.0, 10.0  # a hip that drives with 20 W,
    v[..., 4], tau[..., 1] = 3.0, -10.0  # a knee that brakes with 30 W
    solution = dataclasses.replace(
        solution, motion=dataclasses.replace(motion, v=v, tau=tau)
    )
    assert cost_of_transport(solution) == pytest.approx(
        20.0 / (35.8 * 9.81 * 10.0), rel=1e-12
    )
