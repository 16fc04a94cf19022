"""Self-trapping: how heavy a beam must be for a swing to stay with the pendulum that has it.

A wide swing is slower than a small one. Where that sets two pendulums further apart in frequency than the beam couples
them, they no longer exchange (`exact.trapping_ratio`).
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.swing import NATURAL_PERIOD, swing

MASS_RATIOS = (0.25, 200.0)  # of a sweep
SAMPLES = 24  # of a natural period
TOLERANCE = 1e-8  # of the integration: what is asked for are means over tens of periods
BRACKET = (0.3, 1.2)  # of the law's mass ratio, in which the measured one is looked for
CANDIDATES = 10  # mass ratios between the ends of a bracket, tried at once
ROUNDS = 2  # of narrowing it, each to an eleventh
BEATS = 2.0  # of small swings at the law's mass ratio, in which a swing that ever leaves its pendulum has left it


@dataclasses.dataclass(frozen=True)
class Sweep:
    """One release over mass ratios; shares of the energy, as seen from the ground."""

    amplitude: float  # rad
    law: float  # the mass ratio from which on a swing is trapped, by 32 / A^2
    mass_ratio: tuple[float, ...]
    mean: tuple[tuple[float, float], ...]  # long average of each pendulum
    mean_beam: tuple[float, ...]
    greatest: tuple[float, ...]  # of the pendulum that hung: the greatest mean over a natural period
    trapped: tuple[bool, ...]  # whether the pendulum that was let go has more than the other in every natural period


@dataclasses.dataclass(frozen=True)
class Threshold:
    """From which mass ratio on a swing of one amplitude is trapped."""

    amplitude: float  # rad
    law: float  # 32 / A^2
    exchanges: float  # the greatest mass ratio at which it was seen to leave its pendulum
    traps: float  # and the least at which it was not
    off_law: float  # the middle of the two over the law


def sweep_ratios(amplitude: float, mass_ratios: Float[np.ndarray, " ratios"], periods: float) -> Sweep:
    """Let one of two pendulums go and watch for so many natural periods, for each mass ratio."""
    shares, beam = _shares(amplitude, mass_ratios, periods)
    means = _period_means(shares)
    return Sweep(
        amplitude=amplitude,
        law=exact.trapping_ratio(amplitude),
        mass_ratio=tuple(map(float, mass_ratios)),
        mean=tuple((float(one), float(two)) for one, two in shares.mean(axis=0)),
        mean_beam=tuple(map(float, beam.mean(axis=0))),
        greatest=tuple(map(float, means[..., 1].max(axis=0))),
        trapped=tuple(map(bool, _stays(means))),
    )


def thresholds(amplitudes: Sequence[float]) -> Iterator[Threshold]:
    """The threshold of each amplitude, between mass ratios a percent apart."""
    for amplitude in amplitudes:
        law = exact.trapping_ratio(amplitude)
        low, high = (share * law for share in BRACKET)
        for _ in range(ROUNDS):
            tried = np.linspace(low, high, CANDIDATES + 2)
            stays = _stays(_period_means(_shares(amplitude, tried[1:-1], BEATS * law)[0]))
            first = int(np.argmax(np.append(stays, True)))
            low, high = float(tried[first]), float(tried[first + 1])
        yield Threshold(amplitude, law, low, high, (low + high) / 2.0 / law)


def _shares(
    amplitude: float, mass_ratios: Float[np.ndarray, " ratios"], periods: float
) -> tuple[Float[np.ndarray, "samples ratios 2"], Float[np.ndarray, "samples ratios"]]:
    """Return the shares of the energy over time: each pendulum's, and the beam's."""
    time = np.arange(round(periods) * SAMPLES + 1) * (NATURAL_PERIOD / SAMPLES)
    motion = swing(np.tile((amplitude, 0.0), (len(mass_ratios), 1)), mass_ratios, time, TOLERANCE)
    energies = motion.energies
    total = 1.0 - np.cos(amplitude)
    return energies.pendulums / total, energies.beam / total


def _period_means(shares: Float[np.ndarray, "samples ratios 2"]) -> Float[np.ndarray, "windows ratios 2"]:
    """Over every natural period."""
    sums = np.cumsum(shares, axis=0)
    return (sums[SAMPLES:] - sums[:-SAMPLES]) / SAMPLES


def _stays(means: Float[np.ndarray, "windows ratios 2"]) -> Bool[np.ndarray, " ratios"]:
    return np.all(means[..., 0] > means[..., 1], axis=0)
