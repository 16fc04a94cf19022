"""The report as a page of HTML that explains itself, pictures inside."""

from collections.abc import Iterator, Sequence

from bp2_rl.base.assets import render
from bp2_rl.evaluation.benchmarks.outcome import MEASURES, Evaluation, Table
from bp2_rl.evaluation.report.pictures import data_url
from bp2_rl.evaluation.report.player.content import describe

PAGE, VIDEO, STILL, TRAJECTORY = "index.html", "run.mp4", "run.jpg", "trajectory.npz"


def page(evaluation: Evaluation, *, has_video: bool, command: str | None = None) -> str:
    """The report as one HTML page; only the film and the trajectory stay files beside
    it.

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
            Table("Measures", MEASURES, evaluation.rows, words=True),
            *evaluation.tables,
        ),
        run=None if run is None else describe(run),
        has_video=has_video,
        command=command,
        data_url=data_url,
        **{"VIDEO": VIDEO, "STILL": STILL, "TRAJECTORY": TRAJECTORY},
    )


def overview(evaluations: Sequence[Evaluation]) -> str:
    """One page that leads to the page of every benchmark."""
    return render(
        "evaluation/report/overview.html",
        evaluations=evaluations,
        tiles=_tiles,
        PAGE=PAGE,
    )


def _tiles(evaluation: Evaluation) -> Iterator[tuple[str, str]]:
    """Yield the labels and values that are shown large."""
    shown = {row.label: row.value for row in evaluation.rows}
    return ((label, shown[label]) for label in evaluation.tiles)
