"""Strides whose forces and energies are known."""

import numpy as np

from bp2_rl.paper.benchmarks.mechanism.forces import (
    HIPS_AND_KNEES,
    TERMS,
    THROUGH,
    WITHIN,
    Forces,
)
from bp2_rl.simulation.account import CAUSES, Ledger

STRIDES, N = 4, 400
SAMPLES = 4001  # ms of four cycles a second, and the one that is left out
HIND_KNEES = (8, 11)


def known_forces(legs: float = 0.02) -> Forces:
    """Return forces of four strides in which the spring balances 0.4 of a hip's main
    torque, the knee 0.3, and the leg across `legs`."""
    phase = 2 * np.pi * STRIDES * np.arange(N) / N
    main = np.sin(phase)[:, None] * np.full(8, 100.0)
    within, through = np.zeros((len(WITHIN), N, 8)), np.zeros((len(THROUGH), N, 8))
    within[WITHIN.index("spring")] = -0.4 * main
    within[WITHIN.index("other joint")] = -0.3 * main
    within[WITHIN.index("trunk x")] = through[THROUGH.index("same pair")] = -legs * main
    terms = np.zeros((len(TERMS), N, 22))
    terms[TERMS.index("main inertial")][:, HIPS_AND_KNEES] = main
    terms[TERMS.index("coupled inertial")][:, HIPS_AND_KNEES] = np.sum(within, axis=0)
    terms[TERMS.index("active")] = terms[0] + terms[1]
    terms[TERMS.index("main inertial"), :, 0] = terms[
        TERMS.index("ground reaction"), :, 0
    ] = 5.0
    terms[TERMS.index("gravity"), :, 2] = terms[
        TERMS.index("ground reaction"), :, 2
    ] = 350.0
    terms[TERMS.index("centrifugal"), :, 2] = terms[TERMS.index("passive"), :, 2] = (
        -35.0 * np.cos(phase)
    )
    return Forces(terms, within, through)


def known_ledger(amplitude: float = 300.0) -> Ledger:
    """Return the energy ledger of hind knees that drive and brake like a sine and heat
    by 50 W each; springs likewise."""
    sine = np.sin(2 * np.pi * 4.0 * 1e-3 * np.arange(SAMPLES))
    motors, copper = np.zeros((SAMPLES, 12)), np.zeros((SAMPLES, 12))
    motors[:, HIND_KNEES] = (amplitude * sine + 20.0)[:, None]
    copper[:, HIND_KNEES] = 50.0
    lost = {cause: np.zeros(SAMPLES) for cause in CAUSES} | {
        "copper": np.full(SAMPLES, 100.0),
        "air": np.full(SAMPLES, 40.0),
    }
    bus = np.sum(motors + copper, axis=1)
    stored = bus - 140.0
    energy = np.concatenate([[0.0], np.cumsum(stored[:-1]) * 1e-3])
    springs = np.repeat(200.0 * sine[:, None], 4, axis=1)
    return Ledger(bus, lost, stored, energy, motors, copper, springs)
