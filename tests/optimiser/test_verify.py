"""The verifier against closed forms, and its verdict on a sound trot and on trots
tampered with."""

import dataclasses
import math

import numpy as np
import pytest

from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.problem import Problem, contact_rows
from bp2_rl.optimiser.solution import Motion, Solution
from bp2_rl.optimiser.verify import (
    LIMITS,
    UNITS,
    UNTOLD,
    failures,
    resimulate,
    summarise,
    verify,
)
from bp2_rl.robot import bp2, conventions


@pytest.fixture(scope="module")
def smooth() -> Solution:
    """Return a trot of a robot whose springs have no stops and are well damped, so
    smooth that a coarse mesh is enough."""
    problem = Problem(speed=10.0, intervals=16, clearance=0.0)
    stops = {"spring_stop_stiffness": 0.0, "rebound_stiffness": 0.0}
    return solve(problem.on(**stops, spring_damping=50.0, spring_stiffness=4000.0))


@pytest.fixture(scope="module")
def figures(smooth: Solution) -> dict[str, float]:
    return verify(smooth)


def tamper(solution: Solution, **arrays: np.ndarray) -> Solution:
    return dataclasses.replace(
        solution, motion=dataclasses.replace(solution.motion, **arrays)
    )


def failing(figures: dict[str, float]) -> set[str]:
    """Return the names of the figures that are over their limit."""
    return {line.split()[0] for line in failures(figures)}


def test_every_figure_has_a_unit_and_every_limit_a_figure(figures):
    assert list(figures) == list(UNITS)
    assert all(
        type(value) is float and math.isfinite(value) for value in figures.values()
    )
    assert set(LIMITS) <= set(UNITS)


def test_a_smooth_trot_is_sound(figures):
    assert failures(figures) == []
    # between the points a speed is a cubic
    assert figures["joint_speed_max"] <= 1.01 * bp2.NO_LOAD_SPEED


def test_what_the_program_makes_zero_is_zero_in_the_other_model_of_bp2_as_well(trot):
    """At the points of a mesh however coarse: the equations of motion with their stops,
    impacts, the cycle's closing.

    Between the points that mesh is too coarse for the stops, and the judge says so.
    """
    coarse = failing(verify(trot))
    assert not coarse & {
        "dynamics_residual",
        "impact_residual",
        "position_jump",
        "velocity_jump",
    }
    assert {"position_error", "velocity_error"} <= coarse


def test_torques_that_are_two_per_cent_too_great_are_no_dynamics(smooth):
    tau = smooth.motion.tau
    tampered = verify(tamper(smooth, tau=1.02 * tau))
    assert tampered["dynamics_residual"] == pytest.approx(
        0.02 * np.max(np.abs(tau)), rel=1e-3
    )
    assert {
        "dynamics_residual",
        "energy_residual",
        "position_error",
        "velocity_error",
    } <= failing(tampered)


def test_a_duration_that_is_one_per_cent_too_long_does_not_close(smooth):
    durations = smooth.motion.durations
    late = verify(tamper(smooth, durations=durations * (1.01, 1.0)))
    # The trunk has not moved on as far as the treadmill.
    assert late["position_jump"] == pytest.approx(
        smooth.problem.speed * 0.01 * durations[0], rel=1e-6
    )
    assert {
        "position_jump",
        "energy_residual",
        "position_error",
        "velocity_error",
    } <= failing(late)


def test_a_foot_that_dips_into_the_ground_is_found(smooth):
    """One point only of a swinging leg, its hip and knee stretched; the depth is the
    leg's own geometry."""
    q = smooth.motion.q.copy()
    middle = q.shape[1] // 2
    q[1, middle, [3, 4, 5]] = 0.0, -0.1, -0.02
    L, radius, pitch = bp2.THIGH_LENGTH, bp2.FOOT_RADIUS, q[1, middle, 2]
    hip = q[1, middle, 1] - bp2.HIP_FORE_AFT * np.sin(pitch)
    sole = hip - L * np.cos(pitch) - (L + 0.02 - radius) * np.cos(pitch - 0.1) - radius
    assert sole < -0.01
    dipped = verify(tamper(smooth, q=q))
    assert dipped["swing_clearance_min"] <= sole + 1e-12
    assert "swing_clearance_min" in failing(dipped)


def test_a_force_that_is_missing_leaves_weight_uncarried(smooth):
    force, T = smooth.motion.force.copy(), smooth.motion.durations
    row = contact_rows(conventions.LEGS, ("RR",))[1]
    missing = force[0, :, row].copy()
    force[0, :, row] = 0.0
    simpson = np.full(len(missing), 2.0)
    simpson[1::2], simpson[[0, -1]] = 4.0, 1.0
    weight = 4 * (6.15 + 2.2 + 0.1 + 0.5) * 9.81  # Table S3
    share = (
        T[0]
        * (simpson @ missing)
        / (6.0 * smooth.problem.intervals)
        / (weight * np.sum(T))
    )
    assert share > 0.1
    bad = verify(tamper(smooth, force=force))
    # The trot itself carries its weight within the tolerance.
    assert bad["impulse_residual_z"] == pytest.approx(
        share, abs=LIMITS["impulse_residual_z"]
    )
    assert {"dynamics_residual", "impulse_residual_z"} <= failing(bad)


def test_friction_in_use_is_a_share_of_the_cone(smooth):
    force, down = smooth.motion.force.copy(), contact_rows(conventions.LEGS, ("FL",))[1]
    middle = force.shape[1] // 2
    force[0, middle, down - 1] = -3.0 * bp2.FOOT_FRICTION * force[0, middle, down]
    bad = verify(tamper(smooth, force=force))
    assert bad["friction_use"] >= 3.0 - 1e-9
    assert "friction_use" in failing(bad)


