"""Self-trapping: how heavy a beam must be for a swing to stay with the pendulum that
has it.

A wide swing is slower than a small one. Where that sets two pendulums further apart in
frequency than the beam couples them, they no longer exchange (`exact.trapping_ratio`).
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import FRONT, INK, WIDTH, styled
from bp2_rl.paper.figures.drawn import DASHES, Drawn, drawn_rows, note
from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, swing
from bp2_rl.paper.pendulum.settings import PendulumTrappingSettings

SAMPLES = 24  # of a natural period
TOLERANCE = 1e-8  # of the integration: what is asked for are means over tens of periods
BRACKET = (0.3, 1.2)  # of the law's mass ratio, in which the measured one is looked for
CANDIDATES = 10  # mass ratios between the ends of a bracket, tried at once
ROUNDS = 2  # of narrowing it, each to an eleventh
# of small swings at the law's mass ratio, in which a swing that ever leaves its
# pendulum has left it
BEATS = 2.0


@dataclasses.dataclass(frozen=True)
class Threshold:
    """Mass ratio above which a swing of an amplitude stays with its pendulum."""

    amplitude: float = metric("Amplitude", "rad", ".3f")
    # the greatest mass ratio at which it was seen to leave its pendulum
    exchanges: float = metric("Still exchanges at R", form=".1f")
    # the least mass ratio at which it was not
    traps: float = metric("Is trapped at R", form=".1f")
    law: float = metric("Law, 32 / A^2", form=".1f")
    off_law: float = metric("Measured / law")  # the middle of the two over the law


def thresholds(amplitudes: Sequence[float]) -> Iterator[Threshold]:
    """Yield for each amplitude the mass ratio above which a swing is trapped, to about
    a percent."""
    for amplitude in amplitudes:
        law = exact.trapping_ratio(amplitude)
        low, high = (share * law for share in BRACKET)
        for _ in range(ROUNDS):
            tried = np.linspace(low, high, CANDIDATES + 2)
            stays = are_trapped(amplitude, tried[1:-1], BEATS * law)
            first = int(np.argmax(np.append(stays, True)))
            low, high = float(tried[first]), float(tried[first + 1])
        yield Threshold(amplitude, low, high, law, (low + high) / 2.0 / law)


def are_trapped(
    amplitude: float, mass_ratios: Float[np.ndarray, " ratios"], periods: float
) -> Bool[np.ndarray, " ratios"]:
    """Return for each mass ratio whether a released pendulum has more energy than the
    other in every natural period.

    Args:
        amplitude: from which it is let go, rad.
        mass_ratios: R of each system.
        periods: how many natural periods are watched.
    """
    time = np.arange(round(periods) * SAMPLES + 1) * (NATURAL_PERIOD / SAMPLES)
    released = np.tile((amplitude, 0.0), (len(mass_ratios), 1))
    energies = swing(released, mass_ratios, time, TOLERANCE).energies.pendulums
    sums = np.cumsum(energies, axis=0)
    of_a_period = sums[SAMPLES:] - sums[:-SAMPLES]
    return np.all(of_a_period[..., 0] > of_a_period[..., 1], axis=0)


def find_trapping(settings: PendulumTrappingSettings) -> Drawn:
    """Draw and tabulate the mass ratio above which a swing stays with its pendulum."""
    found = tuple(thresholds(sorted(settings.thresholds)))
    return drawn_rows("thresholds", found, trapping=trapping_figure(found))


@styled
def trapping_figure(thresholds: Sequence[Threshold]) -> Figure:
    """Draw the mass ratio from which on a swing is trapped, over the amplitude."""
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    axes = figure.subplots()
    amplitudes = [one.amplitude for one in thresholds]
    curve = np.linspace(0.95 * min(amplitudes), 1.03 * max(amplitudes), 200)
    by_law = [exact.trapping_ratio(float(amplitude)) for amplitude in curve]
    axes.plot(curve, by_law, color=INK, linestyle=DASHES, label="law, $32/A^2$")
    middle = [(one.exchanges + one.traps) / 2.0 for one in thresholds]
    axes.plot(amplitudes, middle, "o-", color=FRONT, label="measured: trapped above")
    for at in zip(amplitudes, middle, strict=True):
        note(axes, f"{at[1]:.1f}", at, (0, -14), ha="center")
    axes.set(
        title="From which mass ratio on a swing is trapped",
        yscale="log",
        xlabel="Amplitude A [rad]",
        ylabel="Mass ratio R",
        ylim=(0.45 * min(middle), None),
    )
    axes.legend()
    return figure
