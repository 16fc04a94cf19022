"""Who balances whom: the terms of the equations of motion, at one speed and over speed.

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

from bp2_rl.base.errors import UserError
from bp2_rl.base.plotting import FAINT, INK, QUIET, WIDTH, styled
from bp2_rl.optimiser.cycle import Cycle
from bp2_rl.optimiser.figure_style import (
    LEFT,
    RIGHT,
    letter,
    rows,
    shade_stance,
    stick_figures,
)
from bp2_rl.paper.trajectories.decomposition import (
    BALANCE,
    KINDS,
    TERMS,
    Decomposition,
    Trends,
)

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
def decomposition_figure(
    decomposition: Decomposition, trends: Trends, leg: str | None = None
) -> Figure:
    """Who balances whom, at one speed and over speed (paper, Fig. robot_model_analysis,
    A to L).

    A to C stack the terms with the sign that makes them add up to zero: what stands
    above the line balances what hangs below. D is the motion, E to H the average forces
    and I to L their shares over speed.

    Args:
        decomposition: at the speed of panels A to D.
        trends: over speed, for panels E to L.
        leg: whose hip and knee panels B and C show; the hind leg that stands first if
            none is given.

    Raises:
        UserError: the robot has no such leg.
    """
    cycle = decomposition.cycle
    leg = leg or cycle.hind_leg
    if leg not in decomposition.legs:
        raise UserError(
            f"leg must be one of {', '.join(decomposition.legs)}, got {leg!r}"
        )
    figure = Figure(figsize=(WIDTH, 10.4), layout="constrained")
    top, middle, bottom = rows(figure, 3.0, 1.45, 4.9)
    profiles, motion = top.subplots(1, 3), middle.subplots()
    means, shares = bottom.subplots(2, len(KINDS), sharex=True)

    for axes, coordinate in zip(
        profiles, ("z", f"{leg} hip", f"{leg} knee"), strict=True
    ):
        feet = (leg,) if coordinate.startswith(leg) else cycle.problem.stride.legs
        shade_stance(axes, cycle, feet)
        stack_terms(axes, decomposition, coordinate)
        kind = coordinate.split()[-1]
        name = (
            f"{KIND_TITLES[kind]}, {leg}"
            if kind in ("hip", "knee")
            else KIND_TITLES[kind]
        )
        axes.set(
            title=name,
            ylabel=f"{_quantity(kind)} [{_unit(kind)}]",
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
            handles=sides, loc="upper left", ncols=2, handlelength=1.2, borderpad=0.0
        )
    shown = np.max(trends.share, axis=(0, 2)) > 0.0
    legend_of_terms(figure, np.array(TERMS)[shown].tolist(), spacing=0.8)
    return figure


def legend_of_terms(figure: Figure, terms: Sequence[str], spacing: float) -> None:
    """Put the colours of some terms and that of stance above a figure; `spacing` is
    between columns, in letters."""
    handles = [
        *(Patch(color=TERM_COLORS[term], label=term) for term in terms),
        Patch(color=FAINT, label="stance"),
    ]
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=len(handles),
        handlelength=0.8,
        columnspacing=spacing,
    )


def stack_terms(axes: Axes, decomposition: Decomposition, coordinate: str) -> None:
    """The terms of one coordinate, positive ones stacked upwards and negative ones
    downwards."""
    along = [
        sign * decomposition.along(term, coordinate)
        for term, sign in zip(TERMS, BALANCE, strict=True)
    ]
    stack(
        axes, decomposition.cycle, list(zip(TERM_COLORS.values(), along, strict=True))
    )


def stack(
    axes: Axes, cycle: Cycle, parts: Sequence[tuple[str, Float[np.ndarray, " N"]]]
) -> None:
    """Parts along a cycle, each with its colour, positive ones stacked upwards and
    negative ones downwards."""
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
    """Average forces of one kind over speed."""
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
    axes.set(title=f"{KIND_TITLES[name]} [{_unit(name)}]")
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MultipleLocator(5.0))


def _share_panel(axes: Axes, trends: Trends, kind: int) -> None:
    """Shares of one kind over speed, stacked to one."""
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


def _quantity(kind: str) -> str:
    return "Force" if kind in ("x", "z") else "Torque"


def _unit(kind: str) -> str:
    return "N" if kind in ("x", "z") else "Nm"
