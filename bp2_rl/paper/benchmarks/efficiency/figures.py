"""The efficiency benchmark in pictures."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bp2_rl.base.plotting import FALL, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.optimiser.figure_style import letter
from bp2_rl.paper.benchmarks.efficiency.measured import ENDS, EfficiencyMetrics
from bp2_rl.robot import bp2

CAPTION = (
    "A: costs of transport over speed. The band is what becomes of the motors' braking: from all of it lost (upper "
    "edge) to all of it returned (lower). B: where the energy goes if all is returned. C: what springs give of what "
    "springs and motors give, and the motors' efficiency while they drive. D: greatest power of one motor in a "
    "millisecond, driving and braking; grey: the two peaks that the paper names of hind legs."
)
COLORS = {
    "copper": "#D55E00",
    "gears": "#E69F00",
    "joints": "#F5CE7A",
    "slides": "#56B4E9",
    "dampers": "#0072B2",
    "air": "#CC79A7",
    "ground": "#009E73",
    "stops": "#6E7781",
    "legs": "#1F2328",
}
NAMES = {
    "copper": "windings",
    "joints": "joint friction",
    "stops": "joint limits",
    "legs": "legs touching",
}
POLICY, OPTIMISER = LEG_COLORS["FR"], LEG_COLORS["RR"]
DASHED = (0, (4, 2))
LEGEND = 1.35  # of what is drawn: room above it


@styled
def efficiency_figure(metrics: EfficiencyMetrics) -> Figure:
    """Costs, where they go, springs and motors, and peaks."""
    figure = Figure(figsize=(WIDTH, 6.8), layout="constrained")
    (costs, causes), (shares, peaks) = figure.subplots(2, 2)
    _costs(costs, metrics)
    _causes(causes, metrics)
    _shares(shares, metrics)
    _peaks(peaks, metrics)
    for axes in (costs, causes, shares, peaks):
        axes.set_xlabel("Speed [m/s]")
    letter([costs, causes, shares, peaks])
    return figure


def _speeds(metrics: EfficiencyMetrics) -> list[float]:
    return [at.speed for at, _ in metrics.found]


def _costs(axes: Axes, metrics: EfficiencyMetrics) -> None:
    speeds, energies = _speeds(metrics), [energy for _, energy in metrics.found]
    electrical = [energy.electrical for energy in energies]
    axes.fill_between(
        speeds,
        [e.everything for e in electrical],
        [e.nothing for e in electrical],
        color=FALL,
        alpha=0.18,
        linewidth=0,
    )
    axes.plot(
        speeds,
        [e.half for e in electrical],
        "o-",
        ms=3,
        color=FALL,
        label="electrical, half returned",
    )
    axes.plot(
        speeds,
        [e.bus for e in electrical],
        color=FALL,
        linestyle=DASHED,
        label="shared by motors",
    )
    axes.plot(
        speeds,
        [e.positive for e in energies],
        "o-",
        ms=3,
        color=POLICY,
        label="mechanical",
    )
    axes.plot(
        speeds,
        [e.net for e in energies],
        color=POLICY,
        linestyle=DASHED,
        label="mechanical, net",
    )
    theirs = sorted({(one.speed, one.positive) for one in metrics.optimiser})
    axes.plot(
        *zip(*theirs, strict=True),
        "s-",
        ms=3,
        color=OPTIMISER,
        label="optimiser, mechanical",
    )
    axes.set(title="Cost of transport", ylabel="Power / (m g v)")
    axes.set_ylim(
        0.0,
        LEGEND
        * max(
            *(e.nothing for e in electrical),
            *(one.positive for one in metrics.optimiser),
        ),
    )
    axes.legend(
        loc="upper right", fontsize=8, ncols=2, handlelength=2.0, columnspacing=0.9
    )


def _causes(axes: Axes, metrics: EfficiencyMetrics) -> None:
    speeds, energies = _speeds(metrics), [energy for _, energy in metrics.found]
    shown = [
        cause
        for cause in COLORS
        if any(energy.lost[cause] > 0.0 for energy in energies)
    ]
    if len(speeds) > 1:
        stacked = [
            [max(energy.lost[cause], 0.0) for energy in energies] for cause in shown
        ]
        axes.stackplot(
            speeds, stacked, colors=[COLORS[cause] for cause in shown], linewidth=0
        )
    else:
        tops = np.cumsum([0.0, *(max(energies[0].lost[cause], 0.0) for cause in shown)])
        for cause, low, high in zip(shown, tops, tops[1:], strict=False):
            axes.bar(
                speeds, high - low, 0.4, bottom=low, color=COLORS[cause], linewidth=0
            )
    axes.set(title="Where it goes", ylabel="Power / (m g v)")
    axes.set_ylim(0.0, LEGEND * max(sum(energy.lost.values()) for energy in energies))
    handles = [
        Patch(color=COLORS[cause], label=NAMES.get(cause, cause))
        for cause in reversed(shown)
    ]
    axes.legend(
        handles=handles,
        loc="upper right",
        fontsize=8,
        handlelength=0.8,
        ncols=3,
        columnspacing=0.9,
    )


def _shares(axes: Axes, metrics: EfficiencyMetrics) -> None:
    speeds, energies = _speeds(metrics), [energy for _, energy in metrics.found]
    axes.plot(
        speeds,
        [e.spring_share for e in energies],
        "o-",
        ms=3,
        color=INK,
        label="springs' share",
    )
    axes.plot(
        speeds,
        [np.nan if e.efficiency is None else e.efficiency for e in energies],
        "o-",
        ms=3,
        color=FALL,
        label="motors' efficiency, driving",
    )
    axes.set(title="Springs and motors", ylabel="Share", ylim=(0.0, 1.0))
    axes.legend(loc="center right", fontsize=8)


def _peaks(axes: Axes, metrics: EfficiencyMetrics) -> None:
    speeds = _speeds(metrics)
    colors = {
        "fore hip": LEG_COLORS["FR"],
        "fore knee": LEG_COLORS["RL"],
        "hind hip": LEG_COLORS["RR"],
        "hind knee": LEG_COLORS["FL"],
    }
    for power in bp2.HIND_PEAK_POWERS:
        axes.axhline(power, color=QUIET, linewidth=0.9, linestyle=DASHED)
    paper = "paper: " + " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
    at = (1.0, max(bp2.HIND_PEAK_POWERS))
    axes.annotate(
        paper,
        at,
        (0, 3),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="right",
        va="bottom",
        color=QUIET,
        fontsize=8,
    )
    for name in (f"{end} {joint}" for end in ENDS for joint in ("hip", "knee")):
        motors = [
            next(joint for joint in energy.joints if joint.name == name)
            for _, energy in metrics.found
        ]
        axes.plot(
            speeds,
            [motor.peak for motor in motors],
            "o-",
            ms=3,
            color=colors[name],
            label=name,
        )
        axes.plot(
            speeds,
            [-motor.hardest for motor in motors],
            "o-",
            ms=3,
            color=colors[name],
            mfc="white",
        )
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set(title="Greatest power of a motor", ylabel="Driving, braking [W]")
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.16 * (high - low), high + 0.05 * (high - low))
    axes.legend(
        loc="lower left",
        fontsize=8,
        ncols=4,
        handlelength=1.2,
        columnspacing=0.8,
        borderpad=0.1,
    )
