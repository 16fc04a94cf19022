"""The mechanism benchmark in pictures."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bp2_rl.base.plotting import INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.optimiser.figure_style import letter, rows
from bp2_rl.paper.benchmarks.mechanism.forces import BALANCE, TERMS, WITHIN
from bp2_rl.paper.benchmarks.mechanism.measured import (
    Decomposed,
    MechanismAtSpeed,
    MechanismMetrics,
    MechanismRun,
)
from bp2_rl.paper.benchmarks.speeds import LEG
from bp2_rl.paper.trajectories.decomposition import KINDS
from bp2_rl.paper.trajectories.figures.decomposition import KIND_TITLES, TERM_COLORS
from bp2_rl.robot.conventions import LEGS

SOURCES = (
    "A: what covers the hips' main inertial torque at its peaks, of the policy (left bars) and of the optimiser "
    "(right, pale). B: what other legs give of it. C: the hips' and knees' greatest torque, and the same on a "
    "trunk that "
    "is not accelerated; both with what gears give when they brake. D: what is covered if torques are kept to the "
    "first harmonics of the stride."
)
TERMS_CAPTION = (
    "A to C: the terms over one stride at the greatest speed that was run through, stacked so that what stands above "
    "the line balances what hangs below. D to G: their mean magnitudes over speed. H to K: their shares."
)
COLORS = {**TERM_COLORS, "stops": QUIET}
OWN = {
    "own joint": "#D55E00",
    "own spring": "#F2A65A",
    "abduction": "#CC79A7",
    "trunk": INK,
}
POLICY, OPTIMISER = LEG_COLORS["FR"], LEG_COLORS["FL"]


@styled
def sources_figure(metrics: MechanismMetrics) -> Figure:
    """Whose inertia covers the hips' main torque, and what the trunk saves."""
    figure = Figure(figsize=(WIDTH, 6.6), layout="constrained")
    (shares, legs), (torques, cuts) = figure.subplots(2, 2)
    _shares(shares, metrics)
    _legs(legs, metrics)
    _torques(torques, metrics)
    _cuts(cuts, metrics)
    handles = [Patch(color=color, label=name) for name, color in OWN.items()]
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=4,
        handlelength=0.8,
        columnspacing=0.9,
    )
    letter([shares, legs, torques, cuts])
    return figure


def _shares(axes: Axes, metrics: MechanismMetrics) -> None:
    places = np.arange(len(metrics.decomposed))
    for place, (_, forces) in zip(places, metrics.decomposed, strict=True):
        joint, spring, abduction, *trunk = (forces.within[name] for name in WITHIN)
        _stacked(
            axes,
            place - 0.2,
            (joint, spring, abduction, sum(trunk)),
            tuple(OWN.values()),
            1.0,
        )
    for place, one in zip(places, metrics.optimiser, strict=False):
        own = tuple(OWN.values())
        _stacked(
            axes,
            place + 0.2,
            (one.joint, one.spring, one.trunk),
            (own[0], own[1], own[3]),
            0.55,
        )
    _speeds(axes, metrics)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(title="Covered, by source", ylabel="Share of main torque")


def _stacked(
    axes: Axes,
    place: float,
    parts: Sequence[float],
    colors: Sequence[str],
    alpha: float,
) -> None:
    """A bar of parts, what is negative below the line."""
    tops = [0.0, 0.0]
    for part, color in zip(parts, colors, strict=True):
        side = 0 if part >= 0.0 else 1
        axes.bar(
            place, part, 0.36, bottom=tops[side], color=color, alpha=alpha, linewidth=0
        )
        tops[side] += part


def _legs(axes: Axes, metrics: MechanismMetrics) -> None:
    places = np.arange(len(metrics.decomposed))
    for shift, name, color in (
        (-0.26, "same pair", "#009E73"),
        (0.0, "other pair", "#56B4E9"),
    ):
        axes.bar(
            places + shift,
            [100 * f.through[name] for _, f in metrics.decomposed],
            0.24,
            color=color,
            label=name,
        )
    if metrics.optimiser:
        legs = [100 * one.legs for one in metrics.optimiser]
        axes.bar(places + 0.26, legs, 0.24, color=OPTIMISER, label="optimiser, both")
    _speeds(axes, metrics)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(
        min(low, -2.0), max(high, 2.0) + 0.35 * (max(high, 2.0) - min(low, -2.0))
    )
    axes.set(title="Covered by other legs", ylabel="Share of main torque [%]")
    axes.legend(
        loc="upper left",
        ncols=3,
        fontsize=8,
        handlelength=1.0,
        columnspacing=0.8,
        borderpad=0.1,
    )


def _torques(axes: Axes, metrics: MechanismMetrics) -> None:
    speeds = [at.speed for at, _ in metrics.decomposed]
    for joint, color in (("hip", POLICY), ("knee", LEG_COLORS["RR"])):
        for label, what, style in (
            ("u", "peak", "-"),
            ("ũ", "fixed_peak", (0, (3, 1.5))),
        ):
            values = [
                max(
                    getattr(motor, what)
                    for name, motor in forces.motors.items()
                    if name.endswith(joint)
                )
                for _, forces in metrics.decomposed
            ]
            axes.plot(
                speeds,
                values,
                marker="o",
                ms=3,
                color=color,
                linestyle=style,
                label=f"{joint}, {label}",
            )
    axes.set(
        title="Greatest torque at a joint",
        ylabel="Torque [Nm]",
        xlabel="Speed [m/s]",
        ylim=(0.0, None),
    )
    axes.legend(
        loc="lower right", ncols=2, fontsize=8, handlelength=2.2, columnspacing=0.9
    )