def test_what_is_wrong_at_one_point_alone_is_found(smooth):
    """A foot that pulls, a torque beyond the envelope, a harder landing, and a speed
    that jumps at lift-off."""
    motion = smooth.motion
    force, tau, v = motion.force.copy(), motion.tau.copy(), motion.v.copy()
    force[0, 3, contact_rows(conventions.LEGS, ("FL",))[1]] = -50.0
    tau[0, 4, 2] = bp2.PEAK_TORQUE + 30.0
    v[1, 0, 3] += 0.1
    bad = verify(
        tamper(smooth, force=force, tau=tau, v=v, impulse=1.01 * motion.impulse)
    )
    assert bad["stance_force_min"] <= -50.0 + 1e-9
    # more where the joint turns faster than the corner
    assert bad["torque_excess"] >= 30.0 - 1e-9
    assert bad["velocity_jump"] == pytest.approx(0.1, rel=1e-6)
    assert {
        "stance_force_min",
        "torque_excess",
        "velocity_jump",
        "impact_residual",
    } <= failing(bad)


def test_not_a_number_is_no_pass(figures):
    for name in LIMITS:
        assert any(
            line.startswith(f"{name} is nan")
            for line in failures({**figures, name: math.nan})
        )
    assert len(failures({})) == len(LIMITS) - len(UNTOLD)


def test_the_simulation_counts_only_at_speeds_at_which_it_must_agree(figures):
    off = {**figures, "position_error": 0.1, "velocity_error": 1.0}
    for speed in (4.0, 13.2):
        assert failing({**off, "speed": speed}) == {"position_error", "velocity_error"}
    for speed in (3.9, 13.3):
        assert failing({**off, "speed": speed}) == set()


def test_the_simulation_flies_in_a_parabola_and_keeps_its_feet(smooth):
    """In flight the centre of mass falls by g t^2 / 2, whatever the legs do; in stance
    phi stays as it was."""
    q, v = resimulate(smooth)
    model = PlanarModel.of(smooth.problem)
    mass = model.weight / conventions.GRAVITY
    momentum = np.array(
        [
            (model.terms(x, rate).mass @ rate)[:2]
            for x, rate in zip(q[1], v[1], strict=True)
        ]
    )
    t = smooth.motion.durations[1] * smooth.problem.points
    drop = np.stack([np.zeros_like(t), -conventions.GRAVITY * t], axis=1)
    # the integrator's own error
    np.testing.assert_allclose(momentum / mass - momentum[0] / mass, drop, atol=1e-6)
    rows = contact_rows(conventions.LEGS, ("FL", "RR"))
    feet = np.array(
        [model.terms(x, rate).contact[rows] for x, rate in zip(q[0], v[0], strict=True)]
    )
    np.testing.assert_allclose(feet, np.broadcast_to(feet[0], feet.shape), atol=1e-6)


def test_the_simulation_follows_a_finer_tolerance(smooth):
    """What it says of a solution is not its own error: 100 times tighter it says the
    same to 1e-6."""
    (q, v), (q_tight, v_tight) = resimulate(smooth), resimulate(smooth, rtol=1e-11)
    np.testing.assert_allclose(q, q_tight, atol=1e-6)
    np.testing.assert_allclose(v, v_tight, atol=1e-4)


def test_a_landing_within_the_stride_is_simulated_too():
    """Half a robot that is dropped on a fore foot, flies and lands on the other: speeds
    drop as the impact map says."""
    problem = Problem(gait="two-leg", intervals=2)
    model = PlanarModel.of(problem)
    q0 = np.array([0.0, 0.52, 0.0, 0.7, -1.4, 0.01, 0.7, -1.4, 0.01])
    v0, _ = model.land(
        q0, np.array([1.0, -0.5, *np.zeros(7)]), contact_rows(("F", "H"), ("F",))
    )
    points, segments = len(problem.points), 4
    nothing = np.zeros((segments, points, 4))
    q, v = (np.tile(x, (segments, points, 1)) for x in (q0, v0))
    motion = Motion(
        np.full(4, 0.01), q, v, np.zeros_like(v), nothing, nothing, nothing[:, 0]
    )
    q, v = resimulate(
        Solution(
            problem=problem,
            motion=motion,
            cost=0.0,
            violation=0.0,
            iterations=0,
            seconds=0.0,
        )
    )
    np.testing.assert_array_equal(q[2, 0], q[1, -1])
    rows = contact_rows(("F", "H"), ("H",))
    assert (
        np.max(np.abs((model.terms(q[1, -1], v[1, -1]).jacobian @ v[1, -1])[rows]))
        > 0.1
    )
    assert (
        np.max(np.abs((model.terms(q[2, 0], v[2, 0]).jacobian @ v[2, 0])[rows])) < 1e-9
    )
    np.testing.assert_allclose(
        v[2, 0], model.land(q[1, -1], v[1, -1], rows)[0], atol=1e-12
    )


def test_a_summary_follows_the_motion(smooth):
    heavier = tamper(
        smooth, durations=2.0 * smooth.motion.durations, force=1.1 * smooth.motion.force
    )
    before, after = summarise(smooth), summarise(heavier)
    assert after.duty == pytest.approx(before.duty, rel=1e-12)
    assert after.period == pytest.approx(2.0 * before.period)
    assert after.peak_force == pytest.approx(1.1 * before.peak_force)
    assert before.peak_torque >= np.max(np.abs(smooth.motion.tau))
