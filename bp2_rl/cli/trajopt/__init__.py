"""`bp2 trajopt WHAT`: find trajectories, verify them, build the library of reference motions, draw what they show."""

import importlib
import sys
from collections.abc import Sequence

COMMANDS = {
    "solve": "find the best trajectory at one speed, verify it, and keep it with its picture",
    "sweep": "solve at many speeds from many cold starts: how reliably, how fast, how many optima",
    "limits": "find the greatest speed that has a trajectory at all, and what it hangs on",
    "verify": "judge solutions by a model that shares no code with the one they were found with",
    "schemes": "compare discretisation schemes over meshes",
    "library": "build the library of reference motions",
    "codesign": "find gear ratio, leg length and spring stiffness along with the trajectory",
    "figures": "draw the paper's figures of a family of trajectories",
}
USAGE = "usage: bp2 trajopt WHAT ...\n\n" + "\n".join(f"  {name:8} {what}" for name, what in COMMANDS.items())


def main(argv: Sequence[str] | None = None) -> int:
    """The command that `argv` (the process's arguments by default) names; its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        print(USAGE, file=sys.stderr)
        return 2
    name, rest = arguments[0], arguments[1:]
    if name in ("-h", "--help"):
        print(USAGE + "\n\n`bp2 trajopt WHAT --help` lists the flags.")
        return 0
    if name not in COMMANDS:
        print(f"error: no command {name!r}; bp2 trajopt has: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    # A command imports CasADi, MuJoCo and Matplotlib only when its flags are right: a mistake is answered at once.
    return importlib.import_module(f"bp2_rl.cli.trajopt.{name}").main(rest)
