"""Write and read the folder of an evaluation's report.

metrics.json     benchmark, conditions, results and every figure of merit
index.html       the same as one page, pictures inside; a single run plays in it, in three dimensions
*.png            the pictures
run.mp4          the best seconds, with a still of them in run.jpg, and
trajectory.npz   every millisecond: where there was a single run
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import write_bytes, write_text
from bp2_rl.base.folders import open_report
from bp2_rl.base.serialization import load_config, save_config, to_json
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.benchmarks.registry import ALL
from bp2_rl.evaluation.report.page import (
    PAGE,
    STILL,
    TRAJECTORY,
    VIDEO,
    overview,
    page,
    png,
)
from bp2_rl.simulation.film import NoVideo, make_video

METRICS = "metrics.json"


@dataclasses.dataclass(frozen=True)
class Report:
    """The content of a report's metrics.json."""

    benchmark: str
    conditions: dict[str, str]
    results: dict[str, Any]  # by the benchmark's name: what a policy's card says
    # everything that was measured
    metrics: dict[str, Any] = dataclasses.field(default_factory=dict)


def open_folder(folder: Path, benchmark: str) -> None:
    """Make the folder of a benchmark's report; raise UserError if that fails or other
    files are in the folder."""
    open_report(folder, METRICS, "report")
    if (folder / METRICS).is_file() and (
        old := read_report(folder).benchmark
    ) != benchmark:
        raise UserError(
            f"--out {folder} holds a report of {old}: name another folder for {benchmark}"
        )


def write_report(
    evaluation: Evaluation,
    folder: Path,
    *,
    video: bool = True,
    gl_library: str | None = None,
    command: str | None = None,
) -> str | None:
    """Write all files of a report into its folder; `command` is the command line shown
    on the page.

    Returns the reason, in one line, if a film was asked for and could not be made.
    """
    for old in (PAGE, VIDEO, STILL, TRAJECTORY):
        (folder / old).unlink(missing_ok=True)
    report = Report(
        evaluation.benchmark,
        evaluation.conditions,
        {evaluation.benchmark: card_results(evaluation)},
        to_json(evaluation.metrics),
    )
    save_config(folder / METRICS, report)
    for picture in evaluation.pictures:
        write_bytes(folder / f"{picture.name}.png", png(picture.figure))
    no_video = None
    if evaluation.trajectory is not None:
        evaluation.trajectory.save(folder / TRAJECTORY)
        if video:
            try:
                make_video(folder / TRAJECTORY, folder / VIDEO, gl_library)
            except NoVideo as reason:
                no_video = f"{reason}, or pass --no-video"
    write_text(
        folder / PAGE,
        page(evaluation, has_video=(folder / VIDEO).is_file(), command=command),
    )
    return no_video


def write_overview(evaluations: Sequence[Evaluation], folder: Path) -> None:
    """Write page and metrics.json of several benchmarks, whose reports are subfolders
    of `folder`."""
    first = evaluations[0].conditions
    shared = {name: first[name] for name in ("policy", "weights_sha256")}
    results = {
        evaluation.benchmark: card_results(evaluation) for evaluation in evaluations
    }
    save_config(folder / METRICS, Report(ALL, shared, results))
    write_text(folder / PAGE, overview(evaluations))


def read_report(folder: Path) -> Report:
    """Read metrics.json from a report's folder; raise UserError for any other folder."""
    if not (folder / METRICS).is_file():
        raise UserError(
            f"no report in {folder}: expected {METRICS} there, as python eval.py --out {folder} leaves it"
        )
    return load_config(Report, folder / METRICS)


def card_results(evaluation: Evaluation) -> dict[str, Any]:
    """Return the results of a benchmark for a policy's card, with their conditions."""
    conditions = evaluation.conditions
    return {
        name: conditions[name] for name in _CARD_CONDITIONS if name in conditions
    } | evaluation.results


_CARD_CONDITIONS = (
    "robot",
    "ground",
    "schedule",
    "sprint",
    "simulator",
    "sensors",
    "operator",
)
