"""The picture of tries: every try a cell, red where it failed."""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bp2_rl.base.plotting import FALL, FRONT, INK, QUIET, WIDTH, styled

if TYPE_CHECKING:
    from bp2_rl.evaluation.benchmarks.tries.benchmark import TryOutcome

CELL, ROW = 0.76, 0.42  # inches
LABELS = 2.2  # inches, left of the cells
LONG = 9  # characters: what is longer is written smaller


@styled
def tries_figure(outcomes: Sequence["TryOutcome"]) -> Figure:
    """Draw all tries, a row a group."""
    groups = [
        list(group)
        for _, group in itertools.groupby(outcomes, key=lambda outcome: outcome.group)
    ]
    figure = Figure(figsize=(WIDTH, ROW * (len(groups) + 1.2)))
    axes: Axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, WIDTH), ylim=(len(groups) + 0.2, -1.0))
    axes.set_axis_off()
    passed = sum(outcome.passed for outcome in outcomes)
    axes.text(
        0.1,
        -0.5,
        f"{passed} of {len(outcomes)} passed",
        va="center",
        weight="bold",
        size=12,
    )
    for column, (color, alpha, words) in enumerate(
        ((FRONT, 0.16, "passed"), (FALL, 1.0, "failed"))
    ):
        left = LABELS + 1.4 * column * CELL
        axes.add_patch(
            Rectangle(
                (left, -0.6), 0.16, 0.25, facecolor=color, alpha=alpha, linewidth=0
            )
        )
        axes.text(left + 0.24, -0.5, words, va="center", color=QUIET)
    for row, group in enumerate(groups):
        axes.text(0.1, row + 0.34, group[0].group, va="center", weight="bold")
        axes.text(0.1, row + 0.70, group[0].rule, va="center", color=QUIET, size=6.5)
        for column, outcome in enumerate(group):
            _draw_cell(axes, LABELS + column * CELL, row, outcome)
    return figure


def _draw_cell(axes: Axes, left: float, top: float, outcome: "TryOutcome") -> None:
    color, alpha = (FRONT, 0.16) if outcome.passed else (FALL, 1.0)
    axes.add_patch(
        Rectangle(
            (left, top + 0.06),
            CELL - 0.05,
            0.88,
            facecolor=color,
            alpha=alpha,
            linewidth=0,
        )
    )
    middle = left + (CELL - 0.05) / 2
    head, body = (QUIET, INK) if outcome.passed else ("white", "white")
    axes.text(
        middle,
        top + 0.31,
        outcome.asked,
        ha="center",
        va="center",
        color=head,
        size=6.5,
    )
    size = 8.5 if len(outcome.did) <= LONG else 7.0
    axes.text(
        middle,
        top + 0.68,
        outcome.did,
        ha="center",
        va="center",
        color=body,
        size=size,
        weight="bold",
    )
