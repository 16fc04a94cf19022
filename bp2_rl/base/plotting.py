"""The style of the package's pictures, and elements that several pictures share.

Legs keep one colour throughout (Okabe-Ito, told apart by the colour-blind); a shade of
grey is never data.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.files import new_file

LEG_COLORS = {"FR": "#0072B2", "FL": "#E69F00", "RR": "#009E73", "RL": "#CC79A7"}
INK, QUIET, FAINT = "#1F2328", "#6E7781", "#E4E7EB"
# where there are no legs to tell apart: what the figure is about, and falls
FRONT = LEG_COLORS["FR"]
FALL = "#D55E00"
STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": QUIET,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.8,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "figure.dpi": 150,
    "savefig.dpi": 150,
}
WIDTH, NARROW = 8.4, 4.4  # inches: of a page, of a telephone
P = ParamSpec("P")


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Decorate a drawing function so that it draws in this module's style and leaves
    Matplotlib's settings as they are."""

    @functools.wraps(draw)
    def draw_styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return draw_styled


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, PDF or SVG, by the file's suffix, whole or not at all;
    raises as `files.new_file`."""
    with new_file(path) as file:
        figure.savefig(file, format=path.suffix.removeprefix("."))


def moving_mean(
    values: Float[np.ndarray, "N ..."], samples: int
) -> Float[np.ndarray, "N ..."]:
    """Return the centred moving mean over a window of samples, which narrows towards
    the ends."""
    sums = np.concatenate((np.zeros_like(values[:1]), np.cumsum(values, axis=0)))
    index = np.arange(len(values))
    half = np.minimum(samples // 2, np.minimum(index, len(values) - 1 - index))
    width = (2 * half + 1).reshape(-1, *(1,) * (values.ndim - 1))
    return (sums[index + half + 1] - sums[index - half]) / width


def legend_above(axes: Axes) -> None:
    """Draw the legend at the right end of the title's line, clear of the data."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=5,
        handlelength=1.6,
        borderpad=0.0,
        borderaxespad=0.2,
    )


def mark_level(axes: Axes, level: float, text: str) -> None:
    """Draw a dashed horizontal line at a level, with its name at the right end."""
    axes.axhline(level, color=QUIET, linewidth=0.9, linestyle=(0, (4, 2)))
    box = {
        "boxstyle": "square,pad=0.15",
        "facecolor": "white",
        "edgecolor": "none",
        "alpha": 0.85,
    }
    at = (1.0, level)
    axes.annotate(
        text,
        at,
        xycoords=("axes fraction", "data"),
        ha="right",
        va="center",
        color=QUIET,
        bbox=box,
    )
