"""`bp2 paper trajectories COMMAND`: study the trajectories that the optimiser finds.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake is answered at once.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from bp2_rl.cli import app
from bp2_rl.cli.dispatch import choose
from bp2_rl.cli.trajopt.arguments import parse_on_robot
from bp2_rl.paper.cli.trajectories.codesign import CodesignArguments, run_codesign
from bp2_rl.paper.cli.trajectories.comparing import GaitsArguments, LimbsArguments, compare_gaits, compare_limbs
from bp2_rl.paper.cli.trajectories.figures import FiguresArguments, draw_figures
from bp2_rl.paper.cli.trajectories.limits import LimitsArguments, find_limits
from bp2_rl.paper.cli.trajectories.objective import ObjectiveArguments, compare_objective_weights
from bp2_rl.paper.cli.trajectories.schemes import SchemesArguments, run_schemes
from bp2_rl.paper.cli.trajectories.sweep import SweepArguments, run_sweep


class TrajectoriesCommand(NamedTuple):
    """One command."""

    what: str
    arguments: type[Any]  # a frozen dataclass with defaults
    run: Callable[[Any], None]


COMMANDS = {
    "sweep": TrajectoriesCommand(
        "solve at many speeds from many cold starts: how reliably, how fast, how many optima", SweepArguments, run_sweep
    ),
    "limits": TrajectoriesCommand(
        "find the greatest speed that has a trajectory at all, and what it hangs on", LimitsArguments, find_limits
    ),
    "gaits": TrajectoriesCommand(
        "set trot, bound, pronk, half-bound and gallop beside each other", GaitsArguments, compare_gaits
    ),
    "limbs": TrajectoriesCommand(
        "move mass between trunk and legs: what each costs, and how fast each gets", LimbsArguments, compare_limbs
    ),
    "schemes": TrajectoriesCommand("compare discretisation schemes over meshes", SchemesArguments, run_schemes),
    "objective": TrajectoriesCommand(
        "compare what the weight of forces in the cost makes of trajectory and design",
        ObjectiveArguments,
        compare_objective_weights,
    ),
    "codesign": TrajectoriesCommand(
        "find gear ratio, leg length and spring stiffness along with the trajectory", CodesignArguments, run_codesign
    ),
    "figures": TrajectoriesCommand(
        "draw the paper's figures of a family of trajectories", FiguresArguments, draw_figures
    ),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; return its exit status."""
    return choose("bp2 paper trajectories", {name: command.what for name, command in COMMANDS.items()}, argv, _run)


def _run(name: str, argv: Sequence[str]) -> int:
    command = COMMANDS[name]
    parse = parse_on_robot if hasattr(command.arguments, "robot") else app.parse
    return app.run(lambda: command.run(parse(command.arguments, argv, f"bp2 paper trajectories {name}")))
