"""When a free beam lowers the peak torque of two pendulums, and when it raises it: over phase, frequency, amplitude."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.torque import drive, peak

SMALL = 1e-4  # rad: an amplitude at which what is left out of the small-angle law is its square, 1e-8
PHASES = 91  # columns of a map, from 0 to pi: a phase of 2 pi - phi is the same with the pendulums' names exchanged
FREQUENCIES = (0.1, 5.0)  # W of a map's rows
AMPLITUDES = (0.02, 1.5)  # rad likewise
ROWS = 80
SPOTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of pi: phases whose numbers are printed


@dataclasses.dataclass(frozen=True)
class Reduction:
    """One mass ratio in numbers; a ratio is that of the peak torques, beam free over beam fixed."""

    mass_ratio: float
    frequency: float  # W of the map over amplitudes
    boundary: float  # W above which a free beam helps small swings, in closed form
    boundary_measured: tuple[float, float]  # least and greatest over the phases, from the torques
    boundary_error: float  # greatest difference of W^2
    small_swing_error: float
    """greatest difference of the map over frequencies to its closed form, relative where that exceeds 1"""
    phases: tuple[float, ...]  # rad, of the next two
    at_small_amplitude: tuple[float, ...]
    at_one_radian: tuple[float, ...]
    greatest: float  # of the map over amplitudes
    greatest_at: tuple[float, float]  # phase and amplitude, rad
    share_that_helps: float  # of that map's area


@dataclasses.dataclass(frozen=True)
class Maps:
    """The maps of one mass ratio; rows by frequency or amplitude, columns by phase."""

    reduction: Reduction
    phases: Float[np.ndarray, " phases"]  # rad
    frequencies: Float[np.ndarray, " rows"]
    amplitudes: Float[np.ndarray, " rows"]  # rad
    over_frequency: Float[np.ndarray, "rows phases"]  # of small swings
    over_amplitude: Float[np.ndarray, "rows phases"]


def peak_ratio(
    phase: Float[np.ndarray, "*#many"],
    amplitude: Float[np.ndarray, "*#many"],
    frequency: Float[np.ndarray, "*#many"],
    mass_ratio: Float[np.ndarray, "*#many"],
) -> Float[np.ndarray, "*many"]:
    """Return the greater peak torque of two pendulums a phase apart, beam free over beam fixed."""
    cycle = drive(np.stack(np.broadcast_arrays(0.0, phase), axis=-1), amplitude, frequency, mass_ratio)
    return np.asarray(np.max(peak(cycle.free), axis=-1) / np.max(peak(cycle.fixed), axis=-1))


def reduction_maps(mass_ratio: float, frequency: float) -> Maps:
    """Both maps of one mass ratio; `frequency` is the W of the one over amplitudes."""
    phases = np.linspace(0.0, np.pi, PHASES)
    frequencies, amplitudes = (_between(*ends) for ends in (FREQUENCIES, AMPLITUDES))
    ratio = np.array(mass_ratio)
    over_frequency = peak_ratio(phases, np.array(SMALL), frequencies[:, None], ratio)
    over_amplitude = peak_ratio(phases, amplitudes[:, None], np.array(frequency), ratio)
    law = exact.small_torque_ratio(phases, frequencies[:, None], ratio)
    measured = [_boundary(phase, mass_ratio) for phase in phases[:-1:10]]
    boundary = exact.boundary_frequency(mass_ratio)
    row, column = np.unravel_index(np.argmax(over_amplitude), over_amplitude.shape)
    spots = np.pi * np.array(SPOTS)
    small, wide = (peak_ratio(spots, np.array(amplitude), np.array(frequency), ratio) for amplitude in (SMALL, 1.0))
    reduction = Reduction(
        mass_ratio=mass_ratio,
        frequency=frequency,
        boundary=boundary,
        boundary_measured=(min(measured), max(measured)),
        boundary_error=max(abs(w**2 - boundary**2) for w in measured),
        small_swing_error=float(np.max(np.abs(over_frequency - law) / np.maximum(law, 1.0))),
        phases=tuple(map(float, spots)),
        at_small_amplitude=tuple(map(float, small)),
        at_one_radian=tuple(map(float, wide)),
        greatest=float(over_amplitude[row, column]),
        greatest_at=(float(phases[column]), float(amplitudes[row])),
        share_that_helps=float(np.mean(over_amplitude[:, :-1] < 1.0)),  # in antiphase there is nothing to gain
    )
    return Maps(reduction, phases, frequencies, amplitudes, over_frequency, over_amplitude)


def _between(low: float, high: float) -> Float[np.ndarray, " rows"]:
    """Centres of equal intervals: so none is at W = 1, where the ratio has a pole."""
    return low + (np.arange(ROWS) + 0.5) * ((high - low) / ROWS)


def _boundary(phase: float, mass_ratio: float) -> float:
    """The W at which a free beam makes no difference to small swings a phase apart, from their torques."""

    def gain(frequency: float) -> float:
        return float(peak_ratio(*map(np.array, (phase, SMALL, frequency, mass_ratio)))) - 1.0

    # W^2 is between 1 + 1 / (R + 1), the least being the pole at 1, and 2.
    return float(np.asarray(brentq(gain, 1.0 + 1e-3 / (1.0 + mass_ratio), math.sqrt(2.0), xtol=1e-12)))
