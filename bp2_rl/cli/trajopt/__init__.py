"""`bp2 trajopt COMMAND`: find trajectories, verify them, build the library of reference motions.

A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake is answered at once.
"""

import sys
from collections.abc import Sequence

from bp2_rl.cli.dispatch import dispatch

COMMANDS = {
    "solve": "find the best trajectory at one speed, verify it, and keep it with its picture",
    "verify": "judge solutions by a model that shares no code with the one they were found with",
    "library": "build the library of reference motions",
}


def main(argv: Sequence[str] | None = None) -> int:
    """The command that `argv` (the process's arguments by default) names; its exit status."""
    return dispatch("bp2 trajopt", "bp2_rl.cli.trajopt", COMMANDS, list(sys.argv[1:] if argv is None else argv))
