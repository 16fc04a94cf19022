"""The report of an evaluation as a self-contained HTML page, with its figures
inside."""

import base64
import io
from collections.abc import Iterator, Sequence

import matplotlib as mpl
from matplotlib.figure import Figure

from bp2_rl.base.assets import render
from bp2_rl.base.metric import table_of_rows
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.report.player.content import describe_run

LARGEST_SVG = 400_000  # bytes: a figure with more in it than that is drawn by the pixel
PAGE, VIDEO, STILL, TRAJECTORY = "index.html", "run.mp4", "run.jpg", "trajectory.npz"


def page(evaluation: Evaluation, *, has_video: bool, command: str | None = None) -> str:
    """Return the report as one HTML page, with only film and trajectory beside it.

    Args:
        evaluation: what to show.
        has_video: whether the film is there, with its still.
        command: what makes the report again.
    """
    run = evaluation.trajectory
    return render(
        "evaluation/report/benchmark.html",
        evaluation=evaluation,
        tiles=_tiles(evaluation),
        tables=(
            table_of_rows("Measures", evaluation.rows),
            *evaluation.tables,
        ),
        run=None if run is None else describe_run(run),
        has_video=has_video,
        command=command,
        data_url=data_url,
        **{"VIDEO": VIDEO, "STILL": STILL, "TRAJECTORY": TRAJECTORY},
    )


def overview(evaluations: Sequence[Evaluation]) -> str:
    """Return an HTML page with the verdicts of several benchmarks and links to their
    pages."""
    return render(
        "evaluation/report/overview.html",
        evaluations=evaluations,
        tiles=_tiles,
        PAGE=PAGE,
    )


def _tiles(evaluation: Evaluation) -> Iterator[tuple[str, str]]:
    """Yield the labels and values of the figures of merit that a page shows large."""
    shown = {row.label: row.value for row in evaluation.rows}
    return ((label, shown[label]) for label in evaluation.tiles)


# --- Pictures -------------------------------------------------------------------------


def png(figure: Figure) -> bytes:
    """Return the figure as a PNG file."""
    return _saved(figure, "png")


def data_url(figure: Figure) -> str:
    """Return a figure as a data URL, which an HTML page shows as an image.

    An SVG stays sharp; what would be too large an SVG is a PNG.
    """
    with mpl.rc_context({"svg.hashsalt": "bp2_rl"}):  # the same figure, the same bytes
        kind = "svg+xml"
        content = _saved(figure, "svg", metadata={"Date": None})
    if len(content) > LARGEST_SVG:
        kind = "png"
        content = png(figure)
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _saved(figure: Figure, form: str, metadata: dict[str, None] | None = None) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form, metadata=metadata)
    return buffer.getvalue()
