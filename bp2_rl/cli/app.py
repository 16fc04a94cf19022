"""Run a command: find it, parse its flags, and return its exit status.

A command ends with status 0: done; 2: a user's mistake; 1: a failure, with what to do
or the place of its log; 128 + n: stopped by signal n, with the work kept. All but 0 say
why on standard error. Nothing slow is imported before a command is known, tyro included.
"""

import contextlib
import dataclasses
import datetime
import errno
import functools
import importlib
import inspect
import io
import os
import pkgutil
import signal
import sys
import tempfile
import textwrap
import threading
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from bp2_rl.base.errors import (
    FAILED,
    INTERRUPTED,
    OK,
    WRONG_INPUT,
    RunStopped,
    UserError,
    did_you_mean,
    one_line,
)
from bp2_rl.base.processes import STOPPING, handling

Config = TypeVar("Config")
Main = Callable[[Sequence[str]], int]
"""Main function of a command: takes the words after its name and returns the exit
status."""
Entry = tuple[str, Main]
"""An entry in a list of commands: description and main function."""

HELP_ALL = "--help-all"
HELP = ("-h", "--help", HELP_ALL)
COLUMNS = 80  # of the list of commands


class FlagError(UserError):
    """A command line that tyro cannot read; the message is tyro's, over several lines."""


GRACE = 3.0  # s


def run(command: Callable[[], None], *, patient: bool = True) -> int:
    """Run a command and return its exit status; errors become one-line messages,
    without a traceback.

    SIGTERM and SIGHUP end a command tidily, as Ctrl-C does. Where one finds the main
    thread in compiled code, XLA's compiler for one, the process ends after `GRACE`
    seconds: whole files are written or none, and child processes end with it.

    Args:
        command: what to do.
        patient: let a command that has heard the signal take its time to tidy up; else
            it has `GRACE` seconds.
    """
    try:
        output: Any = _ClosableStream(sys.stdout)
        with (
            _terminable(patient),
            contextlib.redirect_stdout(output),
            failures_into(None),
        ):
            command()
    except SystemExit as end:  # help was asked for
        return int(end.code or OK)
    except FlagError as error:
        _print_error(_printable(str(error)))
        return WRONG_INPUT
    except UserError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        _print_error("interrupted")
        return INTERRUPTED
    except RunStopped as stop:
        _print_error(one_line(str(stop)))
        return stop.status
    except LoggedError as error:
        _print_error(f"failed: {error}")
        return FAILED
    return OK


@contextlib.contextmanager
def _terminable(patient: bool) -> Generator[None]:
    """Let SIGTERM, SIGHUP and Ctrl-C end the command in the block tidily, as `run`
    says.

    A training that has something to save replaces the handlers.
    """
    if signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    answered = threading.Event()
    heard = set[int]()

    def stop(number: int, _: object) -> None:
        heard.add(number)
        if patient:
            answered.set()
        raise KeyboardInterrupt if number == signal.SIGINT else _stopped(number)

    def insist(number: signal.Signals) -> None:
        if not answered.wait(GRACE):
            _print_error(
                "interrupted" if number == signal.SIGINT else str(_stopped(number))
            )
            # Semaphores are given back, and a run without its first checkpoint is
            # removed. No public function does so.
            pkgutil.resolve_name("multiprocessing.util:_run_finalizers")(0)
            os._exit(128 + number)

    default_handlers = (signal.SIG_DFL, signal.default_int_handler)
    numbers = [
        number for number in STOPPING if signal.getsignal(number) in default_handlers
    ]
    with handling(numbers, stop, insist):
        try:
            yield
        except KeyboardInterrupt:
            if not (other := heard - {signal.SIGINT}):
                raise
            # CasADi turns each signal into this exception
            raise _stopped(max(other)) from None
        finally:
            answered.set()


def _stopped(number: int) -> RunStopped:
    """Return the exception that ends a command after a signal other than Ctrl-C."""
    return RunStopped(f"stopped by {signal.Signals(number).name}", 128 + number)


