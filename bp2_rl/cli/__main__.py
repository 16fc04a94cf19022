"""`bp2 COMMAND ...`, also `python -m bp2_rl COMMAND ...`: hands over to the command's own main."""

import importlib
import sys
from collections.abc import Sequence

import bp2_rl
from bp2_rl.errors import UserError

COMMANDS = {
    "train": "train a policy, stage by stage",
    "eval": "run a policy and measure it",
    "trajopt": "find trajectories, verify them, build the library of reference motions",
    "study": "compare recipes over seeds: the ablation, and the time to 10.74 m/s",
    "bench": "measure how fast training is on this machine",
    "export": "copy a run's policy, with what was measured of it on its card",
}
USAGE = "usage: bp2 COMMAND ...\n\ncommands:\n" + "\n".join(f"  {name:8} {what}" for name, what in COMMANDS.items())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` (the process's arguments by default) names; the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        print(USAGE, file=sys.stderr)
        return 2
    name, rest = arguments[0], arguments[1:]
    if name in ("-h", "--help"):
        print(USAGE + "\n\n`bp2 COMMAND --help` lists a command's flags; `bp2 --version` says which version this is.")
        return 0
    if name == "--version":
        print(f"bp2_rl {bp2_rl.__version__}")
        return 0
    if name not in COMMANDS:
        print(f"error: no command {name!r}; bp2 has: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    # Only now: a command's imports take seconds, the help above none.
    try:
        command = importlib.import_module(f"bp2_rl.cli.{name}")
    except UserError as missing:
        print(f"error: {missing}", file=sys.stderr)
        return 2
    return command.main(rest)


if __name__ == "__main__":
    sys.exit(main())
