"""`bp2 paper pendulum COMMAND`: Huygens' pendulums on one beam, and what they say of a robot's legs.

A command imports SciPy and Matplotlib only when its flags are right: a mistake is answered at once.
"""

import sys
from collections.abc import Sequence

from bp2_rl.cli.dispatch import dispatch

COMMANDS = {
    "simulate": "let one of two pendulums go: who has the energy, and when it is shared",
    "sections": "look at both once a cycle: where each has a path of its own, and where they share one",
    "torque": "move both as the paper does: torques with the beam free and with it fixed",
    "map": "where a free beam lowers the peak torque, over phase, frequency and amplitude",
    "trapping": "how heavy a beam must be for a swing to stay with its pendulum",
    "gaits": "four legs on a beam: what each gait gains",
}


def main(argv: Sequence[str] | None = None) -> int:
    """The command that `argv` (the process's arguments by default) names; its exit status."""
    return dispatch(
        "bp2 paper pendulum", "bp2_rl.paper.cli.pendulum", COMMANDS, list(sys.argv[1:] if argv is None else argv)
    )
