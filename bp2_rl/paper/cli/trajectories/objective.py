"""`bp2 paper trajectories objective`: what of a trajectory is the objective's and what
the robot's."""

import dataclasses
from typing import Annotated

from bp2_rl.base.bounds import Bounded
from bp2_rl.base.folders import own_folder
from bp2_rl.base.serialization import save_config
from bp2_rl.cli.trajopt import OUT, Flat, Folder, Workers
from bp2_rl.paper.cli.report import print_table
from bp2_rl.paper.trajectories.objective import ObjectiveSettings

NUMBERS = "objective.json"  # what is left in the folder, beside the solutions


@dataclasses.dataclass(frozen=True)
class ObjectiveArguments(Bounded):
    """Compare the cheapest trajectories of BP2, of BP2 with the library's reserve and
    of co-design under one, two and three body weights of F bar, what forces are divided
    by in the cost."""

    settings: Annotated[ObjectiveSettings, Flat] = ObjectiveSettings()
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "objective"


def compare_objective_weights(arguments: ObjectiveArguments) -> None:
    """Print the table and leave its numbers; what was solved before is not solved
    again."""
    from bp2_rl.paper.trajectories.objective import (
        Objective,
        compare_objectives,
        tabulate_objectives,
    )

    with own_folder(arguments.out):
        rows = compare_objectives(arguments.settings, arguments.out, arguments.workers)
        save_config(arguments.out / NUMBERS, Objective(arguments.settings, tuple(rows)))
    print_table(tabulate_objectives(rows), 140)
    print(f"numbers: {arguments.out / NUMBERS}")
