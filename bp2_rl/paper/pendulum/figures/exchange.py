"""Who has the energy, over time."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import FAINT, INK, WIDTH, styled
from bp2_rl.paper.pendulum.exchange import EVEN, Exchange
from bp2_rl.paper.pendulum.figures.style import BEAM, PENDULUMS, remark

PAPER_PERIODS = 6.0
PAPER_MEAN = 0.25
"""The paper's: "near-equipartition, about 0.25, within roughly six natural periods"."""


@styled
def exchange_figure(runs: Sequence[Exchange]) -> Figure:
    """Energies at each time and their means since the release (paper, Fig. 3C): a row for each mass ratio.

    Left as seen from the ground, where the three add up; right as seen from the beam.
    """
    figure = Figure(figsize=(WIDTH, 1.5 + 1.9 * len(runs)), layout="constrained")
    panels = figure.subplots(len(runs), 2, sharex=True, sharey=True, squeeze=False)
    for run, (ground, moving) in zip(runs, panels, strict=True):
        one = run.sharing
        for pendulum, color in enumerate(PENDULUMS):
            for axes, part in ((ground, "pendulums"), (moving, "beam_frame")):
                _draw(axes, run, part, color, pendulum)
        _draw(ground, run, "beam", BEAM)
        for axes in (ground, moving):
            axes.axvspan(0.0, PAPER_PERIODS, color=FAINT, alpha=0.7, linewidth=0)
            axes.axhline(PAPER_MEAN, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        means = [f"{mean:.3f}" for mean in one.mean]
        even = "never even"
        if one.even_after is not None:
            even = f"even after {one.even_after:.1f} $T_0$"
            ground.axvline(one.even_after, color=INK, linewidth=0.9, linestyle=(0, (1, 1.5)))
        remark(ground, f"means {' / '.join(means)}, beam {one.mean_beam:.3f}\n{even}")
        remark(moving, f"means {' / '.join(f'{mean:.3f}' for mean in one.mean_in_beam_frame)}")
        ground.set_title(f"R = {one.mass_ratio:g}, seen from the ground")
        moving.set_title(f"R = {one.mass_ratio:g}, seen from the beam")
        ground.set_ylabel("Energy / (m g l)")
    top = max(float(getattr(run.energies, part).max()) for run in runs for part in ("pendulums", "beam_frame"))
    panels[0, 0].set(xlim=(0.0, runs[0].time[-1]), ylim=(0.0, 1.35 * top))
    for axes in panels[-1]:
        axes.set_xlabel("Time / $T_0$")
    handles = [
        Line2D([], [], color=color, label=label)
        for color, label in zip((*PENDULUMS, BEAM), ("pendulum 1, let go", "pendulum 2", "beam"), strict=True)
    ]
    handles.append(Line2D([], [], color=FAINT, linewidth=7.0, label=f"paper: {PAPER_PERIODS:g} periods"))
    handles.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (4, 2)), label=f"paper: {PAPER_MEAN:g}"))
    even = f"means even: within {EVEN:g} from here on"
    handles.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (1, 1.5)), label=even))
    figure.legend(handles=handles, loc="outside upper center", ncols=3, handlelength=1.6, columnspacing=1.6)
    return figure


def _draw(axes: Axes, run: Exchange, part: str, color: str, *column: int) -> None:
    """One energy, light, and its mean since the release, bold."""
    energy, mean = (getattr(values, part)[(slice(None), *column)] for values in (run.energies, run.means))
    axes.plot(run.time, energy, color=color, linewidth=0.6, alpha=0.35, zorder=2)
    axes.plot(run.time, mean, color=color, linewidth=2.0, zorder=3)
