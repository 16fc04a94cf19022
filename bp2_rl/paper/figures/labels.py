"""Names beside the points of a scatter, where they cover neither each other nor a
point, and no line if they can."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox, BboxBase

from bp2_rl.base.plotting import QUIET

CLEAR = 3.5  # points of the page around a mark
FAR = 9.0  # points of the page: a name that is farther from its mark has a line to it
HALO = withStroke(linewidth=2.0, foreground="white")  # keeps a name readable on a line
# pixels that a name is sooner farther away than that a pixel of a line strikes it
STRUCK = 2.0
RADII = (6.0, 10.0, 16.0, 24.0, 34.0, 46.0, 60.0)  # points of the page
DIRECTIONS = np.deg2rad((0, 180, 35, -35, 145, -145, 70, -70, 110, -110, 90, -90))


def label(
    axes: Axes,
    points: Sequence[tuple[float, float]],
    names: Sequence[str],
    colors: Sequence[str],
) -> None:
    """Write each name as near to its point as there is room; call it when the axes have
    their final place and limits.

    Args:
        axes: that hold the points.
        points: in data coordinates.
        names: of the points; an empty one only keeps its point clear.
        colors: of the names.
    """
    figure = axes.get_figure(root=True)
    assert isinstance(figure, Figure)
    renderer = FigureCanvasAgg(figure).get_renderer()
    scale = figure.dpi / 72.0
    marks = axes.transData.transform(np.asarray(points, dtype=float))
    taken = [
        Bbox.from_bounds(
            x - CLEAR * scale, y - CLEAR * scale, 2 * CLEAR * scale, 2 * CLEAR * scale
        )
        for x, y in marks
    ]
    page, lines = axes.get_window_extent(renderer), _along_lines(axes)
    for mark, (x, y), name, color in zip(marks, points, names, colors, strict=True):
        if not name:
            continue
        text = axes.annotate(
            name,
            (x, y),
            (0, 0),
            textcoords="offset points",
            fontsize=7.5,
            color=color,
            zorder=4,
        )
        text.set_path_effects([HALO])
        best: dict[str, Any] = {}
        least, box = (np.inf, np.inf), page
        for radius, angle in itertools.product(RADII, DIRECTIONS):
            # no place that is farther away is better
            if least <= (0.0, radius * scale):
                break
            right, up = float(np.cos(angle)), float(np.sin(angle))
            place = {
                "position": (radius * right, radius * up),
                "horizontalalignment": "left"
                if right > 0.2
                else "right"
                if right < -0.2
                else "center",
                "verticalalignment": "bottom"
                if up > 0.8
                else "top"
                if up < -0.8
                else "center",
            }
            text.set(**place)
            covers = text.get_window_extent(renderer).padded(0.6 * scale)
            covered = sum(_overlap(covers, other) for other in taken) + _outside(
                covers, page
            )
            struck = _within(lines, covers)
            if radius > FAR:
                led = _straight(mark, mark + scale * np.array(place["position"]))
                struck += sum(
                    _within(led, other) for other in taken if not other.contains(*mark)
                )
            if (covered, STRUCK * struck + radius * scale) < least:
                best, least, box = (
                    place,
                    (covered, STRUCK * struck + radius * scale),
                    covers,
                )
        text.set(**best)
        taken.append(box)
        if np.hypot(*best["position"]) > FAR:
            line = {
                "arrowstyle": "-",
                "color": QUIET,
                "linewidth": 0.6,
                "shrinkA": 0.0,
                "shrinkB": 3.0,
            }
            axes.annotate(
                "",
                (x, y),
                best["position"],
                textcoords="offset points",
                arrowprops=line,
                zorder=3.5,
            )
            lines = np.concatenate(
                [lines, _straight(mark, mark + scale * np.array(best["position"]))]
            )


def _along_lines(axes: Axes) -> Float[np.ndarray, "N 2"]:
    """Points along the lines of these axes, one a pixel."""
    drawn = [
        axes.transData.transform(np.asarray(line.get_xydata()))
        for line in axes.get_lines()
    ]
    pieces = [
        _straight(*ends) for corners in drawn for ends in itertools.pairwise(corners)
    ]
    return np.concatenate([np.zeros((0, 2)), *pieces])


def _straight(
    start: Float[np.ndarray, "2"], end: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "N 2"]:
    """Points from one place to another, one a pixel."""
    return np.linspace(start, end, int(np.hypot(*(end - start))) + 1)


def _within(points: Float[np.ndarray, "N 2"], box: BboxBase) -> int:
    """How many points a box covers."""
    return int(np.sum(np.all((points > box.p0) & (points < box.p1), axis=1)))


def _overlap(one: BboxBase, other: BboxBase) -> float:
    """The area that two boxes share, pixels."""
    wide = min(one.x1, other.x1) - max(one.x0, other.x0)
    high = min(one.y1, other.y1) - max(one.y0, other.y0)
    return wide * high if wide > 0 and high > 0 else 0.0


def _outside(box: BboxBase, page: BboxBase) -> float:
    """The area of a box that is not on the page, pixels."""
    return box.width * box.height - _overlap(box, page)
