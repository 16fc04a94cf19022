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

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, swing
from bp2_rl.paper.pendulum.settings import PendulumTrappingSettings
from bp2_rl.paper.pendulum.study import BEAM, ONE, TWO, PendulumStudy, numbered

MASS_RATIOS = (0.25, 200.0)  # of a sweep
SAMPLES = 24  # of a natural period
TOLERANCE = 1e-8  # of the integration: what is asked for are means over tens of periods
BRACKET = (0.3, 1.2)  # of the law's mass ratio, in which the measured one is looked for
CANDIDATES = 10  # mass ratios between the ends of a bracket, tried at once
ROUNDS = 2  # of narrowing it, each to an eleventh
# of small swings at the law's mass ratio, in which a swing that ever leaves its
# pendulum has left it
BEATS = 2.0
TICKS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # of the mass ratio


@dataclasses.dataclass(frozen=True)
class Sweep:
    """One release over mass ratios; shares of the energy, as seen from the ground."""

    amplitude: float  # rad
    law: float  # the mass ratio from which on a swing is trapped, by 32 / A^2
    mass_ratio: tuple[float, ...]
    mean: tuple[tuple[float, float], ...]  # long average of each pendulum
    mean_beam: tuple[float, ...]
    # of the pendulum that hung: the greatest mean over a natural period
    greatest: tuple[float, ...]
    # whether the pendulum that was let go has more than the other in every natural
    # period
    trapped: tuple[bool, ...]


@dataclasses.dataclass(frozen=True)
class Threshold:
    """From which mass ratio on a swing of one amplitude is trapped."""

    amplitude: float  # rad
    law: float  # 32 / A^2
    # the greatest mass ratio at which it was seen to leave its pendulum
    exchanges: float
    traps: float  # and the least at which it was not
    off_law: float  # the middle of the two over the law


def sweep_ratios(
    amplitude: float, mass_ratios: Float[np.ndarray, " ratios"], periods: float
) -> Sweep:
    """Let one of two pendulums go and watch for so many natural periods, for each mass
    ratio."""
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
            stays = _stays(
                _period_means(_shares(amplitude, tried[1:-1], BEATS * law)[0])
            )
            first = int(np.argmax(np.append(stays, True)))
            low, high = float(tried[first]), float(tried[first + 1])
        yield Threshold(amplitude, law, low, high, (low + high) / 2.0 / law)


def _shares(
    amplitude: float, mass_ratios: Float[np.ndarray, " ratios"], periods: float
) -> tuple[Float[np.ndarray, "samples ratios 2"], Float[np.ndarray, "samples ratios"]]:
    """Return the shares of the energy over time: each pendulum's, and the beam's."""
    time = np.arange(round(periods) * SAMPLES + 1) * (NATURAL_PERIOD / SAMPLES)
    motion = swing(
        np.tile((amplitude, 0.0), (len(mass_ratios), 1)), mass_ratios, time, TOLERANCE
    )
    energies = motion.energies
    total = 1.0 - np.cos(amplitude)
    return energies.pendulums / total, energies.beam / total


def _period_means(
    shares: Float[np.ndarray, "samples ratios 2"],
) -> Float[np.ndarray, "windows ratios 2"]:
    """Over every natural period."""
    sums = np.cumsum(shares, axis=0)
    return (sums[SAMPLES:] - sums[:-SAMPLES]) / SAMPLES


def _stays(means: Float[np.ndarray, "windows ratios 2"]) -> Bool[np.ndarray, " ratios"]:
    return np.all(means[..., 0] > means[..., 1], axis=0)


def find_trapping(settings: PendulumTrappingSettings) -> PendulumStudy:
    """Study from which mass ratio on a swing stays with its pendulum."""
    ratios = np.geomspace(*MASS_RATIOS, settings.points)
    sweeps = [
        sweep_ratios(amplitude, ratios, settings.periods)
        for amplitude in settings.amplitude
    ]
    found = list(thresholds(sorted(settings.thresholds)))
    rows = [
        (
            f"{one.amplitude:.3f}",
            *(f"{x:.1f}" for x in (one.exchanges, one.traps, one.law)),
            f"{one.off_law:.2f}",
        )
        for one in found
    ]
    columns = (
        "amplitude, rad",
        "still exchanges at R",
        "is trapped at R",
        "law, 32 / A^2",
        "measured / law",
    )
    arrays = {"mass_ratio": ratios} | numbered(
        {"mean": one.mean, "mean_beam": one.mean_beam, "greatest": one.greatest}
        for one in sweeps
    )
    return PendulumStudy(
        columns,
        rows,
        {"sweeps": sweeps, "thresholds": found},
        arrays,
        trapping_figure(sweeps, found),
    )


