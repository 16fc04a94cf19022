"""The paper's Fig. 4: the terms of the equations of motion, at one speed and over speed;
and whose inertia balances whose.

The terms keep their colours throughout (Okabe-Ito's, and Tol's indigo and wine).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator

from bp2_rl.base.plotting import FAINT, INK, QUIET, WIDTH, styled
from bp2_rl.optimiser.cycle import Cycle
from bp2_rl.optimiser.figure import (
    LEFT,
    RIGHT,
    letter,
    rows,
    shade_stance,
    stick_figures,
)
from bp2_rl.paper.figures.drawn import note
from bp2_rl.paper.trajectories.coupling import (
    ENDS,
    HARMONICS,
    PAPER_INSTANT,
    keep_harmonics,
    split_planar,
)
from bp2_rl.paper.trajectories.decomposition import (
    BALANCE,
    KINDS,
    TERMS,
    Decomposition,
    Trends,
)
from bp2_rl.paper.trajectories.sources import Sources

TERM_COLORS: dict[str, str] = dict(
    zip(
        TERMS,
        (
            "#0072B2",
            "#D55E00",
            "#56B4E9",
            "#332288",
            "#009E73",
            "#E69F00",
            "#882255",
            "#CC79A7",
        ),
        strict=True,
    )
)
KIND_TITLES = {"x": "Horizontal", "z": "Vertical", "hip": "Hip", "knee": "Knee"}


@styled
def decomposition_figure(decomposition: Decomposition, trends: Trends) -> Figure:
    """Draw the terms of the equations of motion at one speed, and their averages over
    speed (paper, Fig. robot_model_analysis, A to L).

    A to C stack the terms with the sign that makes them add up to zero: what stands
    above the line balances what hangs below. D is the motion, E to H the average forces
    and I to L their shares over speed.

    Args:
        decomposition: at the speed of panels A to D.
        trends: over speed, for panels E to L.
    """
    cycle = decomposition.cycle
    leg = cycle.hind_leg
    figure = Figure(figsize=(WIDTH, 10.4), layout="constrained")
    top, middle, bottom = rows(figure, 3.0, 1.45, 4.9)
    profiles = top.subplots(1, 3)
    motion = middle.subplots()
    means, shares = bottom.subplots(2, len(KINDS), sharex=True)

    for axes, coordinate in zip(
        profiles, ("z", f"{leg} hip", f"{leg} knee"), strict=True
    ):
        feet = (leg,) if coordinate.startswith(leg) else cycle.problem.stride.legs
        shade_stance(axes, cycle, feet)
        along = [
            (color, sign * decomposition.along(term, coordinate))
            for (term, color), sign in zip(TERM_COLORS.items(), BALANCE, strict=True)
        ]
        stack(axes, cycle, along)
        kind = coordinate.split()[-1]
        name = (
            f"{KIND_TITLES[kind]}, {leg}"
            if kind in ("hip", "knee")
            else KIND_TITLES[kind]
        )
        axes.set(
            title=name,
            ylabel="Force [N]" if kind == "z" else "Torque [Nm]",
            xlabel="Time / period",
            xlim=(0.0, 1.0),
        )
    stick_figures(motion, cycle)
    for k, (mean, share) in enumerate(zip(means, shares, strict=True)):
        _mean_panel(mean, trends, k)
        _share_panel(share, trends, k)
    means[0].set_ylabel("Mean magnitude")
    shares[0].set_ylabel("Share of the sum of means")
    top.suptitle(
        "A to C: main + coupled + centrifugal + Coriolis + gravity - active - ground reaction = 0, "
        "so the stacks above and below the line balance",
        fontsize=8.5,
        color=QUIET,
    )
    letter([*profiles, motion, *means, *shares])
    sides = [
        Line2D([], [], color=color, label=side)
        for side, color in (("left", LEFT), ("right", RIGHT))
    ]
    if "FL" in cycle.problem.stride.legs:
        motion.legend(
            handles=sides, loc="upper left", ncols=2, handlelength=0.9, borderpad=0.0
        )
    shown = np.max(trends.share, axis=(0, 2)) > 0.0
    named = np.array(TERMS)[shown].tolist()
    handles = [
        *(Patch(color=TERM_COLORS[term], label=term) for term in named),
        Patch(color=FAINT, label="stance"),
    ]
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=len(handles),
        handlelength=0.8,
        columnspacing=0.8,
    )
    return figure


def stack(
    axes: Axes, cycle: Cycle, parts: Sequence[tuple[str, Float[np.ndarray, " N"]]]
) -> None:
    """Draw parts along a cycle, each with its colour, positive parts stacked upwards
    and negative parts downwards."""
    fine = np.linspace(0.0, 1.0, 12 * len(cycle.problem.points) + 1)
    share = (
        (cycle.starts[:, None] + cycle.motion.durations[:, None] * fine) / cycle.period
    ).ravel()
    tops = np.zeros((2, share.size))
    for color, along in parts:
        if not np.any(along):
            continue
        knots = along.reshape(cycle.time.shape)
        values = np.concatenate(
            [np.interp(fine, cycle.problem.points, segment) for segment in knots]
        )
        for side, part in enumerate((np.maximum(values, 0.0), np.minimum(values, 0.0))):
            axes.fill_between(
                share, tops[side], tops[side] + part, color=color, linewidth=0
            )
            tops[side] += part
    axes.axhline(0.0, color=INK, linewidth=0.8)


def _mean_panel(axes: Axes, trends: Trends, kind: int) -> None:
    """Draw average forces on a kind of coordinate over speed."""
    for i, term in enumerate(TERMS):
        if np.any(trends.average[:, i, kind]):
            # lets the gravity below show through
            dashes = (0, (2.0, 1.0)) if term == "ground reaction" else "-"
            [line] = axes.plot(
                trends.speeds,
                trends.average[:, i, kind],
                "o",
                ms=2.5,
                color=TERM_COLORS[term],
            )
            line.set(linestyle=dashes, clip_on=False)
    name = KINDS[kind]
    unit = "N" if name in ("x", "z") else "Nm"
    axes.set(title=f"{KIND_TITLES[name]} [{unit}]")
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MultipleLocator(5.0))


def _share_panel(axes: Axes, trends: Trends, kind: int) -> None:
    """Stack the shares of all terms on a kind of coordinate over speed."""
    axes.stackplot(
        trends.speeds,
        trends.share[:, :, kind].T,
        colors=list(TERM_COLORS.values()),
        linewidth=0,
    )
    axes.set(title=KIND_TITLES[KINDS[kind]], xlabel="Speed [m/s]", ylim=(0.0, 1.0))
    axes.set_xlim(trends.speeds[0], trends.speeds[-1])
    axes.tick_params(labelleft=kind == 0)
    axes.xaxis.set_major_locator(MultipleLocator(5.0))


# --- Whose inertia balances whose -----------------------------------------------------

MAIN, PARTNER, SPRING, TRUNK = TERM_COLORS["main inertial"], "#D55E00", "#F2A65A", INK
PAPER_C_Z = (0.75, 1.19)  # share of the cycle, over weight


@styled
def coupling_figure(terms: Decomposition) -> Figure:
    """Draw where the coupled inertial torque of the hips comes from at one speed.

    Colours say the source: blue the main torque, vermilion shades the leg's own parts,
    black what comes through the trunk.
    """
    sources = split_planar(terms)
    figure = Figure(figsize=(WIDTH, 9.4), layout="constrained")
    panels = figure.subplot_mosaic([["A", "B"], ["A", "C"], ["D", "E"]])
    by_source, hips, knees, kept, velocities = (panels[name] for name in "ABCDE")
    _by_source(by_source, terms, sources)
    _fixed_trunk(hips, terms, sources, "hip")
    _fixed_trunk(knees, terms, sources, "knee")
    _harmonics(kept, terms)
    _velocity_force(velocities, terms)
    for axes in (by_source, kept, velocities):
        axes.set(xlabel="Time / period", xlim=(0.0, 1.0))
    for axes in (by_source, hips, knees, kept):
        axes.set_ylabel("Torque [Nm]")
    letter([by_source, hips, knees, kept, velocities])
    figure.suptitle(
        f"At {terms.cycle.problem.speed:g} m/s; grey: stance. The mass matrix joins no two legs: other limbs "
        "act through the trunk alone",
        fontsize=8.5,
        color=QUIET,
    )
    return figure


def _by_source(axes: Axes, terms: Decomposition, sources: Sources) -> None:
    """Stack a hip's main inertial torque and what balances it, coupled inertia by
    source."""
    leg = terms.cycle.hind_leg
    coordinate = f"{leg} hip"
    hip = 2 * terms.legs.index(leg)
    shade_stance(axes, terms.cycle, (leg,))
    signs = dict(zip(TERMS, BALANCE, strict=True))
    rest = [
        signs[term] * terms.along(term, coordinate)
        for term in ("centrifugal", "Coriolis", "gravity", "ground reaction", "passive")
    ]
    named = {
        "main": (MAIN, terms.along("main inertial", coordinate)),
        "own knee": (PARTNER, sources.within["other joint"][:, hip]),
        "own spring": (SPRING, sources.within["spring"][:, hip]),
        "trunk": (TRUNK, sources.trunk[:, hip]),
        "motor": (TERM_COLORS["active"], -terms.along("active", coordinate)),
        "velocities, gravity, ground": (TERM_COLORS["centrifugal"], np.sum(rest, 0)),
    }
    stack(axes, terms.cycle, list(named.values()))
    axes.set_title(f"Hip {leg}, by source")
    handles = [Patch(color=color, label=name) for name, (color, _) in named.items()]
    _legend_inside(axes, 2, handles)


def _fixed_trunk(
    axes: Axes, terms: Decomposition, sources: Sources, joint: str
) -> None:
    """Draw a joint's motor torque over a cycle, and on a trunk that is not
    accelerated."""
    for end, front in ENDS.items():
        leg = terms.leg_at(front)
        motor = sources.motors(joint, front)[0]
        color = TERM_COLORS["Coriolis"] if front else TERM_COLORS["active"]
        u, fixed = sources.active[:, motor], sources.fixed[:, motor]
        since = terms.cycle.since_touchdown(leg)
        order = np.argsort(since, kind="stable")
        for torque, name, dashes in ((u, "u", "-"), (fixed, "ũ", (0, (1.5, 1.2)))):
            label = f"{name}, {end}, at most {np.max(np.abs(torque)):.0f} Nm"
            (line,) = axes.plot(since[order], torque[order], color=color, label=label)
            line.set(linestyle=dashes)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(
        title=f"{joint.capitalize()}s: u, and ũ on a still trunk",
        xlabel="Time since touchdown / period",
        xlim=(0.0, 1.0),
    )
    _legend_inside(axes, 2)


def _harmonics(axes: Axes, terms: Decomposition) -> None:
    """Draw a hip's main inertial torque kept to the stride's first harmonics."""
    leg = terms.cycle.hind_leg
    main = terms.along("main inertial", f"{leg} hip")
    share = terms.time / terms.cycle.period
    shade_stance(axes, terms.cycle, (leg,))
    axes.plot(share, main, color=QUIET, linewidth=0.7, label="all")
    for most, color in zip(HARMONICS, ("#56B4E9", MAIN, "#332288"), strict=True):
        kept = keep_harmonics(terms.cycle, main, most)
        axes.plot(share, kept, color=color, label=f"1 to {most}")
    axes.set_title(f"Main torque, hip {leg}, by harmonics")
    _legend_inside(axes, 4)


def _velocity_force(axes: Axes, terms: Decomposition) -> None:
    """Draw C_z over the weight along the cycle, and the value in the paper."""
    over_weight = terms.velocity_force
    shade_stance(axes, terms.cycle, terms.legs)
    axes.plot(
        terms.time / terms.cycle.period, over_weight, color=TERM_COLORS["centrifugal"]
    )
    axes.plot(*PAPER_C_Z, "D", ms=5, color=PARTNER)
    note(axes, "paper, at 10 m/s", PAPER_C_Z, (0, 6), ha="center", color=PARTNER)
    axes.axvline(PAPER_INSTANT, color=QUIET, linewidth=0.8, linestyle=(0, (2, 2)))
    note(axes, "paper's reversal", (PAPER_INSTANT, 0.0), (4, 4), color=QUIET)
    axes.set_title("C_z / (m g)")
    axes.set_ylim(top=1.15 * max(PAPER_C_Z[1], float(np.max(over_weight))))


def _legend_inside(
    axes: Axes, columns: int, handles: Sequence[Patch] | None = None
) -> None:
    """Put a legend above the data, in extra space at the top of the panel."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))
    axes.legend(
        handles=handles,
        loc="upper right",
        ncols=columns,
        fontsize=8,
        handlelength=0.9,
        columnspacing=0.8,
        borderpad=0,
    )
