"""A benchmark's figures within a page: as SVG, which stays sharp, or as PNG where that
would be too much."""

import base64
import io
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

LARGEST_SVG = 400_000  # bytes: a figure with more in it than that is drawn by the pixel


def png(figure: Figure) -> bytes:
    """The figure as a file."""
    return _saved(figure, "png")


def data_url(figure: Figure) -> str:
    """The figure as the address of an image in a page."""
    with mpl.rc_context({"svg.hashsalt": "bp2_rl"}):  # the same figure, the same bytes
        kind, content = "svg+xml", _saved(figure, "svg", metadata={"Date": None})
    if len(content) > LARGEST_SVG:
        kind, content = "png", png(figure)
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _saved(figure: Figure, form: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, **options)
    return buffer.getvalue()
