"""Runs of policies that a figure is told to show: folders that eval.py leaves."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.evaluation.report.folder import TRAJECTORY, Report, read_report
from bp2_rl.simulation.trajectory import Trajectory


class Run(NamedTuple):
    """One report, and what ran."""

    name: str  # no other run's
    report: Report
    trajectory: Trajectory


def read_runs(folders: Sequence[Path], benchmark: str) -> tuple[Run, ...]:
    """The runs in reports of a benchmark, named by their robots: those of the same robot by their folders, too.

    Raises:
        UserError: a folder holds no report of this benchmark, or no trajectory.
    """
    reports = [_read(folder, benchmark) for folder in folders]
    robots = [report.conditions.get("robot", "own").partition(":")[0] for report in reports]
    runs = []
    for folder, report, robot in zip(folders, reports, robots, strict=True):
        which = f", {folder}" if robots.count(robot) > 1 else ""
        runs.append(Run(f"simulated, {robot} robot{which}", report, Trajectory.load(folder / TRAJECTORY)))
    return tuple({run.name: run for run in runs}.values())


def _read(folder: Path, benchmark: str) -> Report:
    require_name(folder)
    report = read_report(folder)
    if report.benchmark != benchmark:
        wanted = f"name one that python eval.py --benchmark {benchmark} leaves"
        raise UserError(f"--runs {folder} is a report of {report.benchmark}: {wanted}")
    return report
