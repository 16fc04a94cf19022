"""`bp2 paper trajectories COMMAND`: study the trajectories that the optimiser finds.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake is answered at once.
"""

import sys
from collections.abc import Sequence

from bp2_rl.cli.dispatch import dispatch

COMMANDS = {
    "sweep": "solve at many speeds from many cold starts: how reliably, how fast, how many optima",
    "limits": "find the greatest speed that has a trajectory at all, and what it hangs on",
    "gaits": "set trot, bound, pronk, half-bound and gallop beside each other",
    "limbs": "move mass between trunk and legs: what each costs, and how fast each gets",
    "schemes": "compare discretisation schemes over meshes",
    "objective": "compare what the weight of forces in the cost makes of trajectory and design",
    "codesign": "find gear ratio, leg length and spring stiffness along with the trajectory",
    "figures": "draw the paper's figures of a family of trajectories",
}


def main(argv: Sequence[str] | None = None) -> int:
    """The command that `argv` (the process's arguments by default) names; its exit status."""
    return dispatch(
        "bp2 paper trajectories",
        "bp2_rl.paper.cli.trajectories",
        COMMANDS,
        list(sys.argv[1:] if argv is None else argv),
    )
