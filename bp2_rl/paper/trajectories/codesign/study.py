"""A whole study of co-design: the optimum, its sensitivity and the scans, kept and in tables."""

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
from bp2_rl.paper.trajectories.codesign.search import DesignRow, cheapest, find_designs, optimise_design, refined
from bp2_rl.paper.trajectories.codesign.sensitivity import vary_settings
from bp2_rl.paper.trajectories.codesign.settings import PARAMETERS, UNITS, CodesignSettings, Others, Parameter

NUMBERS, TEXT = "codesign.json", "codesign.txt"


@dataclasses.dataclass(frozen=True)
class Codesign:
    """What a whole study found."""

    settings: CodesignSettings
    meshes: tuple[DesignRow, ...]  # the optimum on finer and finer meshes
    sensitivity: tuple[DesignRow, ...]
    scans: tuple[Scan, ...]


def study_codesign(
    settings: CodesignSettings, folder: Path, workers: int = 1, console: Console | None = None
) -> Codesign:
    """Optimum, sensitivity and scans; solutions, `codesign.json` and `codesign.txt` are left in `folder`.

    Interrupted, it goes on from what is in the folder.

    Raises:
        NotSolved: no start led to a trajectory.
    """
    make_folder(folder)
    console = console or Console()
    optimise_design(settings, folder, workers, console)
    best = refined(settings, find_designs(settings, folder, workers, console)[0][0])
    meshes = [cheapest(f"on {part.problems[-1].intervals} intervals", [part], folder) for part in best.parts[1:]]
    sensitivity = vary_settings(settings, folder, workers, console)
    wanted: list[tuple[Parameter, Others]] = [(name, others) for others in get_args(Others) for name in PARAMETERS]
    ways = [chain for name, others in wanted for chain in scan_chains(settings, name, others)]
    solve_chains(ways, folder, workers, "scans", console)
    scans = [scan_design(settings, name, others, folder, workers, console) for name, others in wanted]
    study = Codesign(settings, tuple(row for row in meshes if row), tuple(sensitivity), tuple(scans))
    save_config(folder / NUMBERS, study)
    text = io.StringIO()
    print_study(study, Console(file=text, width=120))
    write_text(folder / TEXT, text.getvalue())
    print_study(study, console)
    return study


def print_study(study: Codesign, console: Console) -> None:
    """The optimum beside BP2, the optimum under other settings, and what the scans say of each parameter."""
    console.print(_table("Optimum", (*study.meshes, *study.sensitivity)))
    console.print(_scan_table(study.scans))
    for line in remarks(study):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def remarks(study: Codesign) -> list[str]:
    """Between which values each parameter's optimum lies under all settings, and how often a bound made it."""
    lines = []
    for name in PARAMETERS:
        held = [row for row in study.sensitivity if name in row.at_bounds]
        inside = [getattr(row, name) for row in study.sensitivity if name not in row.at_bounds]
        where = f"{min(inside):.4g} to {max(inside):.4g} {UNITS[name]}" if inside else "nowhere"
        lines.append(
            f"{name}: inside its bounds at {where} in {len(inside)} of {len(study.sensitivity)} settings, "
            f"at a bound in {len(held)}"
        )
    return lines


def _table(title: str, rows: Iterable[DesignRow]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0))
    table.add_column("setting", no_wrap=True)
    for heading in (
        "gear",
        "length",
        "stiffness",
        "cost",
        "period",
        "duty",
        "torque",
        "speed",
        "of top",
        "spread",
        "solved",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.case, *_cells(row))
    return table


def _cells(row: DesignRow) -> Iterable[str]:
    """Figures of a row; a star marks what a bound holds."""
    star = {name: "*" if name in row.at_bounds else "" for name in PARAMETERS}
    return (
        f"{row.gear_ratio:.2f}{star['gear_ratio']}",
        f"{row.leg_length:.3f}{star['leg_length']}",
        f"{row.spring_stiffness:.0f}{star['spring_stiffness']}",
        f"{row.cost:.4f}",
        f"{row.period:.3f}",
        f"{row.duty:.3f}",
        f"{row.peak_torque:.1f}",
        f"{row.peak_speed:.1f}",
        f"{row.speed_share:.0%}",
        f"{row.spread:.1%}",
        f"{row.solved}/{row.starts}",
    )


def _scan_table(scans: Iterable[Scan]) -> Table:
    table = Table(title="Scans", title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0))
    for heading in ("parameter", "others", "cheapest at", "", f"within {FLAT:.0%}", "solved from"):
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
