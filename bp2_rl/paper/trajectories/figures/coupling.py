"""Whose inertia balances whose: the coupled torque by source, what the trunk saves, and
what hangs on a choice.

Colours say the source: blue the main torque, vermilion shades the leg's own parts,
black what comes through the trunk.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bp2_rl.base.plotting import FAINT, INK, QUIET, WIDTH, styled
from bp2_rl.optimiser.figure_style import letter, rows, shade_stance
from bp2_rl.paper.trajectories.coordinates import LINKS
from bp2_rl.paper.trajectories.coupling import (
    ENDS,
    THROUGH,
    WITHIN,
    Sources,
    keep_harmonics,
)
from bp2_rl.paper.trajectories.coupling_account import (
    HARMONICS,
    PAPER_INSTANT,
    CouplingAccount,
)
from bp2_rl.paper.trajectories.decomposition import TERMS, Decomposition
from bp2_rl.paper.trajectories.figures.decomposition import (
    TERM_COLORS,
    legend_of_terms,
    stack,
    stack_terms,
)

MAIN, PARTNER, SPRING, TRUNK = TERM_COLORS["main inertial"], "#D55E00", "#F2A65A", INK
SOURCES = {
    "knee of the leg": PARTNER,
    "spring of the leg": SPRING,
    "trunk: all else": TRUNK,
}
THROUGH_COLORS: dict[str, str] = dict(
    zip(
        THROUGH,
        ("#E69F00", "#009E73", "#56B4E9", "#CC79A7", "#8C6D4F", "#332288", QUIET),
        strict=True,
    )
)
PAPER_C_Z = (0.75, 1.19)  # share of the cycle, over weight
BOX = {
    "boxstyle": "square,pad=0.15",
    "facecolor": "white",
    "edgecolor": "none",
    "alpha": 0.85,
}


@styled
def coupling_figure(sources: Sources, accounts: Sequence[CouplingAccount]) -> Figure:
    """Where the coupled inertial torque of the hips comes from, at one speed and over
    speed.

    Args:
        sources: at the speed of panels A to D, G and I.
        accounts: over speed, for panels E and F; the one of that speed is panel H's.
    """
    terms = sources.decomposition
    leg = terms.cycle.hind_leg
    shown = min(
        accounts, key=lambda account: abs(account.speed - terms.cycle.problem.speed)
    )
    figure = Figure(figsize=(WIDTH, 10.9), layout="constrained")
    bands = rows(figure, 2.9, 2.4, 2.6, 2.6)
    by_source, through = bands[0].subplots(1, 2)
    torques = bands[1].subplots(1, 2, sharey=True)
    over_speed, over_speed_through = bands[2].subplots(1, 2)
    kept, cutoffs, velocities = bands[3].subplots(1, 3)

    _by_source(by_source, sources, leg)
    _through_trunk(through, sources, leg)
    for axes, joint in zip(torques, ("hip", "knee"), strict=True):
        _fixed_trunk(axes, sources, joint)
    _shares(over_speed, accounts)
    _shares_through(over_speed_through, accounts)
    _harmonics(kept, terms, leg)
    _cutoffs(cutoffs, shown)
    _velocity_force(velocities, terms)
    letter(
        [
            by_source,
            through,
            *torques,
            over_speed,
            over_speed_through,
            kept,
            cutoffs,
            velocities,
        ]
    )
    figure.suptitle(
        f"A to D, G, H, I at {terms.cycle.problem.speed:g} m/s; grey: stance. The mass matrix joins no two legs: other "
        "limbs act through the trunk alone",
        fontsize=8.5,
        color=QUIET,
    )
    return figure


@styled
def coordinates_figure(joints: Decomposition, links: Decomposition) -> Figure:
    """The terms of one hind leg in two sets of coordinates (paper, Fig.
    robot_model_analysis, B and C).

    Args:
        joints: in the angles of the joints.
        links: the same motion in absolute angles of the links.
    """
    leg = joints.cycle.hind_leg
    figure = Figure(figsize=(WIDTH, 8.6), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    for line, (joint, link) in zip(panels.T, LINKS.items(), strict=True):
        for axes, terms, name in ((line[0], joints, joint), (line[1], links, link)):
            shade_stance(axes, terms.cycle, (leg,))
            stack_terms(axes, terms, f"{leg} {name}")
            angle = (
                "angle of the joint" if terms is joints else "angle of the link itself"
            )
            axes.set(
                title=f"{name.capitalize().replace('-', ' ')} {leg}: {angle}",
                xlim=(0.0, 1.0),
            )
        low, high = (
            f(axes.get_ylim()[i] for axes in line) for i, f in enumerate((min, max))
        )
        for axes in line:
            axes.set_ylim(low, high)
    for axes in panels[:, 0]:
        axes.set_ylabel("Torque [Nm]")
    for axes in panels[-1]:
        axes.set_xlabel("Time / period")
    letter(panels.ravel().tolist())
    shown = [term for term in TERMS if np.any(joints.along(term, f"{leg} hip"))]
    legend_of_terms(figure, shown, spacing=1.0)
    return figure


def _by_source(axes: Axes, sources: Sources, leg: str) -> None:
    """A hip's main inertial torque and what balances it, coupled inertia by source."""
    terms, hip = sources.decomposition, 2 * sources.decomposition.legs.index(leg)
    coordinate = f"{leg} hip"
    shade_stance(axes, terms.cycle, (leg,))
    velocities = terms.along("centrifugal", coordinate) + terms.along(
        "Coriolis", coordinate
    )
    rest = (
        velocities
        + terms.along("gravity", coordinate)
        - terms.along("ground reaction", coordinate)
    )
    named = {
        "main": (MAIN, terms.along("main inertial", coordinate)),
        "own knee": (PARTNER, sources.within[0, :, hip]),
        "own spring": (SPRING, sources.within[1, :, hip]),
        "trunk": (TRUNK, sources.trunk[:, hip]),
        "motor": (TERM_COLORS["active"], -terms.along("active", coordinate)),
        "velocities, gravity, ground": (
            TERM_COLORS["centrifugal"],
            rest - terms.along("passive", coordinate),
        ),
    }
    stack(axes, terms.cycle, list(named.values()))
    axes.set(
        title=f"Hip {leg}, by source",
        ylabel="Torque [Nm]",
        xlabel="Time / period",
        xlim=(0.0, 1.0),
    )
    handles = [Patch(color=color, label=name) for name, (color, _) in named.items()]
    _room_above(axes, 0.28)
    axes.legend(
        handles=handles,
        loc="upper right",
        ncols=3,
        fontsize=8,
        handlelength=0.8,
        columnspacing=0.8,
        borderpad=0,
    )