@styled
def trapping_figure(sweeps: Sequence[Sweep], thresholds: Sequence[Threshold]) -> Figure:
    """Long averages over the mass ratio, a panel for each amplitude; last, the
    threshold over the amplitude."""
    count = len(sweeps) + bool(thresholds)
    figure = Figure(figsize=(WIDTH, 0.7 + 2.5 * count), layout="constrained")
    panels = figure.subplots(count, 1, squeeze=False).ravel().tolist()
    for letter, sweep, axes in zip("ABCD", sweeps, panels, strict=False):
        for pendulum, (color, label) in enumerate(
            ((ONE, "mean of 1, let go"), (TWO, "mean of 2"))
        ):
            values = [mean[pendulum] for mean in sweep.mean]
            axes.plot(sweep.mass_ratio, values, "o-", ms=3.5, color=color, label=label)
        axes.plot(
            sweep.mass_ratio,
            sweep.mean_beam,
            "o-",
            ms=3.5,
            color=BEAM,
            label="mean of the beam",
        )
        axes.plot(
            sweep.mass_ratio,
            sweep.greatest,
            "o",
            ms=4,
            mfc="none",
            color=TWO,
            label="most that 2 has in a $T_0$",
        )
        curve = np.geomspace(sweep.mass_ratio[0], sweep.mass_ratio[-1], 200)
        small = np.array([exact.shares(ratio) for ratio in curve])
        for column in (0, 1):
            label = "small swings, exact" if column == 0 else None
            axes.plot(
                curve,
                small[:, column],
                color=QUIET,
                linewidth=1.0,
                linestyle=(0, (1, 1.5)),
                label=label,
            )
        axes.axvline(
            sweep.law,
            color=INK,
            linewidth=1.0,
            linestyle=(0, (4, 2)),
            label="law, $32/A^2$",
        )
        for one in thresholds:
            if one.amplitude == sweep.amplitude:
                axes.axvline(
                    (one.exchanges + one.traps) / 2.0,
                    color=INK,
                    linewidth=1.2,
                    label="trapped from here on",
                )
        axes.set(
            xscale="log",
            ylim=(-0.03, 1.05),
            ylabel="Share of the energy",
            xlabel="Mass ratio R",
        )
        axes.set_title(f"{letter}   Let go at {sweep.amplitude:.3g} rad")
        axes.set_xticks(TICKS, labels=[f"{tick:g}" for tick in TICKS])
        axes.minorticks_off()
        axes.set_xlim(0.22, 225.0)
        if axes is panels[0]:
            figure.legend(
                *axes.get_legend_handles_labels(), loc="outside upper center", ncols=3
            )
    if thresholds:
        axes = panels[-1]
        amplitudes = [one.amplitude for one in thresholds]
        curve = np.linspace(0.95 * min(amplitudes), 1.03 * max(amplitudes), 200)
        axes.plot(
            curve,
            32.0 / curve**2,
            color=INK,
            linewidth=1.0,
            linestyle=(0, (4, 2)),
            label="law, $32/A^2$",
        )
        middle = np.array([(one.exchanges + one.traps) / 2.0 for one in thresholds])
        axes.plot(amplitudes, middle, "o-", color=ONE, label="measured")
        for at in zip(amplitudes, middle, strict=True):
            axes.annotate(
                f"{at[1]:.1f}",
                at,
                (0, -14),
                textcoords="offset points",
                ha="center",
                fontsize=8.5,
            )
        axes.set(
            yscale="log",
            xlabel="Amplitude A [rad]",
            ylabel="Mass ratio R",
            ylim=(0.45 * middle.min(), None),
        )
        axes.set_title(
            f"{'ABCDE'[len(sweeps)]}   From which mass ratio on a swing is trapped"
        )
        axes.annotate("trapped", (0.75, 0.82), xycoords="axes fraction", color=QUIET)
        axes.annotate("exchanged", (0.12, 0.15), xycoords="axes fraction", color=QUIET)
        axes.set_yticks([10, 20, 50, 100, 200], labels=["10", "20", "50", "100", "200"])
        axes.minorticks_off()
        axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.75))
    return figure
