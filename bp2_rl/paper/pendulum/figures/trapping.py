"""Who keeps a swing, over mass ratios, and from which mass ratio on."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.figures.style import BEAM, ONE, TWO
from bp2_rl.paper.pendulum.trapping import Sweep, Threshold

TICKS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # of the mass ratio


@styled
def trapping_figure(sweeps: Sequence[Sweep], thresholds: Sequence[Threshold]) -> Figure:
    """Long averages over the mass ratio, a panel for each amplitude; last, the threshold over the amplitude."""
    count = len(sweeps) + bool(thresholds)
    figure = Figure(figsize=(WIDTH, 0.7 + 2.5 * count), layout="constrained")
    panels = figure.subplots(count, 1, squeeze=False).ravel().tolist()
    for letter, sweep, axes in zip("ABCD", sweeps, panels, strict=False):
        for pendulum, (color, label) in enumerate(((ONE, "mean of 1, let go"), (TWO, "mean of 2"))):
            values = [mean[pendulum] for mean in sweep.mean]
            axes.plot(sweep.mass_ratio, values, "o-", ms=3.5, color=color, label=label)
        axes.plot(sweep.mass_ratio, sweep.mean_beam, "o-", ms=3.5, color=BEAM, label="mean of the beam")
        axes.plot(
            sweep.mass_ratio, sweep.greatest, "o", ms=4, mfc="none", color=TWO, label="most that 2 has in a $T_0$"
        )
        curve = np.geomspace(sweep.mass_ratio[0], sweep.mass_ratio[-1], 200)
        small = np.array([exact.shares(ratio) for ratio in curve])
        for column in (0, 1):
            label = "small swings, exact" if column == 0 else None
            axes.plot(curve, small[:, column], color=QUIET, linewidth=1.0, linestyle=(0, (1, 1.5)), label=label)
        axes.axvline(sweep.law, color=INK, linewidth=1.0, linestyle=(0, (4, 2)), label="law, $32/A^2$")
        for one in thresholds:
            if one.amplitude == sweep.amplitude:
                axes.axvline((one.exchanges + one.traps) / 2.0, color=INK, linewidth=1.2, label="trapped from here on")
        axes.set(xscale="log", ylim=(-0.03, 1.05), ylabel="Share of the energy", xlabel="Mass ratio R")
        axes.set_title(f"{letter}   Let go at {sweep.amplitude:.3g} rad")
        axes.set_xticks(TICKS, labels=[f"{tick:g}" for tick in TICKS])
        axes.minorticks_off()
        axes.set_xlim(0.22, 225.0)
        if axes is panels[0]:
            figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    if thresholds:
        axes = panels[-1]
        amplitudes = [one.amplitude for one in thresholds]
        curve = np.linspace(0.95 * min(amplitudes), 1.03 * max(amplitudes), 200)
        axes.plot(curve, 32.0 / curve**2, color=INK, linewidth=1.0, linestyle=(0, (4, 2)), label="law, $32/A^2$")
        middle = np.array([(one.exchanges + one.traps) / 2.0 for one in thresholds])
        axes.plot(amplitudes, middle, "o-", color=ONE, label="measured")
        for at in zip(amplitudes, middle, strict=True):
            axes.annotate(f"{at[1]:.1f}", at, (0, -14), textcoords="offset points", ha="center", fontsize=8.5)
        axes.set(yscale="log", xlabel="Amplitude A [rad]", ylabel="Mass ratio R", ylim=(0.45 * middle.min(), None))
        axes.set_title(f"{'ABCDE'[len(sweeps)]}   From which mass ratio on a swing is trapped")
        axes.annotate("trapped", (0.75, 0.82), xycoords="axes fraction", color=QUIET)
        axes.annotate("exchanged", (0.12, 0.15), xycoords="axes fraction", color=QUIET)
        axes.set_yticks([10, 20, 50, 100, 200], labels=["10", "20", "50", "100", "200"])
        axes.minorticks_off()
        axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.75))
    return figure
