"""What several of the commands show and leave."""

import math
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)
from rich.status import Status
from rich.table import Table

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.solution import Solution


def describe(solutions: Sequence[Solution]) -> None:
    """A row for each solution."""
    from bp2_rl.optimiser.verify import summarise

    table = Table(
        "m/s",
        "period",
        "duty",
        "torque",
        "force",
        "energy",
        "re-simulation",
        "cost",
        "s",
    )
    for solution in solutions:
        summary = summarise(solution)
        energy, position, velocity = (
            f"{solution.checks.get(name, math.nan):.1e}"
            for name in ("energy_residual", "position_error", "velocity_error")
        )
        table.add_row(
            f"{solution.problem.speed:g}",
            f"{summary.period:.3f} s",
            f"{summary.duty:.3f}",
            f"{summary.peak_torque:.0f} Nm",
            f"{summary.peak_force:.0f} N",
            energy,
            f"{position} / {velocity}",
            f"{solution.cost:.3f}",
            f"{solution.seconds:.1f}",
        )
    Console().print(table)


def judge(solutions: Sequence[Solution], *, strict: bool = False) -> None:
    """Say which figures are beyond their limits; if strict, that ends the command."""
    from bp2_rl.optimiser.verify import failures

    lines = [
        f"{s.problem.speed:g} m/s: {line}"
        for s in solutions
        for line in failures(s.checks, exact=s.problem.hardware.anatomy.sprung)
    ]
    for line in lines:
        print(line)
    if lines and strict:
        raise UserError(
            f"{len(lines)} figures are beyond their limits: solve again on a finer mesh, into a new folder"
        )
    if not lines:
        print("verified: every figure is within its limit")


def progress() -> Progress:
    """A bar on standard error."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(file=sys.stderr),
    )


def spinner(text: str) -> Status:
    """Something that turns on standard error while there is nothing to count."""
    return Console(file=sys.stderr).status(text)