def _print_error(line: str) -> None:
    """Print a line on standard error, unless its terminal is closed."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        _redirect_to_null(sys.stderr)


def _refuse(mistake: str) -> int:
    """Say a user's mistake in one line, and return the exit status."""
    _print_error(f"error: {one_line(mistake)}")
    return WRONG_INPUT


def _printable(text: str) -> str:
    """Return a text with unprintable characters escaped, line by line."""
    shown = (
        "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        for line in text.splitlines()
    )
    return "\n".join(shown)


def _redirect_to_null(stream: Any) -> None:
    """Redirect a stream without a reader to the null device."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _ClosableStream:
    """A standard output that discards text once its reader has left, and says so once
    on standard error."""

    def __init__(self, stream: Any):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            self._stream.write(text)
            self._stream.flush()
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EIO):  # a pipe's and a terminal's
                raise
            _redirect_to_null(self._stream)
            _print_error(
                "standard output was closed; the command goes on without output"
            )
        return len(text)


class LoggedError(Exception):
    """A failure in one line, which names the log file of its traceback."""


@contextlib.contextmanager
def failures_into(folder: Path | None) -> Generator[None]:
    """Write the traceback of a failure in the block to a log file, and raise a
    `LoggedError`.

    Args:
        folder: where the log goes, if it exists by then; else, as with None, among the
            temporary files.
    """
    try:
        yield
    except (UserError, RunStopped, LoggedError):
        raise
    except Exception as error:
        there = folder is not None and os.access(folder, os.W_OK)
        with tempfile.NamedTemporaryFile(
            "w",
            prefix="failure-",
            suffix=".log",
            dir=folder if there else None,
            delete=False,
        ) as log:
            traceback.print_exception(error, file=log)
        raise LoggedError(
            f"{type(error).__name__}: {one_line(str(error))}; log: {log.name}"
        ) from error


def dated_folder(name: str) -> Path:
    """Return the folder of a report for which the user named none."""
    return Path("reports") / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}"


@dataclasses.dataclass(frozen=True)
class Command(Generic[Config]):
    """A command: its flags as a dataclass, and the function that runs it.

    Args:
        prog: the command as the user types it.
        arguments: the dataclass of its flags.
        run: the command's function of an instance of that dataclass.
        default: makes the instance that holds where no flag says otherwise, from the
            words of the command line; by default the dataclass's own.
        screen: as of `parse`.
    """

    prog: str
    arguments: type[Config]
    run: Callable[[Config], None]
    default: Callable[[Sequence[str]], Config] | None = None
    screen: str = ""

    def __call__(self, words: Sequence[str]) -> int:
        """Read the flags, run the command, and return the exit status."""

        def command() -> None:
            show_screen(words, self.prog, self.screen, self.arguments)
            default = None if self.default is None else self.default(words)
            self.run(parse(self.arguments, words, self.prog, default))

        return run(command)

    @property
    def description(self) -> str:
        """Description of the command: the first paragraph of its flags' docstring."""
        text = " ".join((self.arguments.__doc__ or "").split("\n\n")[0].split())
        return text[:1].lower() + text[1:].rstrip(".")


def show_screen(
    words: Sequence[str], prog: str, screen: str, arguments: type[object]
) -> None:
    """Print a command's short help and end with status 0, if the command line asks for
    help.

    Args:
        words: the command line.
        prog: the command as the user types it, for {prog} in the screen.
        screen: what `--help` prints; empty where tyro's own help is short enough.
        arguments: the dataclass of the flags, whose docstring is {what} in the screen.
    """
    if screen and HELP_ALL not in words and not set(HELP).isdisjoint(words):
        paragraphs = inspect.cleandoc(arguments.__doc__ or "").split("\n\n")
        what = "\n\n".join(
            textwrap.fill(paragraph, COLUMNS) for paragraph in paragraphs
        )
        print(screen.replace("{what}", what).replace("{prog}", prog))
        raise SystemExit(OK)


