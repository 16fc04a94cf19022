"""A figure with its tables and pictures, and the helpers that pictures share."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.metric import Table, table_of
from bp2_rl.base.plotting import INK

DASHES = (0, (4, 2))
ON_WHITE = {
    "boxstyle": "square,pad=0.15",
    "facecolor": "white",
    "edgecolor": "none",
    "alpha": 0.85,
}
"""The box of a text that stands among lines."""


class Drawn(NamedTuple):
    """Pictures and tables of a figure, and all of its numbers."""

    # every number in pictures and tables, not rounded: a dataclass, or several by name
    results: Any
    tables: tuple[Table, ...]
    pictures: Mapping[str, Figure]  # by name


def drawn_rows(name: str, rows: Sequence[object], **picture: Figure) -> Drawn:
    """Return a figure whose numbers are the rows of one table."""
    return Drawn({name: rows}, (table_of("", rows),), picture)


def joined(form: str, between: str = " / ") -> Callable[[Sequence[float]], str]:
    """Return a function that formats several numbers for one cell of a table."""
    return lambda values: between.join(f"{value:{form}}" for value in values)


def remark(axes: Axes, text: str) -> None:
    """Write a text in the upper right corner of a panel, on white."""
    axes.text(
        0.98,
        0.95,
        text,
        transform=axes.transAxes,
        ha="right",
        va="top",
        color=INK,
        fontsize=8.5,
        bbox=ON_WHITE,
    )


def note(
    axes: Axes,
    text: str,
    at: tuple[float, float],
    away: tuple[float, float],
    **style: Any,
) -> None:
    """Write a small text beside a point of the data; `away` is in points of the page."""
    look: dict[str, Any] = {"fontsize": 8.5, **style}
    axes.annotate(text, at, away, textcoords="offset points", **look)


def swatch(color: str, label: str, **style: Any) -> Line2D:
    """Return the entry of a legend for lines or marks of a colour."""
    return Line2D([], [], color=color, label=label, **style)


def legend_above_panels(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the labels of a panel above its figure, each once."""
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    figure.legend(
        list(named.values()),
        list(named),
        loc="outside upper center",
        ncols=columns,
        handlelength=1.6,
        columnspacing=1.6,
    )


def name_rows(axes: Axes, names: Sequence[str], size: float = 8.0) -> None:
    """Name the rows of a panel, the first at the bottom, in place of numbers."""
    axes.set_yticks(range(len(names)), names, fontsize=size)
    axes.set_ylim(-0.7, len(names) - 0.3)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
