"""Strides whose forces and energies are known."""

import numpy as np

from bp2_rl.paper.benchmarks.mechanism.forces import COORDINATES
from bp2_rl.paper.trajectories.sources import LIMBS, SPATIAL_TERMS, Sources
from bp2_rl.simulation.account import Ledger

STRIDES, N = 4, 400
CAUSES = (
    *("copper", "gears", "joints", "slides", "dampers", "air"),
    *("ground", "stops", "legs"),
)
SAMPLES = 4001  # ms of four cycles a second, and the one that is left out
HIND_KNEES = (8, 11)


def known_forces(legs: float = 0.02) -> Sources:
    """Return forces of four strides in which the spring balances 0.4 of a hip's main
    torque, the knee 0.3, and the leg across `legs`."""
    phase = 2 * np.pi * STRIDES * np.arange(N) / N
    main = np.sin(phase)[:, None] * np.full(8, 100.0)
    nothing = np.zeros((N, 8))
    within = {"other joint": -0.3 * main, "spring": -0.4 * main, "abduction": nothing}
    within |= dict.fromkeys(COORDINATES.trunk, nothing) | {"trunk x": -legs * main}
    through = dict.fromkeys(LIMBS, nothing) | {"same pair": -legs * main}
    coupled = sum(within.values())
    terms = np.zeros((len(SPATIAL_TERMS), N, 22))
    terms[SPATIAL_TERMS.index("main inertial")][:, COORDINATES.motors] = main
    terms[SPATIAL_TERMS.index("coupled inertial")][:, COORDINATES.motors] = coupled
    terms[SPATIAL_TERMS.index("active")] = terms[0] + terms[1]
    terms[SPATIAL_TERMS.index("main inertial"), :, 0] = terms[
        SPATIAL_TERMS.index("ground reaction"), :, 0
    ] = 5.0
    terms[SPATIAL_TERMS.index("gravity"), :, 2] = terms[
        SPATIAL_TERMS.index("ground reaction"), :, 2
    ] = 350.0
    terms[SPATIAL_TERMS.index("centrifugal"), :, 2] = terms[
        SPATIAL_TERMS.index("passive"), :, 2
    ] = -35.0 * np.cos(phase)
    return Sources(COORDINATES, terms, within, through)


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
