"""From the name of a command to the command; nothing slow is imported before the name
is known."""

import dataclasses
import importlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bp2_rl.base.errors import OK, WRONG_INPUT, UserError, did_you_mean
from bp2_rl.cli import usage

Main = Callable[[Sequence[str] | None], int]
"""A command: it takes the words after its name, None for the process's own arguments,
and returns the exit status."""


@dataclasses.dataclass(frozen=True)
class Command:
    """A command that reads its flags and does something with them.

    Args:
        prog: the command as the user types it.
        arguments: the dataclass of its flags.
        run: what it does with an instance of that.
        parse: reads the flags, as `app.parse` does, which it is by default.
    """

    prog: str
    arguments: type[Any]
    run: Callable[[Any], None]
    parse: Callable[..., Any] | None = None

    def __call__(self, argv: Sequence[str] | None = None) -> int:
        """Read the flags, run the command, and return the exit status."""
        from bp2_rl.cli import app

        parse = self.parse or app.parse
        return app.run(lambda: self.run(parse(self.arguments, argv, self.prog)))


Entry = tuple[str, Main]
"""A command in the list of a group: what it does, and itself."""


def entries(commands: Mapping[str, Command]) -> dict[str, Entry]:
    """Return the entries of commands that do what the first sentence about their flags
    says."""

    def what(command: Command) -> str:
        sentence = " ".join(
            re.split(r"(?<!Fig)\.\s|\.$", (command.arguments.__doc__ or "").strip())[
                0
            ].split()
        )
        return sentence[:1].lower() + sentence[1:]

    return {name: (what(command), command) for name, command in commands.items()}


def modules(package: str, commands: Mapping[str, str]) -> dict[str, Entry]:
    """Return the entries of modules that have a `main`, each imported when its command
    is run, from what each does."""

    def entry(name: str, what: str) -> Entry:
        def main(argv: Sequence[str] | None) -> int:
            try:
                module = importlib.import_module(f"{package}.{name}")
            except UserError as missing:  # a package that the command needs
                print(f"error: {missing}", file=sys.stderr)
                return WRONG_INPUT
            return module.main(argv)

        return what, main

    return {name: entry(name, what) for name, what in commands.items()}


def choose(prog: str, commands: Mapping[str, Entry], argv: Sequence[str] | None) -> int:
    """Run the command that `argv` begins with, or say what there is; return the exit
    status."""
    argv = sys.argv[1:] if argv is None else argv
    rows = [(name, what) for name, (what, _) in commands.items()]
    listed = "\n".join(usage.lay_out(rows, max(map(len, commands)) + 4))
    text = f"usage: {prog} COMMAND ...\n\ncommands:\n{listed}"
    if not argv:
        print(text, file=sys.stderr)
        return WRONG_INPUT
    name, *rest = argv
    if name in usage.HELP:
        print(f"{text}\n\n`{prog} COMMAND --help` lists a command's flags.")
        return OK
    if name not in commands:
        near = did_you_mean(name, commands) or f"; {prog} has: {', '.join(commands)}"
        print(f"error: no command {name!a}{near}", file=sys.stderr)
        return WRONG_INPUT
    return commands[name][1](rest)
