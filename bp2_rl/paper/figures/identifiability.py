"""The figure of the posterior: the paper's numbers narrow the ranges of the assumptions,
and predict each other."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.assets import asset_path
from bp2_rl.base.metric import Table, table_of
from bp2_rl.base.plotting import FALL, FRONT, INK, QUIET, WIDTH, styled
from bp2_rl.evaluation.plausible import read_assumptions
from bp2_rl.paper.figures.drawn import Drawn, legend_above_panels, name_rows
from bp2_rl.paper.figures.settings import IdentifiabilityFigureSettings
from bp2_rl.paper.posterior.runs import read_runs
from bp2_rl.paper.posterior.study import (
    RUNS,
    NumberNumbers,
    PosteriorNumbers,
    study_posterior,
)

KINDS = {
    "prior": ("assumed", QUIET),
    "predicted": ("from belt and power alone", FALL),
    "posterior": ("from all four", FRONT),
}
"""Intervals of a number, with label and colour."""


def identifiability(settings: IdentifiabilityFigureSettings) -> Drawn:
    """Draw and tabulate the posterior of what was assumed."""
    found = study_posterior(
        read_runs(settings.runs or asset_path(RUNS)), settings.draws
    )
    combined = Table(
        "Best determined combinations of places in the ranges",
        ("Combination", "Left"),
        [
            (
                " ".join(f"{part:+.2f} {name}" for name, part in parts.items()),
                f"{left:.0%}",
            )
            for parts, left in found.combinations
        ],
    )
    tables = (
        table_of("The paper's numbers: median and 90 % intervals", found.numbers),
        table_of("What was assumed: ranges, and what is left", found.assumptions),
        combined,
    )
    return Drawn(found, tables, {"identifiability": identifiability_figure(found)})


@styled
def identifiability_figure(found: PosteriorNumbers) -> Figure:
    """Draw the posterior's place in each range, and the intervals of the paper's
    numbers over what is printed."""
    figure = Figure(figsize=(1.15 * WIDTH, 6.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    assumptions = read_assumptions()
    ranked = sorted(found.assumptions, key=lambda one: -one.left)
    for row, one in enumerate(ranked):
        low, middle, high = map(assumptions[one.name].share_of, one.posterior)
        left.plot((0.0, 1.0), (row, row), color=QUIET, lw=1.0)
        left.plot((low, high), (row, row), color=FRONT, lw=5.0, solid_capstyle="butt")
        left.plot(middle, row, "o", color="white", ms=4.5, mec=INK)
    name_rows(
        left,
        [
            f"{one.name.replace('_', ' ')}, {one.low:g} to {one.high:g}"
            for one in ranked
        ],
    )
    left.set(xlabel="Place in the range", title="What was assumed", xlim=(0.0, 1.0))
    for row, one in enumerate(reversed(found.numbers)):
        _draw_number(right, row, one, label=row == 0)
    right.axvline(1.0, color=INK, lw=1.0)
    name_rows(
        right,
        [f"{one.name}\n{one.printed:g} {one.unit}" for one in reversed(found.numbers)],
    )
    right.set(xlabel="Over what the paper prints", title="What such robots run")
    legend_above_panels(figure, right, 3)
    return figure


def _draw_number(axes: Axes, row: int, one: NumberNumbers, *, label: bool) -> None:
    for place, (kind, (text, color)) in enumerate(KINDS.items()):
        low, middle, high = np.array(getattr(one, kind)) / one.printed
        y = row + 0.22 * (1 - place)
        axes.plot(
            (low, high),
            (y, y),
            color=color,
            lw=4.0,
            solid_capstyle="butt",
            label=text if label else None,
        )
        axes.plot(middle, y, "o", color="white", ms=4.5, mec=INK)
