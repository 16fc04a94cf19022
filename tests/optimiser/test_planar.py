"""The planar MuJoCo model against the CasADi one that trajectories are solved with, and
against the whole robot."""

import dataclasses

import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser import sagittal, verifier_laws
from bp2_rl.optimiser.planar import STOP_ROUNDING, PlanarModel
from bp2_rl.optimiser.problem import Problem
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec
from bp2_rl.robot.model import (
    MOTOR_QPOS,
    MOTOR_QVEL,
    NQ,
    NV,
    SPRING_QPOS,
    SPRING_QVEL,
    load_model,
)

CHANGED = IDEAL.changed(
    gear_ratio=7.0,
    leg_length=0.33,
    spring_stiffness=4500.0,
    spring_travel=0.1,
    mass_scale=1.1,
    thigh_mass=3.1,
    toe_mass=0.3,
    trunk_inertia=1.7,
)
WINDY = dataclasses.replace(
    BUILT, losses=dataclasses.replace(BUILT.losses, headwind=3.0)
)


def assert_equal(actual: np.ndarray, expected: np.ndarray) -> None:
    """Require equality up to round-off: terms are up to some hundreds, in double
    precision."""
    np.testing.assert_allclose(actual, expected, rtol=1e-10, atol=1e-10)


def random_state(rng: np.random.Generator, legs: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw any posture, springs pressed from beyond one stop to beyond the other,
    joints at running speed."""
    trunk = rng.uniform((-1.0, 0.3, -0.5), (1.0, 0.8, 0.5))
    leg = rng.uniform((-1.4, -2.6, -0.03), (2.4, -0.1, 0.16), size=(legs, 3))
    n = 3 + 3 * legs
    return np.concatenate([trunk, leg.ravel()]), rng.normal(scale=10.0, size=n)


@pytest.mark.parametrize(
    "hardware", [IDEAL, CHANGED, WINDY], ids=["bp2", "changed", "built"]
)
@pytest.mark.parametrize(
    ("legs", "radius", "rotors"),
    [(LEGS, 0.02, False), (LEGS, 0.0, True), (("F", "H"), 0.02, True)],
)
def test_every_term_is_that_of_the_casadi_model(hardware, legs, radius, rotors):
    planar = PlanarModel(legs, hardware, radius, rotors)
    casadi, p = (
        sagittal.build_model(legs, hardware, radius, rotors),
        sagittal.design_vector(hardware),
    )
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, v = random_state(rng, len(legs))
        terms, tau, qd = (
            planar.terms(q, v),
            rng.normal(scale=50.0, size=2 * len(legs)),
            v[planar.motors],
        )
        (
            mass,
            centrifugal,
            coriolis,
            gravity,
            passive,
            contact,
            jacobian,
            convective,
            resistance,
        ) = (
            np.array(term)
            for term in (
                casadi.mass(q, p),
                casadi.centrifugal(q, v, p),
                casadi.coriolis(q, v, p),
                casadi.gravity(q, p),
                casadi.passive(q, v, p),
                casadi.contact(q, p),
                casadi.contact_jacobian(q, p),
                casadi.contact_acceleration(q, v, 0.0 * v, p),
                casadi.resistance(v, tau, p),
            )
        )
        assert_equal(terms.mass, mass)
        assert_equal(terms.bias, (centrifugal + coriolis + gravity)[:, 0])
        assert_equal(terms.passive, passive[:, 0])
        assert_equal(terms.contact, contact[:, 0])
        assert_equal(terms.jacobian, jacobian)
        assert_equal(terms.convective, convective[:, 0])
        assert_equal(
            verifier_laws.joint_torque(hardware, qd, tau), tau - resistance[:, 0]
        )


@pytest.mark.parametrize("hardware", [IDEAL, CHANGED], ids=["bp2", "changed"])
def test_it_is_the_robot_with_abduction_roll_and_yaw_held(hardware):
    """Inertia, bias and spring forces of BP2's own MuJoCo model, seen in the sagittal
    plane."""
    robot, planar = load_model(hardware), PlanarModel(LEGS, hardware, 0.02)
    data, rng = mujoco.MjData(robot), np.random.default_rng(1)
    legs_qpos = np.delete(
        np.column_stack([MOTOR_QPOS.reshape(4, 3), SPRING_QPOS]), 0, axis=1
    ).ravel()
    legs_qvel = np.delete(
        np.column_stack([MOTOR_QVEL.reshape(4, 3), SPRING_QVEL]), 0, axis=1
    ).ravel()
    # velocities of the robot for those of the plane: x, z, pitch, then the legs'
    in_plane = np.zeros((NV, 15))
    in_plane[[0, 2, 4, *legs_qvel], range(15)] = 1.0
    for _ in range(20):
        q, v = random_state(rng, 4)
        q[1] += 1.0  # clear of the floor
        data.qpos[:] = np.zeros(NQ)
        data.qpos[[0, 2]], data.qpos[[3, 5]] = (
            q[:2],
            (np.cos(q[2] / 2.0), np.sin(q[2] / 2.0)),
        )
        data.qpos[legs_qpos], data.qvel[:] = q[3:], in_plane @ v
        mujoco.mj_forward(robot, data)
        mass = np.zeros((NV, NV))
        mujoco.mj_fullM(robot, data, mass)
        terms = planar.terms(q, v)
        assert_equal(terms.mass, in_plane.T @ mass @ in_plane)
        assert_equal(terms.bias, in_plane.T @ data.qfrc_bias)
        # The robot's stops have sharp corners: rounding adds at most half its radius to
        # max(u, 0).
        corner = hardware.spring_stop_stiffness * STOP_ROUNDING / 2.0
        assert np.max(np.abs(terms.passive - in_plane.T @ data.qfrc_passive)) <= corner


def test_a_fall_is_a_parabola_of_the_centre_of_mass_whatever_the_motors_do():
    """The rates of momentum at random torques: force-free along x, m g along z."""
    model, rng = PlanarModel(LEGS, IDEAL, 0.02), np.random.default_rng(2)
    for _ in range(20):
        q, v = random_state(rng, 4)
        a, force = model.accelerate(q, v, rng.normal(scale=100.0, size=8), [])
        terms = model.terms(q, v)
        assert force.size == 0
        # x and z of the trunk carry the whole robot, so these rows are its momentum's
        # rate and the weight.
        np.testing.assert_allclose((terms.mass @ a + terms.bias)[:3], 0.0, atol=1e-9)
        com_acceleration = _com_acceleration(model, q, v, a)
        np.testing.assert_allclose(com_acceleration, (0.0, -9.81), atol=1e-4)


def _com_acceleration(
    model: PlanarModel, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """Return the centre of mass's acceleration by a difference of momentum, from the
    mass matrix's first two rows."""
    dt, momentum = 1e-6, []
    for t in (-dt, dt):
        velocity = v + a * t
        momentum.append(
            (model.terms(q + v * t + a * t * t / 2.0, velocity).mass @ velocity)[:2]
        )
    return (momentum[1] - momentum[0]) / (2.0 * dt) / (model.weight / 9.81)


def test_standing_feet_keep_still_and_carry_what_momentum_says():
    """Two feet held: J a = -dJ/dt v exactly, and M a + h = B tau + tau_p + J^T F."""
    model, rng = PlanarModel(LEGS, IDEAL, 0.02), np.random.default_rng(3)
    rows = [2, 3, 4, 5]
    for _ in range(20):
        q, v = random_state(rng, 4)
        tau = rng.normal(scale=100.0, size=8)
        a, force = model.accelerate(q, v, tau, rows)
        terms = model.terms(q, v)
        np.testing.assert_allclose(
            terms.jacobian[rows] @ a, -terms.convective[rows], rtol=1e-8, atol=1e-6
        )
        momentum_rate = (terms.mass @ a + terms.bias)[:2]
        np.testing.assert_allclose(
            momentum_rate, force.reshape(2, 2).sum(axis=0), rtol=1e-8, atol=1e-6
        )


def test_a_landing_stops_the_feet_and_never_gains_energy():
    model, rng = PlanarModel(LEGS, IDEAL, 0.02), np.random.default_rng(4)
    rows = [0, 1, 6, 7]
    for _ in range(20):
        q, v = random_state(rng, 4)
        after, impulse = model.land(q, v, rows)
        terms = model.terms(q, v)
        np.testing.assert_allclose(terms.jacobian[rows] @ after, 0.0, atol=1e-9)
        np.testing.assert_allclose(
            (terms.mass @ (after - v))[:2], impulse.reshape(2, 2).sum(axis=0), atol=1e-8
        )
        # Kinetic energy splits into what the impact leaves and what it takes (Carnot):
        # both are squares.
        lost = v @ terms.mass @ v - after @ terms.mass @ after
        np.testing.assert_allclose(
            lost, (v - after) @ terms.mass @ (v - after), rtol=1e-8
        )


def test_rotor_coupling_adds_to_three_pairs_of_a_leg_and_is_off_by_default():
    problem = Problem()
    plain, coupled = (
        sagittal.model_of(dataclasses.replace(problem, rotor_coupling=on))
        for on in (False, True)
    )
    q, p = random_state(np.random.default_rng(5), 4)[0], sagittal.design_vector(IDEAL)
    added = np.array(coupled.mass(q, p)) - np.array(plain.mass(q, p))
    assert problem.rotor_coupling is False
    # hip and pitch, knee and pitch, knee and hip of the first leg
    pairs = {(3, 2), (4, 2), (4, 3)}
    assert {
        (i, j)
        for i, j in zip(*np.nonzero(np.abs(added[:6, :6]) > 1e-12), strict=True)
        if i > j
    } == pairs
    # 2e-4 kg m2 behind 8.5, to the round-off of an inertia of 3 kg m2.
    np.testing.assert_allclose(
        [added[pair] for pair in pairs], 1.7e-3, rtol=0, atol=1e-14
    )


def test_a_rotor_heavier_to_turn_than_its_thigh_is_refused():
    with pytest.raises(
        UserError,
        match=r"rotor_coupling: hardware.rotor_inertia \(0.02\) must be below",
    ):
        Problem(hardware=HardwareSpec(rotor_inertia=0.02), rotor_coupling=True)