def _through_trunk(axes: Axes, sources: Sources, leg: str) -> None:
    """What comes to a hip through the trunk, by source."""
    cycle, hip = sources.decomposition.cycle, 2 * sources.decomposition.legs.index(leg)
    shade_stance(axes, cycle, (leg,))
    share = cycle.time.ravel() / cycle.period
    for name, part in zip(THROUGH, sources.through[..., hip], strict=True):
        if np.any(part):
            axes.plot(
                share, part, color=THROUGH_COLORS[name], linewidth=1.1, label=name
            )
    axes.plot(
        share, sources.trunk[:, hip], color=TRUNK, linewidth=2.0, label="all: the trunk"
    )
    axes.set(
        title=f"Hip {leg}, through the trunk", xlabel="Time / period", xlim=(0.0, 1.0)
    )
    _room_above(axes, 0.34)
    axes.legend(
        loc="upper right",
        ncols=3,
        fontsize=8,
        handlelength=1.2,
        columnspacing=0.8,
        borderpad=0,
    )


def _fixed_trunk(axes: Axes, sources: Sources, joint: str) -> None:
    """A joint's motor torque over a cycle, and on a trunk that is not accelerated."""
    terms, peaks = sources.decomposition, []
    for end, front in ENDS.items():
        leg = terms.leg_at(front)
        motor = 2 * terms.legs.index(leg) + ("hip", "knee").index(joint)
        color = TERM_COLORS["Coriolis"] if front else TERM_COLORS["active"]
        u, fixed = sources.active[:, motor], sources.fixed[:, motor]
        since = terms.cycle.since_touchdown(leg)
        order = np.argsort(since, kind="stable")
        axes.plot(since[order], u[order], color=color, label=f"u, {end}")
        axes.plot(
            since[order],
            fixed[order],
            color=color,
            linestyle=(0, (1.5, 1.2)),
            label=f"ũ, {end}",
        )
        peaks.append(f"{end} {np.max(np.abs(u)):.1f}, {np.max(np.abs(fixed)):.1f} Nm")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(
        title=f"{joint.capitalize()}s: u, and ũ on a still trunk",
        xlabel="Time since touchdown / period",
        xlim=(0.0, 1.0),
    )
    text = "peaks of u and ũ:\n" + "\n".join(peaks)
    axes.annotate(
        text, (0.3, 0.98), xycoords="axes fraction", va="top", fontsize=8, bbox=BOX
    )
    if joint == "hip":
        axes.set_ylabel("Torque [Nm]")
        axes.legend(
            loc="lower right",
            ncols=2,
            fontsize=8,
            handlelength=1.6,
            columnspacing=0.8,
            borderpad=0,
        )


