"""Coupled inertial torques by source: they add up, and they are what an independent
model of the robot says."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.optimiser.collocation import cold_guess
from bp2_rl.optimiser.cycle import whole_cycle
from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.problem import Problem, motor_coordinates
from bp2_rl.optimiser.solution import Solution, resample
from bp2_rl.paper.trajectories.coupling import (
    CouplingAccount,
    account_coupling,
    closure,
    keep_harmonics,
    split_planar,
)
from bp2_rl.paper.trajectories.decomposition import (
    BALANCE,
    Decomposition,
    coupling_opposes,
    decompose,
)
from bp2_rl.paper.trajectories.sources import LIMBS, ON_TRUNK, Sources

LEGS = ("FR", "FL", "RR", "RL")


@pytest.fixture(scope="module")
def decomposition(trot) -> Decomposition:
    return decompose(trot)


@pytest.fixture(scope="module")
def sources(decomposition) -> Sources:
    return split_planar(decomposition)


@pytest.fixture(scope="module")
def account(trot) -> CouplingAccount:
    return account_coupling(trot)


def planar_states(decomposition: Decomposition):
    """Return the planar MuJoCo model's terms with velocities, accelerations, motor
    torques and forces at some of the cycle's points."""
    cycle = decomposition.cycle
    planar = PlanarModel.of(cycle.problem)
    q, v, a, tau, force = (
        x.reshape(-1, x.shape[-1])
        for x in (
            cycle.motion.q,
            cycle.motion.v,
            cycle.motion.a,
            cycle.motion.tau,
            cycle.motion.force,
        )
    )
    for k in range(0, len(q), 7):
        yield k, planar.terms(q[k], v[k]), a[k], tau[k], force[k]


def test_no_entry_of_the_mass_matrix_joins_two_legs(decomposition):
    for _, terms, *_ in planar_states(decomposition):
        legs = terms.mass[3:, 3:].reshape(4, 3, 4, 3)
        assert not any(
            np.any(legs[i, :, j]) for i in range(4) for j in range(4) if i != j
        )


def test_the_sources_add_up(sources, decomposition):
    assert len(sources.within) == 5
    assert list(sources.through) == [*LIMBS, *ON_TRUNK][:-1]  # no stops
    parts = *sources.within.values(), *sources.through.values()
    assert {part.shape for part in parts} == {(4 * 13, 8)}
    # what the paper's evidence is held to; the solver leaves some 1e-11
    assert closure(sources) < 1e-6
    coupled = decomposition.forces[1][:, motor_coordinates(LEGS)]
    np.testing.assert_allclose(
        sum(sources.within.values()), coupled, rtol=0, atol=1e-10
    )


def test_what_a_leg_does_to_another_is_mujocos_schur_complement(sources, decomposition):
    """A trunk without any force on it, and one leg's joints accelerated as in the trot:
    MuJoCo's mass matrix says how the trunk recoils, and what that takes at each
    joint."""
    partners = {"FR": "RL", "FL": "RR", "RR": "FL", "RL": "FR"}
    joints = motor_coordinates(LEGS)
    for k, terms, a, *_ in planar_states(decomposition):
        for i, leg in enumerate(LEGS):
            for kind, movers in (
                ("own leg", [leg]),
                ("same pair", [partners[leg]]),
                (
                    "other pair",
                    [other for other in LEGS if other not in (leg, partners[leg])],
                ),
            ):
                moved = np.zeros(15)
                for mover in movers:
                    block = slice(3 + 3 * LEGS.index(mover), 6 + 3 * LEGS.index(mover))
                    moved[block] = a[block]
                recoil = np.linalg.solve(terms.mass[:3, :3], -(terms.mass @ moved)[:3])
                expected = terms.mass[joints[2 * i : 2 * i + 2], :3] @ recoil
                found = sources.through[kind][k, 2 * i : 2 * i + 2]
                # Of torques of some 10 Nm, two sums of doubles.
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


def test_ground_gravity_and_velocities_are_mujocos(sources, decomposition):
    joints = motor_coordinates(LEGS)
    for k, terms, _, _, force in planar_states(decomposition):
        take = terms.mass[joints, :3] @ np.linalg.inv(terms.mass[:3, :3])
        ground = take @ (terms.jacobian.T @ force)[:3]
        still = PlanarModel.of(decomposition.cycle.problem)
        q = decomposition.cycle.motion.q.reshape(-1, 15)[k]
        weight = still.terms(q, np.zeros(15)).bias
        for name, expected in (
            ("ground", ground),
            ("gravity", -take @ weight[:3]),
            ("velocities", -take @ (terms.bias - weight)[:3]),
        ):
            np.testing.assert_allclose(
                sources.through[name][k], expected, rtol=0, atol=1e-8
            )