def _cuts(axes: Axes, metrics: MechanismMetrics) -> None:
    for k, (at, forces) in enumerate(metrics.decomposed):
        labels = [
            f"1 to {cut.harmonics}" if cut.harmonics else "all" for cut in forces.cuts
        ]
        covered = [
            np.nan if cut.covered is None else cut.covered for cut in forces.cuts
        ]
        shade = 0.25 + 0.75 * (k + 1) / len(metrics.decomposed)
        axes.plot(
            labels,
            covered,
            marker="o",
            ms=3,
            color=POLICY,
            alpha=shade,
            label=f"{at.speed:.1f} m/s",
        )
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(
        title="Covered, kept to harmonics",
        ylabel="Share of main torque",
        xlabel="Harmonics of the stride",
    )
    axes.legend(loc="best", ncols=2, fontsize=8, handlelength=1.2, columnspacing=0.9)


def _speeds(axes: Axes, metrics: MechanismMetrics) -> None:
    speeds = [f"{at.speed:.1f}" for at, _ in metrics.decomposed]
    axes.set_xticks(range(len(speeds)), speeds)
    axes.set_xlabel("Speed [m/s]")
    axes.grid(axis="x", visible=False)


@styled
def terms_figure(metrics: MechanismMetrics, ran: MechanismRun) -> Figure:
    """Who balances whom in the policy's gait (paper, Fig. robot_model_analysis, A to C
    and E to L)."""
    figure = Figure(figsize=(WIDTH, 8.6), layout="constrained")
    top, bottom = rows(figure, 3.0, 5.4)
    profiles = top.subplots(1, 3)
    means, shares = bottom.subplots(2, len(KINDS), sharex=True)
    assert ran.stride is not None
    leg = LEGS[LEG]
    for axes, column, name in zip(
        profiles, range(3), ("Vertical", f"Hip, {leg}", f"Knee, {leg}"), strict=True
    ):
        _stack_terms(axes, ran.stride[:, :, column])
        unit = "Force [N]" if column == 0 else "Torque [Nm]"
        axes.set(title=name, ylabel=unit, xlabel="Time / stride", xlim=(0.0, 1.0))
    found = metrics.decomposed
    for kind, mean, share in zip(KINDS, means, shares, strict=True):
        _over_speed(mean, share, found, kind)
    means[0].set_ylabel("Mean magnitude")
    shares[0].set_ylabel("Share of the sum of means")
    letter([*profiles, *means, *shares])
    top.suptitle(
        f"A to C at {ran.at.speed:.2f} m/s, one stride from touchdown to touchdown of {leg}",
        fontsize=8.5,
        color=QUIET,
    )
    handles = [Patch(color=COLORS[term], label=term) for term in TERMS]
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=5,
        handlelength=0.8,
        columnspacing=0.9,
    )
    return figure


def _stack_terms(axes: Axes, terms: Float[np.ndarray, "T N"]) -> None:
    """Terms over a stride, positive ones stacked upwards and negative ones
    downwards."""
    share, tops = np.linspace(0.0, 1.0, terms.shape[1]), np.zeros((2, terms.shape[1]))
    for term, values in zip(TERMS, BALANCE[:, None] * terms, strict=True):
        for side, part in enumerate((np.maximum(values, 0.0), np.minimum(values, 0.0))):
            axes.fill_between(
                share, tops[side], tops[side] + part, color=COLORS[term], linewidth=0
            )
            tops[side] += part
    axes.axhline(0.0, color=INK, linewidth=0.8)
    # the spikes of touchdowns would leave nothing else to see
    most = 1.15 * float(np.quantile(np.abs(tops), 0.985))
    axes.set_ylim(-most, most)


def _over_speed(
    mean: Axes,
    share: Axes,
    found: Sequence[tuple[MechanismAtSpeed, Decomposed]],
    kind: str,
) -> None:
    """Mean magnitudes of one kind, and their shares stacked to one."""
    speeds = [at.speed for at, _ in found]
    for term in TERMS:
        values = [forces.average[kind][term] for _, forces in found]
        if any(values):
            dashes = (0, (2.0, 1.0)) if term == "ground reaction" else "-"
            mean.plot(
                speeds,
                values,
                marker="o",
                ms=2.5,
                color=COLORS[term],
                linestyle=dashes,
                clip_on=False,
            )
    mean.set(
        title=f"{KIND_TITLES[kind]} [{'N' if kind in ('x', 'z') else 'Nm'}]",
        ylim=(0.0, None),
    )
    stacked = [[forces.share[kind][term] for _, forces in found] for term in TERMS]
    if len(speeds) > 1:
        share.stackplot(speeds, stacked, colors=list(COLORS.values()), linewidth=0)
        share.set_xlim(speeds[0], speeds[-1])
    share.set(title=KIND_TITLES[kind], xlabel="Speed [m/s]", ylim=(0.0, 1.0))
    share.tick_params(labelleft=kind == KINDS[0])