def _shares(axes: Axes, accounts: Sequence[CouplingAccount]) -> None:
    """Shares of the main torque that each source makes up for, over speed."""
    speeds = [account.speed for account in accounts]
    parts = np.array(
        [[account.within[name] for name in WITHIN] for account in accounts]
    )
    parts = np.column_stack([parts[:, :2], np.sum(parts[:, 2:], axis=1)])
    _bars(axes, speeds, parts, list(SOURCES.values()))
    axes.plot(
        speeds,
        [account.covered for account in accounts],
        "o",
        ms=3,
        color=MAIN,
        label="all that is coupled",
    )
    for name, color in SOURCES.items():
        axes.bar([speeds[0]], [0.0], color=color, label=name)
    axes.set(title="Share of the hips' main torque covered", xlabel="Speed [m/s]")
    axes.set_ylim(top=1.3)
    axes.legend(
        loc="upper right",
        ncols=2,
        fontsize=8,
        handlelength=0.8,
        columnspacing=0.8,
        borderpad=0,
    )


def _shares_through(axes: Axes, accounts: Sequence[CouplingAccount]) -> None:
    """The trunk's part of that by source, over speed, on a scale of its own."""
    speeds = [account.speed for account in accounts]
    names = [
        name for name in THROUGH if any(account.through[name] for account in accounts)
    ]
    parts = np.array(
        [[account.through[name] for name in names] for account in accounts]
    )
    _bars(axes, speeds, parts, [THROUGH_COLORS[name] for name in names])
    axes.plot(
        speeds, np.sum(parts, axis=1), "o", ms=3, color=TRUNK, label="all: the trunk"
    )
    for name in names:
        axes.bar([speeds[0]], [0.0], color=THROUGH_COLORS[name], label=name)
    axes.set(title="Of it through the trunk (mind the scale)", xlabel="Speed [m/s]")
    _room_above(axes, 0.4)
    axes.legend(
        loc="upper right",
        ncols=3,
        fontsize=8,
        handlelength=0.8,
        columnspacing=0.8,
        borderpad=0,
    )


