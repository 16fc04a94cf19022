"""Policies' runs for the figures, read from report folders of eval.py, and the three
cycles of a run that are drawn."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.evaluation.report.folder import TRAJECTORY, Report, read_report
from bp2_rl.paper.benchmarks.speeds import LEG
from bp2_rl.simulation.gait import contacts, touchdowns
from bp2_rl.simulation.trajectory import Trajectory, best_window


class Run(NamedTuple):
    """A policy's run: a name of its own, the report, and the trajectory."""

    name: str  # no other run's
    report: Report
    trajectory: Trajectory


def read_runs(folders: Sequence[Path], benchmark: str) -> tuple[Run, ...]:
    """Read the runs in a benchmark's report folders, each with a name by robot and
    policy, and by folder where those repeat.

    Raises:
        UserError: a folder holds no report of this benchmark, or no trajectory.
    """
    reports = [_read(folder, benchmark) for folder in folders]
    names = [_name(report) for report in reports]
    runs = []
    for folder, report, name in zip(folders, reports, names, strict=True):
        which = f", {folder}" if names.count(name) > 1 else ""
        runs.append(
            Run(
                f"simulated, {name}{which}",
                report,
                Trajectory.load(folder / TRAJECTORY),
            )
        )
    return tuple({run.name: run for run in runs}.values())


def _name(report: Report) -> str:
    robot = report.conditions.get("robot", "own").partition(":")[0]
    trained_on = report.conditions.get("trained on", robot).partition(":")[0]
    return (
        f"{robot} robot"
        if trained_on == robot
        else f"{trained_on} policy on the {robot} robot"
    )


def _read(folder: Path, benchmark: str) -> Report:
    require_name(folder)
    report = read_report(folder)
    if report.benchmark != benchmark:
        wanted = f"name one that python eval.py --benchmark {benchmark} leaves"
        raise UserError(f"--runs {folder} is a report of {report.benchmark}: {wanted}")
    return report


CYCLES = 3


def cycles(run: Trajectory) -> Trajectory:
    """Return the last three gait cycles that begin within the run's best second, or
    without one the run's last three.

    Raises:
        UserError: there are no three.
    """
    landed = touchdowns(contacts(run)[:, LEG])
    best = best_window(run, 1.0)
    if best is not None:
        until = np.searchsorted(run.time[landed], best.start + 1.0)
        landed = landed[: max(int(until), CYCLES + 1)]
    if len(landed) <= CYCLES:
        raise UserError(
            f"the run has {max(len(landed) - 1, 0)} whole strides, {CYCLES} are drawn: name a longer one"
        )
    first, last = landed[-CYCLES - 1], landed[-1]
    return run.between(float(run.time[first]), float(run.time[last]))
