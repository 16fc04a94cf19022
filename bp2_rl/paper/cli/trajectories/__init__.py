"""`bp2 paper trajectories COMMAND`: study the trajectories that the optimiser finds.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake
is answered at once.
"""

from collections.abc import Sequence

from bp2_rl.cli.dispatch import Command, choose, entries
from bp2_rl.cli.trajopt.arguments import parse_on_robot
from bp2_rl.paper.cli.trajectories.codesign import CodesignArguments, run_codesign
from bp2_rl.paper.cli.trajectories.comparing import (
    GaitsArguments,
    LimbsArguments,
    compare_gaits,
    compare_limbs,
)
from bp2_rl.paper.cli.trajectories.figures import FiguresArguments, draw_figures
from bp2_rl.paper.cli.trajectories.limits import LimitsArguments, find_limits
from bp2_rl.paper.cli.trajectories.objective import (
    ObjectiveArguments,
    compare_objective_weights,
)
from bp2_rl.paper.cli.trajectories.schemes import SchemesArguments, run_schemes
from bp2_rl.paper.cli.trajectories.sweep import SweepArguments, run_sweep

PROG = "bp2 paper trajectories"
COMMANDS = {
    "sweep": Command(f"{PROG} sweep", SweepArguments, run_sweep, parse_on_robot),
    "limits": Command(f"{PROG} limits", LimitsArguments, find_limits, parse_on_robot),
    "gaits": Command(f"{PROG} gaits", GaitsArguments, compare_gaits, parse_on_robot),
    "limbs": Command(f"{PROG} limbs", LimbsArguments, compare_limbs, parse_on_robot),
    "schemes": Command(f"{PROG} schemes", SchemesArguments, run_schemes),
    "objective": Command(
        f"{PROG} objective", ObjectiveArguments, compare_objective_weights
    ),
    "codesign": Command(f"{PROG} codesign", CodesignArguments, run_codesign),
    "figures": Command(f"{PROG} figures", FiguresArguments, draw_figures),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; return
    its exit status."""
    return choose(PROG, entries(COMMANDS), argv)
