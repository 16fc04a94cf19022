"""What it takes to move two pendulums, with the beam free and with it fixed."""

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.paper.pendulum.figures.style import BEAM, PENDULUMS, remark
from bp2_rl.paper.pendulum.prescribed import LENGTHS, Prescribed

TAKES, ADDS = "#BFE3D6", "#F5D2BC"
TICKS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # m, of the length


@styled
def torque_figure(case: Prescribed) -> Figure:
    """Torques over a cycle, shaded where coupling adds or takes (paper, Fig. 3E); below, ratios over the length."""
    figure = Figure(figsize=(WIDTH, 6.2), layout="constrained")
    top, low = np.asarray(figure.subfigures(2, 1, height_ratios=(1.25, 1.0)))
    pair, over = top.subplots(1, 2, sharey=True), low.subplots()
    cycle, shown = case.cycle, case.shown
    around = np.append(cycle.angle, 2.0 * math.pi) / (2.0 * math.pi)
    for pendulum, axes in enumerate(pair):
        fixed, free = (np.append(torque[:, pendulum], torque[0, pendulum]) for torque in (cycle.fixed, cycle.free))
        axes.fill_between(around, fixed, free, color=TAKES, linewidth=0)
        adds = np.abs(free) > np.abs(fixed)
        axes.fill_between(around, fixed, free, where=adds, color=ADDS, linewidth=0, interpolate=True)
        axes.plot(around, fixed, color=QUIET, linewidth=1.3, linestyle=(0, (4, 2)))
        axes.plot(around, free, color=PENDULUMS[pendulum], linewidth=2.0)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set(xlabel="Time / period", xlim=(0.0, 1.0), title=f"{'AB'[pendulum]}   Pendulum {pendulum + 1}")
        remark(axes, f"free / fixed: peak {shown.peak[pendulum]:.3f}, r.m.s. {shown.root_mean_square[pendulum]:.3f}")
    top_torque = float(np.max(np.abs((cycle.fixed, cycle.free))))
    pair[0].set(ylabel="Torque / (m g l)", ylim=(-1.1 * top_torque, 1.4 * top_torque))
    for values, label, color in (
        (case.peaks, "peak", PENDULUMS[0]),
        (case.root_mean_squares, "root mean square", BEAM),
    ):
        over.plot(case.lengths, values.max(axis=-1), color=color, label=label)
    within = sorted((row for row in case.rows if LENGTHS[0] <= row.length <= LENGTHS[1]), key=lambda row: row.length)
    for row, side in zip(within, ("right", "left"), strict=False):
        at = (row.length, max(row.peak))
        over.plot(*at, "o", color=PENDULUMS[0], ms=5)
        text = f"{max(row.peak):.3f} at {row.length:g} m (W = {row.frequency:.2f})"
        over.annotate(text, at, (0, 9), textcoords="offset points", ha=side, fontsize=8.5)
    limit = max(case.rows[-1].peak)
    over.axhline(limit, color=INK, linewidth=0.9, linestyle=(0, (4, 2)), label=f"peak, very long: {limit:.3f}")
    over.set(xscale="log", xlabel="Length of a pendulum [m], which the paper does not give", ylabel="Free / fixed")
    highest = max(1.0, limit, *(max(row.peak) for row in within))
    over.set(title="C   What the free beam leaves of the torque", xlim=LENGTHS, ylim=(0.0, 1.2 * highest))
    over.set_xticks(TICKS, labels=[f"{tick:g}" for tick in TICKS])
    over.minorticks_off()
    over.legend(loc="lower right", ncols=3)
    handles = [
        Line2D([], [], color=PENDULUMS[0], linewidth=2.0, label="beam free, 1"),
        Line2D([], [], color=PENDULUMS[1], linewidth=2.0, label="beam free, 2"),
        Line2D([], [], color=QUIET, linewidth=1.3, linestyle=(0, (4, 2)), label="beam fixed"),
        Patch(color=TAKES, linewidth=0, label="coupling takes"),
        Patch(color=ADDS, linewidth=0, label="coupling adds"),
    ]
    top.legend(handles=handles, loc="outside upper center", ncols=5, handlelength=1.8, columnspacing=1.4)
    return figure
