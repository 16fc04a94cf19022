"""The pendulums' equations of motion, against C MuJoCo and against the balances of work
and momentum."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import quad

from bp2_rl.paper.pendulum import beam
from bp2_rl.paper.pendulum.torque import drive

LIGHT = 1e-9  # kg m2 of a point mass, which MuJoCo wants: its share of m l^2 is as much


def in_mujoco(mass_ratio: float, pendulums: int) -> mujoco.MjModel:
    """Return MuJoCo's model of point masses of 1 kg on rods of 1 m, hung from a beam
    that slides along x, in a gravity of 1 m/s2: w0 is 1."""
    hung = "".join(
        f"""<body pos="0 {k} 0"><joint type="hinge" axis="0 -1 0"/>
        <inertial pos="0 0 -1" mass="1" diaginertia="{LIGHT} {LIGHT} {LIGHT}"/></body>"""
        for k in range(pendulums)
    )
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 -1"/><worldbody><body><joint type="slide" axis="1 0 0"/>
        <inertial pos="0 0 0" mass="{mass_ratio}" diaginertia="1 1 1"/>{hung}</body></worldbody></mujoco>"""
    )


@pytest.mark.parametrize(("mass_ratio", "pendulums"), [(1.0, 2), (0.3, 2), (8.8, 4)])
def test_accelerations_and_energies_are_mujocos(mass_ratio: float, pendulums: int):
    model, rng = in_mujoco(mass_ratio, pendulums), np.random.default_rng(0)
    data = mujoco.MjData(model)
    for _ in range(20):
        theta, rate, torque = rng.normal(size=(3, pendulums))
        beam_rate = rng.normal()
        data.qpos[1:], data.qvel[:], data.qfrc_applied[1:] = (
            theta,
            [beam_rate, *rate],
            torque,
        )
        mujoco.mj_forward(model, data)
        ours = beam.accelerations(theta, rate, torque, np.array(mass_ratio))
        # The inertia that MuJoCo asks a point mass to have.
        np.testing.assert_allclose(np.append(*ours), data.qacc, atol=1e-6)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        energies = beam.energies(theta, rate, np.array(beam_rate), np.array(mass_ratio))
        hanging = -pendulums  # MuJoCo counts heights from the beam
        assert energies.pendulums.sum() + energies.beam == pytest.approx(
            data.energy.sum() - hanging, abs=1e-6
        )


def test_the_torque_of_a_motion_makes_that_motion():
    rng = np.random.default_rng(1)
    theta, rate, acceleration = rng.normal(size=(3, 5, 3))
    mass_ratio = np.array([0.1, 1.0, 2.0, 9.0, 1e3])
    torque = beam.fixed_torque(theta, acceleration) + beam.coupled_torque(
        theta, rate, acceleration, mass_ratio
    )
    np.testing.assert_allclose(
        beam.accelerations(theta, rate, torque, mass_ratio)[1], acceleration, atol=1e-11
    )


def test_what_the_motors_put_in_is_what_the_energy_grows_by():
    phase, amplitude, frequency, mass_ratio = (
        np.array([0.0, 0.7]),
        np.array(1.1),
        np.array(2.3),
        np.array(1.5),
    )

    def at(angle: float) -> tuple[float, float]:
        """Energy, and power over W, where the first pendulum's phase is `angle`; the
        momentum is zero."""
        cycle = drive(phase + angle, amplitude, frequency, mass_ratio)
        theta, rate = cycle.theta[0], cycle.rate[0]
        beam_rate = np.array(-np.sum(np.cos(theta) * rate) / (mass_ratio + 2.0))
        assert beam.momentum(theta, rate, beam_rate, mass_ratio) == pytest.approx(
            0.0, abs=1e-14
        )
        energies = beam.energies(theta, rate, beam_rate, mass_ratio)
        return float(energies.pendulums.sum() + energies.beam), float(
            np.sum(cycle.free[0] * rate) / frequency
        )

    for end in (0.5, 2.0, 5.0):
        work = quad(lambda angle: at(angle)[1], 0.0, end, epsabs=1e-11)[0]
        assert at(end)[0] - at(0.0)[0] == pytest.approx(work, abs=1e-9)


def test_legs_that_move_as_pairs_are_pendulums_on_a_beam_half_as_heavy():
    theta, rate, acceleration = np.random.default_rng(2).normal(size=(3, 2))
    legs = [np.repeat(values, 2) for values in (theta, rate, acceleration)]
    four = beam.coupled_torque(legs[0], legs[1], legs[2], np.array(8.8))
    two = beam.coupled_torque(theta, rate, acceleration, np.array(4.4))
    np.testing.assert_allclose(four, np.repeat(two, 2), rtol=1e-13)