def test_the_torque_on_a_still_trunk_is_mujocos_inverse_dynamics(
    sources, decomposition
):
    """C MuJoCo's inverse dynamics of the same joints' motion with the trunk's
    acceleration set to zero."""
    joints = motor_coordinates(LEGS)
    for k, terms, a, tau, force in planar_states(decomposition):
        held = a.copy()
        held[:3] = 0.0
        needed = (
            terms.mass @ held + terms.bias - terms.passive - terms.jacobian.T @ force
        )
        # The solver's own tolerance on the equations of motion is 1e-8 of 100 Nm.
        np.testing.assert_allclose(sources.fixed[k], needed[joints], rtol=0, atol=1e-5)
        np.testing.assert_allclose(sources.active[k], tau, rtol=0, atol=1e-12)


def test_shares_by_source_add_up_to_what_is_covered(sources, decomposition, account):
    covered = coupling_opposes(decomposition).covered
    assert sum(account.within.values()) == pytest.approx(covered, rel=1e-12)
    trunk = sum(account.within[name] for name in sources.coordinates.trunk)
    assert sum(account.through.values()) == pytest.approx(trunk, abs=1e-9)
    assert sum(sources.covered(sources.within, "knee").values()) == pytest.approx(
        coupling_opposes(decomposition, "knee").covered, rel=1e-12
    )


def test_coupling_is_within_a_leg_and_not_between_legs(account):
    """At 10 m/s knee and spring cover .40 and .39 in the library's trot, other legs
    less than .01 each; coarse optima differ from it by some hundredths."""
    assert min(account.within["other joint"], account.within["spring"]) > 0.3
    assert (
        max(abs(account.through[name]) for name in ("same pair", "other pair")) < 0.05
    )
    for torque in account.torques.values():
        # 2 % in the library's trot
        assert abs(torque.fixed_rms / torque.rms - 1.0) < 0.05


def test_harmonics_are_those_of_a_wave_known_in_closed_form(trot):
    fine = trot.problem.on_mesh(40)
    cycle = whole_cycle(
        dataclasses.replace(
            trot, problem=fine, motion=resample(trot.problem, trot.motion, fine)
        )
    )
    angle = 2.0 * np.pi * cycle.time.ravel() / cycle.period
    low, high = (
        3.0 + 5.0 * np.cos(angle - 0.3) + 2.0 * np.sin(3.0 * angle),
        4.0 * np.cos(7.0 * angle),
    )
    # Simpson's rule on steps of at most 1/260 of the cycle: (11 x 2 pi / 260)^4 / 180 =
    # 3e-5 of the amplitudes.
    np.testing.assert_allclose(keep_harmonics(cycle, low + high, 4), low, atol=1e-3)


def test_low_passed_terms_balance(account, decomposition):
    forces = np.moveaxis(decomposition.forces, 1, -1)
    kept = keep_harmonics(decomposition.cycle, forces, 4)
    assert np.max(np.abs(np.einsum("t,tik->ik", BALANCE, kept))) < 1e-6
    largest = [cut.largest["hind"] for cut in account.cutoffs]
    # the more harmonics, the higher the peak: the toe's ringing
    assert largest == sorted(largest)


def test_left_and_right_are_mirror_images(sources):
    """Half a cycle later the left leg has what the right one had."""
    half = len(sources.trunk) // 2
    for x in (*sources.within.values(), *sources.through.values()):
        right, left = x[:half, [0, 1, 4, 5]], x[half:, [2, 3, 6, 7]]
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-9)


def test_rotors_that_turn_with_their_links_are_in_the_split(trot):
    """What they add to M_i,t a_t is r I_m times the acceleration of the pitch."""
    coupled = dataclasses.replace(
        trot, problem=dataclasses.replace(trot.problem, rotor_coupling=True)
    )
    with_rotors, without = (
        split_planar(decompose(solution)).within["trunk pitch"]
        for solution in (coupled, trot)
    )
    added = with_rotors - without
    pitch = whole_cycle(trot).motion.a.reshape(-1, 15)[:, 2]
    np.testing.assert_allclose(
        added, 2e-4 * 8.5 * pitch[:, None] * np.ones(8), rtol=0, atol=1e-9
    )


def test_half_a_robot_has_no_leg_of_the_same_pair():
    problem = Problem(gait="two-leg", intervals=4)
    guess = cold_guess(problem)
    swinging = dataclasses.replace(guess, a=np.full_like(guess.a, 30.0))
    solution = Solution(
        problem=problem,
        motion=swinging,
        cost=0.0,
        violation=0.0,
        iterations=0,
        seconds=0.0,
    )
    sources = split_planar(decompose(solution))
    assert not np.any(sources.through["same pair"])
    assert np.all(sources.through["other pair"][:, sources.motors("hip")])