def _bars(
    axes: Axes,
    speeds: Sequence[float],
    parts: Float[np.ndarray, "S K"],
    colors: Sequence[str],
) -> None:
    """Stacked bars, what is negative below the line."""
    width = 0.8 * min(np.diff(speeds), default=1.0)
    tops = np.zeros((2, len(speeds)))
    for part, color in zip(parts.T, colors, strict=True):
        side = np.where(part >= 0.0, 0, 1)
        bottom = tops[side, range(len(speeds))]
        axes.bar(speeds, part, width, bottom=bottom, color=color, linewidth=0)
        tops[side, range(len(speeds))] += part
    axes.axhline(0.0, color=INK, linewidth=0.8)


def _harmonics(axes: Axes, terms: Decomposition, leg: str) -> None:
    """A hip's main torque kept to the stride's first harmonics."""
    main, share = (
        terms.along("main inertial", f"{leg} hip"),
        terms.time / terms.cycle.period,
    )
    shade_stance(axes, terms.cycle, (leg,))
    axes.plot(share, main, color=FAINT, linewidth=3.0)
    axes.plot(share, main, color=QUIET, linewidth=0.7, label="all")
    for most, color in zip(HARMONICS, ("#56B4E9", MAIN, "#332288"), strict=True):
        axes.plot(
            share,
            keep_harmonics(terms.cycle, main, most),
            color=color,
            label=f"1 to {most}",
        )
    axes.set(
        title=f"Main torque, hip {leg}",
        ylabel="Torque [Nm]",
        xlabel="Time / period",
        xlim=(0.0, 1.0),
    )
    _room_above(axes, 0.3)
    axes.legend(
        loc="upper right",
        ncols=2,
        fontsize=8,
        handlelength=1.2,
        columnspacing=0.8,
        borderpad=0,
    )


def _cutoffs(axes: Axes, account: CouplingAccount) -> None:
    """How much of the hips' largest main torque is covered, by cut-off."""
    labels = [*(f"1 to {cut.harmonics}" for cut in account.cutoffs), "all"]
    covered = [*(cut.covered for cut in account.cutoffs), account.covered]
    largest = [
        *(max(cut.largest.values()) for cut in account.cutoffs),
        account.largest_main["joints"],
    ]
    axes.bar(labels, covered, 0.6, color=PARTNER)
    for i, (share, torque) in enumerate(zip(covered, largest, strict=True)):
        axes.annotate(
            f"{torque:.0f} Nm",
            (i, max(share, 0.0)),
            (0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    axes.set(
        title="Covered at peaks",
        xlabel="Harmonics; above: largest",
        ylim=(min(0.0, 1.2 * min(covered)), 1.1),
    )
    axes.axhline(0.0, color=INK, linewidth=0.8)


def _velocity_force(axes: Axes, terms: Decomposition) -> None:
    """C_z over the weight along the cycle, and the paper's one value of it."""
    share, over_weight = terms.time / terms.cycle.period, terms.velocity_force
    shade_stance(axes, terms.cycle, terms.legs)
    axes.plot(share, over_weight, color=TERM_COLORS["centrifugal"])
    axes.plot(*PAPER_C_Z, "D", ms=5, color=PARTNER)
    at: dict[str, Any] = {
        "textcoords": "offset points",
        "ha": "center",
        "color": PARTNER,
        "fontsize": 8,
    }
    axes.annotate("paper, at 10 m/s", PAPER_C_Z, (0, 6), **at)
    axes.axvline(PAPER_INSTANT, color=QUIET, linewidth=0.8, linestyle=(0, (2, 2)))
    axes.annotate(
        "paper's\nreversal",
        (PAPER_INSTANT, 0.98),
        (4, 0),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        va="top",
        fontsize=8,
        color=QUIET,
    )
    axes.set(title="C_z / (m g)", xlabel="Time / period", xlim=(0.0, 1.0))
    axes.set_ylim(top=1.15 * max(PAPER_C_Z[1], float(np.max(over_weight))))


def _room_above(axes: Axes, share: float) -> None:
    """Space for a legend above the data, as a share of their range."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + share * (high - low))
