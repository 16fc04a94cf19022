"""What a motion repeats at: its spectrum in units of the cycle's frequency, and how
much of it is odd and even.

A motion that repeats itself after half a cycle with left and right exchanged has even
harmonics alone in everything that is the same on both sides (forward, up, pitch), and
odd ones alone in what changes its sign (sideways, roll, yaw).
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.orbits.sections import sample, whole_cycles

PER_CYCLE = 256  # samples a cycle: beyond the 100th harmonic nothing is looked at


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """The spectrum of one signal; shares are shares of the signal's variance."""

    cycles: int
    peak: float  # the strongest frequency over the cycle's
    even: float  # share at even harmonics
    odd: float  # at odd ones
    between: float  # at neither: what does not repeat
    frequency: Float[np.ndarray, " F"]  # over the cycle's
    power: Float[np.ndarray, " F"]  # share at each

    def leakage(self, wanted: str) -> float:
        """Share of the harmonics' power where a symmetric motion has none; `wanted` is
        `even` or `odd`."""
        right, wrong = (
            (self.even, self.odd) if wanted == "even" else (self.odd, self.even)
        )
        return wrong / (right + wrong) if right + wrong > 0.0 else 0.0


def spectrum(
    signal: Float[np.ndarray, " N"], clock: Float[np.ndarray, " N"]
) -> Spectrum:
    """The spectrum over all whole cycles of a clock that counts them on and on, in its
    own time: no leakage by windows.

    Raises:
        ValueError: there is no whole cycle.
    """
    ends = whole_cycles(clock)
    cycles = len(ends) - 1
    if cycles < 1:
        raise ValueError("a spectrum takes a whole cycle")
    at = np.interp(
        np.arange(cycles * PER_CYCLE) / PER_CYCLE, np.arange(cycles + 1), ends
    )
    values = sample(signal, at)
    lines = np.abs(np.fft.rfft(values - np.mean(values))) ** 2
    lines[1:-1] *= 2.0
    total = float(np.sum(lines))
    power = lines / total if total > 0.0 else lines
    harmonic = power[::cycles]
    even, odd = float(np.sum(harmonic[2::2])), float(np.sum(harmonic[1::2]))
    return Spectrum(
        cycles=cycles,
        peak=float(np.argmax(power)) / cycles,
        even=even,
        odd=odd,
        between=max(float(np.sum(power)) - even - odd, 0.0),
        frequency=np.arange(len(power)) / cycles,
        power=power,
    )