def parse(
    config: type[Config],
    words: Sequence[str],
    prog: str,
    default: Config | None = None,
    screen: str = "",
) -> Config:
    """Parse a command line into an instance of the dataclass `config`; for `--help`,
    print the help and exit.

    Args:
        config: a dataclass; its docstring and its fields' are the help.
        words: the command line.
        prog: the command as the user types it.
        default: what holds where no flag says otherwise; None for the dataclass's own
            defaults.
        screen: what `--help` prints, as of `show_screen`; `--help-all` is tyro's.

    Raises:
        UserError: what the config refuses; a `FlagError` where it is not even reached.
    """
    import tyro

    show_screen(words, prog, screen, config)
    with _mistakes_raised():
        return tyro.cli(
            config,
            prog=prog,
            args=["--help"] if HELP_ALL in words else words,
            default=tyro.MISSING_NONPROP if default is None else default,
            config=(tyro.conf.AvoidSubcommands,),
        )


def parse_known(config: type[Config], words: Sequence[str], prog: str) -> Config:
    """Parse the flags of a command line that belong to `config`; ignore all others, and
    `--help`."""
    import tyro

    with _mistakes_raised():
        config_flags, _ = tyro.cli(
            config,
            prog=prog,
            args=words,
            return_unknown_args=True,
            add_help=False,
        )
    return config_flags


@contextlib.contextmanager
def _mistakes_raised() -> Generator[None]:
    """Raise an error for a wrong command line where tyro would print and exit: the
    config's `UserError`, else a `FlagError`."""
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            yield
    except SystemExit as end:
        if end.code == OK:
            raise
        cause: BaseException | None = end
        while cause is not None and not isinstance(cause, UserError):
            cause = cause.__context__
        raise cause or FlagError(errors.getvalue()) from None


def entries(commands: Mapping[str, Command[Any]]) -> dict[str, Entry]:
    """Return the list entries (description and main) of commands, by name."""
    return {name: (command.description, command) for name, command in commands.items()}


def modules(package: str, commands: Mapping[str, str]) -> dict[str, Entry]:
    """Return the list entries of command modules, by name; a module is imported when
    its command runs."""

    return {
        name: (what, functools.partial(run_module, f"{package}.{name}"))
        for name, what in commands.items()
    }


def run_module(name: str, words: Sequence[str] | None = None) -> int:
    """Run the `main` of a command's module and return the exit status; a package that
    the module needs and Python lacks is reported in one line.

    The scripts `train.py` and `eval.py` give no `words`: the process's own hold.
    """
    try:
        module = importlib.import_module(name)
    except UserError as missing:
        return _refuse(str(missing))
    except ModuleNotFoundError as missing:
        return _refuse(
            f"this Python lacks {missing.name}: activate the environment, `. .venv/bin/activate`"
        )
    return module.main(words)


def listed(meanings: Mapping[str, str]) -> str:
    """Return names with their meanings as the lines of a help screen."""
    wide = max(map(len, meanings)) + 2
    return "\n".join(
        textwrap.fill(
            meaning,
            COLUMNS,
            initial_indent=f"  {name:{wide}}",
            subsequent_indent=" " * (wide + 2),
        )
        for name, meaning in meanings.items()
    )


def choose(prog: str, commands: Mapping[str, Entry], words: Sequence[str]) -> int:
    """Run the command named first in `words`, or list all commands; return the exit
    status."""
    if not words or words[0] in HELP:
        print(
            f"usage: {prog} COMMAND ...",
            "\ncommands:",
            listed({name: what for name, (what, _) in commands.items()}),
            f"\n`{prog} COMMAND --help` shows a command's flags.",
            sep="\n",
            file=sys.stdout if words else sys.stderr,
        )
        return OK if words else WRONG_INPUT
    name, *rest = words
    if name not in commands:
        near = did_you_mean(name, commands) or f"; {prog} has: {', '.join(commands)}"
        return _refuse(f"no command {name!a}{near}")
    return commands[name][1](rest)
