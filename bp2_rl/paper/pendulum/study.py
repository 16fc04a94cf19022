"""What studies of pendulums hand over, and what their pictures share: each pendulum's
colour, and remarks.

In the style of `plotting`: pendulum 1 is blue, 2 vermilion, the beam green.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK

ONE, TWO, BEAM = "#0072B2", "#D55E00", "#009E73"
PENDULUMS = (ONE, TWO)


class PendulumStudy(NamedTuple):
    """A study's table, numbers, curves and picture."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    # dataclasses, by name: the numbers that picture and table show
    results: Mapping[str, Sequence[Any]]
    arrays: Mapping[str, Any]  # what the picture's curves are drawn from
    figure: Figure


def numbered(systems: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the arrays of several systems, each array's name followed by its system's
    place."""
    return {
        f"{name}_{place}": values
        for place, arrays in enumerate(systems)
        for name, values in arrays.items()
    }


def remark(axes: Axes, text: str) -> None:
    """Write a line of text in the upper right corner of a panel, on white."""
    box = {
        "boxstyle": "square,pad=0.2",
        "facecolor": "white",
        "edgecolor": "none",
        "alpha": 0.85,
    }
    axes.text(
        0.98,
        0.95,
        text,
        transform=axes.transAxes,
        ha="right",
        va="top",
        color=INK,
        fontsize=8.5,
        bbox=box,
    )
