"""A whole study of co-design: the optimum, its sensitivity and the scans, kept and in
tables."""

import dataclasses
import io
from collections.abc import Iterable
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.table import Table

from bp2_rl.base.files import write_text
from bp2_rl.base.folders import make_folder
from bp2_rl.base.serialization import save_config
from bp2_rl.paper.trajectories.codesign.chain import solve_chains
from bp2_rl.paper.trajectories.codesign.scan import FLAT, Scan, scan_chains, scan_design
from bp2_rl.paper.trajectories.codesign.search import (
    DesignRow,
    cheapest,
    optimise_design,
)
from bp2_rl.paper.trajectories.codesign.sensitivity import vary_settings
from bp2_rl.paper.trajectories.codesign.settings import (
    PARAMETERS,
    UNITS,
    CodesignSettings,
    Others,
    Parameter,
)

NUMBERS, TEXT = "codesign.json", "codesign.txt"
COLUMNS = {
    "gear": "{row.gear_ratio:.2f}{star[gear_ratio]}",
    "length": "{row.leg_length:.3f}{star[leg_length]}",
    "stiffness": "{row.spring_stiffness:.0f}{star[spring_stiffness]}",
    "cost": "{row.cost:.4f}",
    "period": "{row.period:.3f}",
    "duty": "{row.duty:.3f}",
    "torque": "{row.peak_torque:.1f}",
    "speed": "{row.peak_speed:.1f}",
    "of top": "{row.speed_share:.0%}",
    "spread": "{row.spread:.1%}",
    "solved": "{row.solved}/{row.starts}",
}
"""The columns of a table of designs: heading -> format of a row."""


@dataclasses.dataclass(frozen=True)
class Codesign:
    """What a whole study found."""

    settings: CodesignSettings
    meshes: tuple[DesignRow, ...]  # the optimum on finer and finer meshes
    sensitivity: tuple[DesignRow, ...]
    scans: tuple[Scan, ...]


def study_codesign(
    settings: CodesignSettings, folder: Path, workers: int = 1
) -> Codesign:
    """Optimum, sensitivity and scans; solutions, `codesign.json` and `codesign.txt` are
    left in `folder`.

    Interrupted, it goes on from what is in the folder.

    Raises:
        NotSolved: no start led to a trajectory.
    """
    make_folder(folder)
    _, *finer = optimise_design(settings, folder, workers).parts
    meshes = cheapest(
        ((f"on {part.problems[-1].intervals} intervals", [part]) for part in finer),
        folder,
    )
    sensitivity = vary_settings(settings, folder, workers)
    wanted: list[tuple[Parameter, Others]] = [
        (name, others) for others in get_args(Others) for name in PARAMETERS
    ]
    ways = [
        chain
        for name, others in wanted
        for chain in scan_chains(settings, name, others)
    ]
    solve_chains(ways, folder, workers, "scans")
    scans = tuple(
        scan_design(settings, name, others, folder, workers) for name, others in wanted
    )
    study = Codesign(settings, meshes, sensitivity, scans)
    save_config(folder / NUMBERS, study)
    text = io.StringIO()
    print_study(study, Console(file=text, width=120))
    write_text(folder / TEXT, text.getvalue())
    print_study(study, Console())
    return study


def print_study(study: Codesign, console: Console) -> None:
    """The optimum beside BP2, the optimum under other settings, and what the scans say
    of each parameter."""
    console.print(_table("Optimum", (*study.meshes, *study.sensitivity)))
    console.print(_scan_table(study.scans))
    for line in remarks(study):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def remarks(study: Codesign) -> list[str]:
    """Between which values each parameter's optimum lies under all settings, and how
    often a bound made it."""
    lines = []
    for name in PARAMETERS:
        held = [row for row in study.sensitivity if name in row.at_bounds]
        inside = [
            getattr(row, name) for row in study.sensitivity if name not in row.at_bounds
        ]
        where = (
            f"{min(inside):.4g} to {max(inside):.4g} {UNITS[name]}"
            if inside
            else "nowhere"
        )
        lines.append(
            f"{name}: inside its bounds at {where} in {len(inside)} of {len(study.sensitivity)} settings, "
            f"at a bound in {len(held)}"
        )
    return lines


def _table(title: str, rows: Iterable[DesignRow]) -> Table:
    """Return a table of designs; a star marks what a bound holds."""
    table = _empty_table(title)
    table.add_column("setting", no_wrap=True)
    for heading in COLUMNS:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        star = {name: "*" if name in row.at_bounds else "" for name in PARAMETERS}
        table.add_row(
            row.case, *(form.format(row=row, star=star) for form in COLUMNS.values())
        )
    return table


def _scan_table(scans: Iterable[Scan]) -> Table:
    table = _empty_table("Scans")
    for heading in (
        "parameter",
        "others",
        "cheapest at",
        "",
        f"within {FLAT:.0%}",
        "solved from",
    ):
        table.add_column(heading, no_wrap=True)
    for scan in scans:
        table.add_row(
            f"{scan.parameter} [{UNITS[scan.parameter]}]".replace("[", r"\["),
            scan.others,
            f"{getattr(scan.best, scan.parameter):.5g}",
            "inside" if scan.interior else "at an end",
            "{:.5g} to {:.5g}".format(*scan.flat),
            f"{scan.values[0]:.5g} to {scan.values[-1]:.5g}",
        )
    return table


def _empty_table(title: str) -> Table:
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=None,
        padding=(0, 1, 0, 0),
    )
