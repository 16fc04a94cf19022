"""From the name of a command to the module that it is; nothing slow is imported before the name is known."""

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence

from bp2_rl.base.errors import UserError


def dispatch(program: str, package: str, commands: Mapping[str, str], argv: Sequence[str] | None) -> int:
    """Run the `main` of the command that `argv` begins with; the exit status.

    Args:
        program: what the user has typed so far, `bp2`.
        package: holds a module of each command's name.
        commands: what there is, by name, each with what it does.
        argv: the rest of the line; None for the process's own arguments.
    """

    def run(name: str, rest: Sequence[str]) -> int:
        try:
            command = importlib.import_module(f"{package}.{name}")
        except UserError as missing:  # a package that the command needs
            print(f"error: {missing}", file=sys.stderr)
            return 2
        return command.main(rest)

    return choose(program, commands, argv, run)


def choose(
    program: str, commands: Mapping[str, str], argv: Sequence[str] | None, run: Callable[[str, Sequence[str]], int]
) -> int:
    """Run the command that `argv` begins with, by its name and the rest of the line, or say what there is."""
    argv = sys.argv[1:] if argv is None else argv
    listed = "\n".join(f"  {name:8} {what}" for name, what in commands.items())
    usage = f"usage: {program} COMMAND ...\n\ncommands:\n{listed}"
    if not argv:
        print(usage, file=sys.stderr)
        return 2
    name, *rest = argv
    if name in ("-h", "--help"):
        print(f"{usage}\n\n`{program} COMMAND --help` lists a command's flags.")
        return 0
    if name not in commands:
        print(f"error: no command {name!a}; {program} has: {', '.join(commands)}", file=sys.stderr)
        return 2
    return run(name, rest)
