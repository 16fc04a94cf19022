"""Forces in three dimensions: they add up, and are what other algorithms of MuJoCo's
find."""

import mujoco
import numpy as np
import pytest

from bp2_rl.paper.benchmarks.mechanism.forces import (
    COORDINATES,
    closure,
    decompose_run,
)
from bp2_rl.paper.trajectories.sources import SPATIAL_TERMS, split_sources
from bp2_rl.robot import losses
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import NV, load_model
from bp2_rl.simulation.simulator import CONVERGED

SAMPLES = 40
TRUNK = slice(0, 6)
# abad, hip, knee, spring
OF_LEG = tuple(slice(6 + 4 * leg, 10 + 4 * leg) for leg in range(4))
HIPS_AND_KNEES = np.array([6 + 4 * leg + joint for leg in range(4) for joint in (1, 2)])


@pytest.fixture(scope="module")
def model():
    model = load_model(BUILT, visual=False)
    CONVERGED.apply(model)
    return model


@pytest.fixture(scope="module")
def run(model):
    """Return the run of a robot that kicks on the ground, stepped by MuJoCo, with every
    loss of the built robot."""
    from synthetic import make_run

    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    rng = np.random.default_rng(0)
    data.qvel[:] = rng.normal(size=NV)
    data.qvel[0] += 5.0
    data.qpos[9] = model.joint("FR_knee").range[0] - 0.01  # on its stop
    qpos, qvel, torque = (
        np.zeros((SAMPLES, 23)),
        np.zeros((SAMPLES, NV)),
        np.zeros((SAMPLES, 12)),
    )
    for k in range(SAMPLES):
        torque[k] = 60.0 * np.sin(0.2 * k + np.arange(12))
        qpos[k], qvel[k], data.ctrl[:] = data.qpos, data.qvel, torque[k]
        data.qfrc_applied[:] = _lost(data.qpos, data.qvel, torque[k])
        mujoco.mj_step(model, data)
    long = make_run(duration=1.0)
    return type(long)(
        **{
            **{
                name: getattr(long, name)[:SAMPLES]
                for name in ("time", "target", "command", "foot_force")
            },
            **{
                name: getattr(long, name)
                for name in ("steady_from", "fell_at", "mass", "name", "backend")
            },
            "dt": model.opt.timestep,
            "hardware": BUILT,
            "qpos": qpos,
            "qvel": qvel,
            "torque": torque,
        }
    )


@pytest.fixture(scope="module")
def forces(run):
    return decompose_run(run)


def _lost(qpos, qvel, torque):
    resistance = Resistance.from_hardware(BUILT)
    assert resistance is not None
    return losses.generalized(losses.loss(resistance, qpos, qvel, torque), qvel)


def at(model, run, k):
    """Return MuJoCo's data at a sample of the run."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = run.qpos[k], run.qvel[k], run.torque[k]
    data.qfrc_applied[:] = _lost(run.qpos[k], run.qvel[k], run.torque[k])
    mujoco.mj_forward(model, data)
    return data


def test_terms_and_sources_add_up_in_every_millisecond(forces):
    # The solver is done at 1e-10 of its scaled residual; what is left is rounding.
    assert np.all(closure(forces) < 1e-9)
    for term in SPATIAL_TERMS:
        assert np.any(forces.terms[SPATIAL_TERMS.index(term)]), term


def test_inertial_forces_are_those_of_the_motion_that_followed(model, run, forces):
    """M dv/dt of the recorded velocities; Euler's method takes dampers implicitly, at
    the velocity after the step."""
    change = np.diff(run.qvel, axis=0)
    for k in range(SAMPLES - 1):
        data, momentum = at(model, run, k), np.zeros(NV)
        mujoco.mj_mulM(model, data, momentum, change[k] / run.dt)
        inertial = forces.terms[0, k] + forces.terms[1, k]
        # Warm starts of the solver differ, hence its tolerance and not rounding.
        np.testing.assert_allclose(
            momentum + model.dof_damping * change[k],
            inertial,
            atol=1e-5 * np.max(np.abs(inertial)),
        )


def test_velocity_forces_change_the_kinetic_energy_of_constant_velocities(
    model, run, forces
):
    """v . C is half of v . dM/dt v, whatever coordinates turn with the body."""
    for k in range(0, SAMPLES, 7):
        energy, step, M, data = [], 1e-6, np.zeros((NV, NV)), mujoco.MjData(model)
        for side in (-step, step):
            data.qpos[:] = run.qpos[k]
            mujoco.mj_integratePos(model, data.qpos, run.qvel[k], side)
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, M)
            energy.append(0.5 * run.qvel[k] @ M @ run.qvel[k])
        C = (
            forces.terms[SPATIAL_TERMS.index("centrifugal"), k]
            + forces.terms[SPATIAL_TERMS.index("Coriolis"), k]
        )
        # A central difference over 1 us: 1e-6 of the energy's size over the step.
        assert run.qvel[k] @ C == pytest.approx(
            (energy[1] - energy[0]) / (2 * step), rel=1e-5, abs=1e-3
        )


def test_the_torque_on_a_still_trunk_is_that_of_inverse_dynamics(model, run, forces):
    """Newton and Euler's recursion with the trunk's acceleration taken away, which
    knows no mass matrix."""
    for k in range(0, SAMPLES, 7):
        data, needed = at(model, run, k), np.zeros(NV)
        data.qacc[TRUNK] = 0.0
        mujoco.mj_rne(model, data, 1, needed)
        needed += model.dof_armature * data.qacc  # which the recursion leaves out
        given = sum(
            forces.terms[SPATIAL_TERMS.index(name), k]
            for name in ("passive", "ground reaction", "stops")
        )
        np.testing.assert_allclose(
            forces.fixed[k], (needed - given)[HIPS_AND_KNEES], atol=1e-6
        )


def test_the_mass_matrix_joins_no_two_legs(model, run):
    M = np.zeros((NV, NV))
    mujoco.mj_fullM(model, at(model, run, 5), M)
    for one in OF_LEG:
        for other in OF_LEG:
            assert one == other or not np.any(M[one, other])


@pytest.mark.parametrize(
    ("source", "name"),
    [(0, "own leg"), (3, "same pair"), (1, "other pair"), (2, "other pair")],
)
def test_what_one_leg_does_to_another_has_the_name_of_their_relation(
    model, run, source, name
):
    """Nothing is accelerated but one leg, and the trunk by it; looked at is FR's
    hip."""
    M, a = np.zeros((NV, NV)), np.zeros(NV)
    mujoco.mj_fullM(model, at(model, run, 5), M)
    a[OF_LEG[source]] = (3.0, -20.0, 40.0, 5.0)
    a[TRUNK] = -np.linalg.solve(
        M[TRUNK, TRUNK], M[TRUNK, OF_LEG[source]] @ a[OF_LEG[source]]
    )
    terms = np.zeros((len(SPATIAL_TERMS), 1, NV))
    found = split_sources(COORDINATES, M[None], a[None], terms)
    hip = {name: part[0, 0] for name, part in found.through.items()}
    assert abs(hip[name]) > 1e-3
    assert hip[name] == pytest.approx(M[7, TRUNK] @ a[TRUNK])
    assert np.count_nonzero(list(hip.values())) == 1
    assert found.trunk[0, 0] == pytest.approx(M[7, TRUNK] @ a[TRUNK])
