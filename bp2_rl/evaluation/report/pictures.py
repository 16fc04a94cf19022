"""A benchmark's figures within a page: as SVG, which stays sharp, or as PNG where that would be too much."""

import base64
import html
import io
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from bp2_rl.evaluation.benchmarks.outcome import Picture

LARGEST_SVG = 400_000  # bytes: a figure with more in it than that is drawn by the pixel
NARROW_SCREEN = "(max-width: 40rem)"


def figure(picture: Picture) -> str:
    """A picture with its caption, as HTML; where it has no narrow form, a narrow screen shows it a part at a time."""
    caption = html.escape(picture.caption)
    if picture.narrow is None:
        shown = f'<div class="wide pan"><img alt="{caption}" src="{_inside(picture.figure)}"></div>'
    else:
        narrow = f'<source media="{NARROW_SCREEN}" srcset="{_inside(picture.narrow)}">'
        shown = f'<picture>{narrow}<img alt="{caption}" src="{_inside(picture.figure)}"></picture>'
    return f"<figure>{shown}<figcaption>{caption}</figcaption></figure>"


def png(figure: Figure) -> bytes:
    """The figure as a file."""
    return _saved(figure, "png")


def _inside(figure: Figure) -> str:
    with mpl.rc_context({"svg.hashsalt": "bp2_rl"}):  # the same figure, the same bytes
        kind, content = "svg+xml", _saved(figure, "svg", metadata={"Date": None})
    if len(content) > LARGEST_SVG:
        kind, content = "png", png(figure)
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _saved(figure: Figure, form: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, **options)
    return buffer.getvalue()
