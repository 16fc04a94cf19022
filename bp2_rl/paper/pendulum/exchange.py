"""How two pendulums share a swing: one is let go, the other hangs (paper, Fig. 3 C)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.integrate import cumulative_simpson

from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import FAINT, FALL, FRONT, INK, LEG_COLORS, WIDTH, styled
from bp2_rl.paper.figures.drawn import (
    DASHES,
    Drawn,
    drawn_rows,
    joined,
    legend_above_panels,
    remark,
)
from bp2_rl.paper.pendulum import beam
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, SwingMotion, swing
from bp2_rl.paper.pendulum.settings import PendulumExchangeSettings

SAMPLES = 100  # of a natural period
EVEN = 0.05  # of m g l: means that differ by less are called even
PAPER_PERIODS = 6.0
PAPER_MEAN = 0.25
"""Mean energy of a pendulum in the paper: "near-equipartition, about 0.25, within
roughly six natural periods"."""
COLORS = {"pendulum 1": FRONT, "pendulum 2": FALL, "beam": LEG_COLORS["RR"]}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sharing:
    """The exchange of energy at a mass ratio. Energies in m g l, times in T0."""

    mass_ratio: float = metric("R", form="g")
    energy: float  # of the release
    # of each pendulum since the release, as seen from the ground
    mean: tuple[float, float] = metric("Means of 1 / 2", "m g l", joined(".3f"))
    mean_beam: float = metric("Of the beam", form=".3f")
    mean_in_beam_frame: tuple[float, float] = metric(
        "Seen from the beam", form=joined(".3f")
    )
    even_after: float | None = metric(f"Within {EVEN:g} after", "T0", ".1f")
    energy_drift: float = metric("Drift of E", form=".0e")
    momentum_drift: float = metric("Drift of p", form=".0e")


@dataclasses.dataclass(frozen=True)
class Exchange:
    """Energies of two pendulums and their beam over time, at one mass ratio."""

    sharing: Sharing
    time: Float[np.ndarray, " samples"]  # in T0
    energies: beam.Energies
    means: beam.Energies  # from the release to each time


def exchanges(
    amplitude: float, mass_ratios: Sequence[float], periods: float
) -> list[Exchange]:
    """Return the energies of two pendulums after one is released at `amplitude`, for
    each mass ratio."""
    time = np.linspace(0.0, periods * NATURAL_PERIOD, round(periods * SAMPLES) + 1)
    motion = swing(
        np.tile((amplitude, 0.0), (len(mass_ratios), 1)), np.array(mass_ratios), time
    )
    return [_exchange(motion, system) for system in range(len(mass_ratios))]


def _exchange(motion: SwingMotion, system: int) -> Exchange:
    """Return the energies in a single system of pendulums, by its index among
    several."""
    time = motion.time
    mass_ratio = motion.mass_ratio[system]
    state = (
        motion.theta[:, system],
        motion.rate[:, system],
        motion.beam_rate[:, system],
        mass_ratio[None],
    )
    energies = beam.energies(*state)
    momentum = beam.momentum(*state)
    means = beam.Energies(*(_running_mean(time, part) for part in energies))
    kept = energies.pendulums.sum(axis=-1) + energies.beam
    uneven = np.flatnonzero(
        np.abs(means.pendulums[:, 0] - means.pendulums[:, 1]) >= EVEN
    )
    last = int(uneven[-1]) if len(uneven) else 0
    sharing = Sharing(
        mass_ratio=float(mass_ratio),
        energy=float(kept[0]),
        mean=_pair(means.pendulums[-1]),
        mean_beam=float(means.beam[-1]),
        mean_in_beam_frame=_pair(means.beam_frame[-1]),
        even_after=None
        if last == len(time) - 1
        else float(time[last] / NATURAL_PERIOD),
        energy_drift=float(np.max(np.abs(kept - kept[0]))),
        momentum_drift=float(np.max(np.abs(momentum))),
    )
    return Exchange(sharing, time / NATURAL_PERIOD, energies, means)


def _running_mean(
    time: Float[np.ndarray, " samples"], values: Float[np.ndarray, "samples ..."]
) -> Float[np.ndarray, "samples ..."]:
    """Return the mean of `values` from the release to each time; at the release, the
    value."""
    so_far = time[1:].reshape(-1, *(1,) * (values.ndim - 1))
    return np.concatenate(
        (values[:1], cumulative_simpson(values, x=time, axis=0) / so_far)
    )


def _pair(values: Float[np.ndarray, " 2"]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def study_exchange(settings: PendulumExchangeSettings) -> Drawn:
    """Draw and tabulate how evenly two pendulums share the energy after one is
    released."""
    runs = exchanges(settings.amplitude, settings.mass_ratio, settings.periods)
    rows = tuple(run.sharing for run in runs)
    return drawn_rows("mass_ratios", rows, exchange=exchange_figure(runs))


@styled
def exchange_figure(runs: Sequence[Exchange]) -> Figure:
    """Draw energies and their means since the release, as seen from the ground (paper,
    Fig. 3 C); a row for each mass ratio."""
    figure = Figure(figsize=(WIDTH, 1.5 + 1.9 * len(runs)), layout="constrained")
    panels = figure.subplots(len(runs), 1, sharex=True, sharey=True, squeeze=False)
    paper = f"paper: {PAPER_MEAN:g} within {PAPER_PERIODS:g} periods"
    for run, axes in zip(runs, panels[:, 0], strict=True):
        one = run.sharing
        axes.axvspan(0.0, PAPER_PERIODS, color=FAINT, alpha=0.7, linewidth=0)
        axes.axhline(PAPER_MEAN, color=INK, linestyle=DASHES, label=paper)
        energies = *run.energies.pendulums.T, run.energies.beam
        means = *run.means.pendulums.T, run.means.beam
        for energy, mean, (label, color) in zip(
            energies, means, COLORS.items(), strict=True
        ):
            axes.plot(run.time, energy, color=color, linewidth=0.6, alpha=0.35)
            axes.plot(run.time, mean, color=color, linewidth=2.0, label=label)
        even = (
            "never even"
            if one.even_after is None
            else f"even after {one.even_after:.1f} $T_0$"
        )
        remark(
            axes,
            f"means {joined('.3f')(one.mean)}, beam {one.mean_beam:.3f}\n{even}",
        )
        axes.set(title=f"R = {one.mass_ratio:g}", ylabel="Energy / (m g l)")
    top = max(float(run.energies.pendulums.max()) for run in runs)
    panels[0, 0].set(xlim=(0.0, runs[0].time[-1]), ylim=(0.0, 1.35 * top))
    panels[-1, 0].set_xlabel("Time / $T_0$")
    legend_above_panels(figure, panels[0, 0], 4)
    return figure
