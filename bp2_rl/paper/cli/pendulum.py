"""`bp2 paper pendulum COMMAND`: Huygens' pendulums on one beam, and what they say of a robot's legs.

A command imports SciPy and Matplotlib only when its flags are right: a mistake is answered at once.
"""

import dataclasses
import pkgutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table

from bp2_rl.base.files import write_npz
from bp2_rl.base.serialization import load_config, save_config, to_json
from bp2_rl.cli import app
from bp2_rl.cli.dispatch import choose
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


class PendulumCommand(NamedTuple):
    """One command."""

    what: str
    settings: type[Any]  # a frozen dataclass with defaults
    function: str  # MODULE:NAME within `paper.pendulum`: it takes the settings and returns a `PendulumStudy`


COMMANDS = {
    "simulate": PendulumCommand(
        "let one of two pendulums go: who has the energy, and when it is shared",
        PendulumSimulateSettings,
        "exchange:simulate",
    ),
    "sections": PendulumCommand(
        "look at both once a cycle: where each has a path of its own, and where they share one",
        PendulumSectionsSettings,
        "sections:cut_sections",
    ),
    "torque": PendulumCommand(
        "move both as the paper does: torques with the beam free and with it fixed",
        PendulumTorqueSettings,
        "prescribed:compare_torques",
    ),
    "map": PendulumCommand(
        "where a free beam lowers the peak torque, over phase, frequency and amplitude",
        PendulumMapSettings,
        "reduction:map_reduction",
    ),
    "trapping": PendulumCommand(
        "how heavy a beam must be for a swing to stay with its pendulum",
        PendulumTrappingSettings,
        "trapping:find_trapping",
    ),
    "gaits": PendulumCommand("four legs on a beam: what each gait gains", PendulumGaitsSettings, "gaits:gain_by_gait"),
}


@dataclasses.dataclass(frozen=True)
class PendulumReport:
    """What metrics.json holds."""

    command: str
    settings: dict[str, Any]
    results: dict[str, Any]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; return its exit status."""
    return choose("bp2 paper pendulum", {name: command.what for name, command in COMMANDS.items()}, argv, _run)


def _run(name: str, argv: Sequence[str]) -> int:
    return app.run(lambda: _report(name, argv))


def _report(name: str, argv: Sequence[str]) -> None:
    """Print a study's table, and leave its numbers, the curves and the picture in its folder."""
    arguments = app.parse(with_folder(COMMANDS[name].settings, OUT / name), argv, f"bp2 paper pendulum {name}")
    settings, folder, command = arguments.settings, arguments.out, f"pendulum {name}"
    open_folder(folder, command, lambda metrics: load_config(PendulumReport, metrics).command)

    from bp2_rl.base.plotting import save_figure

    with spinner(command):
        study = pkgutil.resolve_name(f"bp2_rl.paper.pendulum.{COMMANDS[name].function}")(settings)
    table = Table(*study.columns)
    for row in study.rows:
        table.add_row(*row)
    print_table(table, 110)
    results = {kind: [to_json(one) for one in found] for kind, found in study.results.items()}
    save_config(folder / METRICS, PendulumReport(command, to_json(settings), results))
    write_npz(folder / f"{name}.npz", study.arrays, compressed=True)
    save_figure(study.figure, folder / f"{name}.{arguments.format}")
    print(f"picture, numbers and curves: {folder}")
