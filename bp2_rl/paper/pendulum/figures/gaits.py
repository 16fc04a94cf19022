"""What each gait gains, over its order parameter."""

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.paper.pendulum import bp2
from bp2_rl.paper.pendulum.figures.style import BEAM, ONE, TWO
from bp2_rl.paper.pendulum.gaits import GaitComparison

HALO = [withStroke(linewidth=2.5, foreground="white")]  # of a label among points
AT_REST = 1e-9  # of the order parameter: the beam rests


@styled
def gaits_figure(comparison: GaitComparison) -> Figure:
    """Peak torque, beam free over beam fixed, against the order parameter; a panel for each mass ratio.

    A bar reaches from the leg that needs least to the one that needs most.
    """
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    panels = figure.subplots(1, len(comparison.named), sharey=True, squeeze=False).ravel().tolist()
    for named, peaks, law, axes in zip(comparison.named, comparison.peak, comparison.law, panels, strict=True):
        axes.axhline(1.0, color=QUIET, linewidth=0.8)
        axes.plot(comparison.order, peaks, "o", ms=2.6, mew=0, color=ONE, alpha=0.35)
        axes.plot(comparison.orders, law, color=BEAM, linewidth=1.6)
        for gait in named:
            axes.plot([gait.order] * 2, [gait.least_peak, gait.peak], color=TWO, linewidth=2.2, solid_capstyle="butt")
            axes.plot(gait.order, gait.peak, "o", ms=6, color=TWO)
            axes.plot(gait.order, gait.root_mean_square, "o", ms=5, mfc="white", color=BEAM)
        still = [gait.gait for gait in named if gait.order < AT_REST]
        names = ", ".join(still[:2]) + ",\n" + ", ".join(still[2:])
        axes.annotate(names, (0.0, 1.0), (4, -10), textcoords="offset points", va="top", fontsize=8.5, color=INK)
        moving = sorted((gait for gait in named if gait.order >= AT_REST), key=lambda gait: gait.order)
        for gait, after in zip(moving, (*moving[1:], None), strict=True):
            left = after is None or after.order - gait.order < 0.1  # the next one's bar is in the way
            place = {"xytext": (-8 if left else 7, 6), "ha": "right" if left else "left"}
            at = (gait.order, gait.peak)
            axes.annotate(gait.gait, at, textcoords="offset points", fontsize=8.5, path_effects=HALO, **place)
        ratio = named[0].mass_ratio
        axes.set_title(f"R = {ratio:.3g}{', BP2' if ratio == bp2.MASS_RATIO else ''}")
        axes.set(xlabel="Order parameter, |mean $e^{i\\varphi}$|", xlim=(-0.03, 1.03))
    highest = max(comparison.peak.max(), *(gait.peak for named in comparison.named for gait in named))
    panels[0].set_ylim(0.0, 1.08 * highest)
    panels[0].set_ylabel("Peak torque, beam free / fixed")
    handles = [
        Line2D([], [], color=TWO, marker="o", ms=6, label="peak: neediest leg, bar to the least needy"),
        Line2D([], [], color=ONE, marker="o", ms=3, linestyle="", alpha=0.6, label="peak, any phases"),
        Line2D([], [], color=BEAM, marker="o", ms=5, mfc="white", linestyle="", label="root mean square"),
        Line2D([], [], color=BEAM, linewidth=1.6, label="that of small swings, exact"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, columnspacing=2.0)
    return figure
