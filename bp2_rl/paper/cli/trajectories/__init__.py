"""`bp2 paper trajectories COMMAND`: study the trajectories that the optimiser finds.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake
is answered at once.
"""

from collections.abc import Sequence

from bp2_rl.cli.app import Command, choose, entries
from bp2_rl.cli.trajopt import PROBLEM_SCREEN, problem_of_robot
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
COMMON_FLAGS = """
  --workers INT         processes [2]
  --out DIR             the folder of what is found"""
SWEEP_SCREEN = PROBLEM_SCREEN.format(
    what="""Solve at many speeds, each from several cold starts: how reliably, how fast, how many
optima. Interrupted, it goes on where it stopped when run again.""",
    flags="""  --slowest FLOAT       m/s [1]
  --fastest FLOAT       m/s [13.2]
  --step FLOAT          m/s [1]
  --starts INT          cold starts at each speed [3]"""
    + COMMON_FLAGS,
)
LIMITS_SCREEN = PROBLEM_SCREEN.format(
    what="""Find the greatest speed that has a trajectory at all, for BP2 and with one thing about
it changed at a time.""",
    flags="""  --losses              instead, for the robot without its losses, with each alone,
                        with all, and with all but each: --robot built
  --speed FLOAT         m/s, at which the search begins [13.2]"""
    + COMMON_FLAGS,
)
GAITS_SCREEN = PROBLEM_SCREEN.format(
    what="""Set five gaits beside each other in the plane: what each costs over speed, and how
fast each gets. Interrupted, it goes on where it stopped when run again.""",
    flags="  --speeds FLOAT ...    m/s, the slowest first" + COMMON_FLAGS,
)
LIMBS_SCREEN = PROBLEM_SCREEN.format(
    what="""Move mass between trunk and legs, and change the trunk's inertia: what each costs, and
how fast each gets. Interrupted, it goes on where it stopped when run again.""",
    flags="  --speeds FLOAT ...    m/s, the slowest first" + COMMON_FLAGS,
)
CODESIGN_SCREEN = f"""usage: {{prog}} [FLAGS]

Find gear ratio, leg length and spring stiffness along with the trajectory, and scan
each.

flags:
  --starts INT          of the optimum [4]
  --starts-elsewhere INT
                        of every other setting, besides the optimum itself [1]
  --grid INT            values in a scan [7]
  --confirm INT ...     meshes on which the optimum is solved again [16 24 32 48]\
{COMMON_FLAGS}

all flags, with the problem's: {{prog}} --help-all"""
COMMANDS = {
    "sweep": Command(
        f"{PROG} sweep",
        SweepArguments,
        run_sweep,
        problem_of_robot(SweepArguments),
        SWEEP_SCREEN,
    ),
    "limits": Command(
        f"{PROG} limits",
        LimitsArguments,
        find_limits,
        problem_of_robot(LimitsArguments),
        LIMITS_SCREEN,
    ),
    "gaits": Command(
        f"{PROG} gaits",
        GaitsArguments,
        compare_gaits,
        problem_of_robot(GaitsArguments),
        GAITS_SCREEN,
    ),
    "limbs": Command(
        f"{PROG} limbs",
        LimbsArguments,
        compare_limbs,
        problem_of_robot(LimbsArguments),
        LIMBS_SCREEN,
    ),
    "schemes": Command(f"{PROG} schemes", SchemesArguments, run_schemes),
    "objective": Command(
        f"{PROG} objective", ObjectiveArguments, compare_objective_weights
    ),
    "codesign": Command(
        f"{PROG} codesign", CodesignArguments, run_codesign, screen=CODESIGN_SCREEN
    ),
    "figures": Command(f"{PROG} figures", FiguresArguments, draw_figures),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; return
    its exit status."""
    return choose(PROG, entries(COMMANDS), argv)
