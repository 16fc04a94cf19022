"""`bp2 paper pendulum COMMAND`: Huygens' pendulums on one beam, and what they say of a robot's legs.

A command imports SciPy and Matplotlib only when its flags are right: a mistake is answered at once.
"""

import dataclasses
import pkgutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.table import Table

from bp2_rl.base.files import write_npz
from bp2_rl.base.serialization import load_config, save_config, to_json
from bp2_rl.cli.dispatch import Command, choose, entries
from bp2_rl.cli.trajopt.output import spinner
from bp2_rl.paper.cli.report import METRICS, open_folder, print_table, with_folder
from bp2_rl.paper.pendulum.settings import (
    PendulumGaitsSettings,
    PendulumMapSettings,
    PendulumSectionsSettings,
    PendulumSimulateSettings,
    PendulumTorqueSettings,
    PendulumTrappingSettings,
)

OUT = Path("reports/pendulum")


STUDIES = {
    "simulate": (PendulumSimulateSettings, "exchange:simulate"),
    "sections": (PendulumSectionsSettings, "sections:cut_sections"),
    "torque": (PendulumTorqueSettings, "prescribed:compare_torques"),
    "map": (PendulumMapSettings, "reduction:map_reduction"),
    "trapping": (PendulumTrappingSettings, "trapping:find_trapping"),
    "gaits": (PendulumGaitsSettings, "gaits:gain_by_gait"),
}
"""By name: the settings, and MODULE:NAME within `paper.pendulum` of what takes them and returns a `PendulumStudy`."""


@dataclasses.dataclass(frozen=True)
class PendulumReport:
    """What metrics.json holds."""

    command: str
    settings: dict[str, Any]
    results: dict[str, Any]


def _report(name: str, arguments: Any) -> None:
    """Print a study's table, and leave its numbers, the curves and the picture in its folder."""
    settings, folder, command = arguments.settings, arguments.out, f"pendulum {name}"
    open_folder(folder, command, lambda metrics: load_config(PendulumReport, metrics).command)

    from bp2_rl.base.plotting import save_figure

    with spinner(command):
        study = pkgutil.resolve_name(f"bp2_rl.paper.pendulum.{STUDIES[name][1]}")(settings)
    table = Table(*study.columns)
    for row in study.rows:
        table.add_row(*row)
    print_table(table, 110)
    results = {kind: [to_json(one) for one in found] for kind, found in study.results.items()}
    save_config(folder / METRICS, PendulumReport(command, to_json(settings), results))
    write_npz(folder / f"{name}.npz", study.arrays, compressed=True)
    save_figure(study.figure, folder / f"{name}.{arguments.format}")
    print(f"picture, numbers and curves: {folder}")


COMMANDS = {
    name: Command(f"bp2 paper pendulum {name}", with_folder(settings, OUT / name), partial(_report, name))
    for name, (settings, _) in STUDIES.items()
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; return its exit status."""
    return choose("bp2 paper pendulum", entries(COMMANDS), argv)
