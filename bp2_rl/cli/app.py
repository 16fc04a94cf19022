"""How every command ends: 0 done; 2 a user's mistake; 1 a failure, with what to do or
the place of its log; 128 + n stopped by signal n, with the work kept. All but 0 with
one line on standard error."""

import contextlib
import errno
import io
import os
import pkgutil
import re
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro

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
from bp2_rl.base.processes import STOPPING, listening
from bp2_rl.cli import usage

Config = TypeVar("Config")

GRACE = 3.0  # s


def run(command: Callable[[], None], *, patient: bool = True) -> int:
    """Run a command and turn how it ends into an exit status; no traceback reaches the
    terminal.

    SIGTERM and SIGHUP end a command tidily, as Ctrl-C does. Where one finds the main
    thread in compiled code, XLA's compiler for one, the process ends after `GRACE`
    seconds: whole files are written or none, and child processes end with it.

    Args:
        command: what to do.
        patient: let a command that has heard the signal take its time to tidy up; else
            it has `GRACE` seconds.
    """
    try:
        with _terminable(patient), _without_reader():
            command()
    except UserError as error:
        _tell(f"error: {one_line(str(error))}")
        return WRONG_INPUT
    except KeyboardInterrupt:
        _tell("interrupted")
        return INTERRUPTED
    except RunStopped as stop:
        _tell(one_line(str(stop)))
        return stop.status
    except Exception as error:
        logged = error if isinstance(error, LoggedError) else LoggedError(error)
        _tell(f"failed: {logged}")
        return FAILED
    return OK


@contextlib.contextmanager
def _terminable(patient: bool) -> Generator[None]:
    """See `run`; a training that has something to save replaces the handlers."""
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL
    ):
        yield
        return
    answered, heard = threading.Event(), set[int]()

    def stop(number: int, _: object) -> None:
        heard.add(number)
        if patient:
            answered.set()
        raise KeyboardInterrupt if number == signal.SIGINT else _stopped(number)

    def insist(number: signal.Signals) -> None:
        if number in STOPPING and not answered.wait(GRACE):
            _tell("interrupted" if number == signal.SIGINT else str(_stopped(number)))
            # Semaphores are given back, and a run without its first checkpoint is
            # removed. no public function does so
            pkgutil.resolve_name("multiprocessing.util:_run_finalizers")(0)
            os._exit(128 + number)

    before = {number: signal.getsignal(number) for number in STOPPING}
    with listening(insist):
        for number, handler in before.items():
            if handler in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, stop)
        try:
            yield
        except KeyboardInterrupt:
            if not (other := heard - {signal.SIGINT}):
                raise
            # CasADi turns each signal into this exception
            raise _stopped(max(other)) from None
        finally:
            answered.set()
            for number, handler in before.items():
                signal.signal(number, handler)


def _stopped(number: int) -> RunStopped:
    """Return how a signal other than Ctrl-C ends a command."""
    return RunStopped(f"stopped by {signal.Signals(number).name}", 128 + number)


def _tell(line: str) -> None:
    """Say a line on standard error, unless its terminal is closed."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        _forget(sys.stderr)


def _forget(stream: Any) -> None:
    """Let a stream without a reader swallow what is written from now on, and what is
    still buffered."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextlib.contextmanager
def _without_reader() -> Generator[None]:
    """Go on where the reader of standard output ends early, as `head` and a terminal
    may: the results are on disk."""
    stream = sys.stdout
    sys.stdout = _ClosableStream(stream)
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout = stream


class _ClosableStream:
    """A stream that says so once, on standard error, when its reader has left, and
    swallows the rest."""

    def __init__(self, stream: Any):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._leaving():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._leaving():
            self._stream.flush()

    @contextlib.contextmanager
    def _leaving(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EIO):  # a pipe's and a terminal's
                raise
            _forget(self._stream)
            _tell("standard output was closed; the command goes on without output")


class FlagError(UserError):
    """An unknown flag or a value of another type: a mistake with any defaults."""


class LoggedError(Exception):
    """A failure whose traceback is written down: in `folder` where there is one, else
    among the temporary files."""

    def __init__(self, error: Exception, folder: Path | None = None):
        folder = folder if folder is not None and os.access(folder, os.W_OK) else None
        with tempfile.NamedTemporaryFile(
            "w", prefix="failure-", suffix=".log", dir=folder, delete=False
        ) as log:
            traceback.print_exception(error, file=log)
        super().__init__(
            f"{type(error).__name__}: {one_line(str(error))}; log: {log.name}"
        )


@contextlib.contextmanager
def failures_into(folder: Path) -> Generator[None]:
    """The traceback of a failure within goes into `folder`, if it is there by then."""
    try:
        yield
    except (UserError, RunStopped):
        raise
    except Exception as error:
        raise LoggedError(error, folder) from error


def parse(
    config: type[Config],
    argv: Sequence[str] | None,
    prog: str,
    default: Config | None = None,
    *,
    part: bool = False,
) -> Config:
    """Return the config that the command line describes; `--help` prints and exits with
    status 0.

    Args:
        config: a dataclass; its docstring and its fields' are the help.
        argv: the arguments; None for the process's own.
        prog: the command as the user types it.
        default: what holds where no flag says otherwise; None for the dataclass's own
            defaults.
        part: pass over flags that are not the config's, and over `--help`.

    Raises:
        UserError: one line that names the flag at fault.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if usage.is_asked(words) and not part:
        print(usage.describe(config, prog, default, everything=usage.HELP_ALL in words))
        raise SystemExit(OK)
    complaint = io.StringIO()
    # To tyro, None is a default like any other.
    chosen: dict[str, Any] = {
        "prog": prog,
        "add_help": False,
        "config": usage.one_of_several(),
    } | ({} if default is None else {"default": default})
    try:
        with contextlib.redirect_stderr(complaint):
            if part:
                return tyro.cli(config, args=words, return_unknown_args=True, **chosen)[
                    0
                ]
            return tyro.cli(config, args=words, **chosen)
    except SystemExit:
        said = _in_one_line(complaint.getvalue())
        if unknown := re.match("unknown option ([^=]+)", said):
            said = unknown[0] + usage.nearest_flag(unknown[1], config, prog, default)
        line = f"{said} (see {prog} --help)"
        raise (
            UserError
            if re.search(r"Error parsing (?!--)", complaint.getvalue())
            else FlagError
        )(line) from None


def _in_one_line(box: str) -> str:
    """What tyro says in the message it prints, in a user's words, without its frame,
    its title and its foot."""
    if "Missing from" in box:
        names = re.findall(r"^(?:│ | ) {4,5}(\S.*?) *│?$", box, re.MULTILINE)
        return f"missing: {', '.join(name.strip('{}') for name in names)}"
    # else the console knows no such signs, and the title is a paragraph
    framed = box.lstrip().startswith("╭")
    lines = [
        line.strip("│ ").strip()
        for line in box.splitlines()
        if not re.match("[╭╰]", line)
    ]
    paragraphs = (
        "\n".join("" if re.fullmatch("[─-]*", line) else line for line in lines)
        .strip("\n")
        .split("\n\n")
    )
    text = (
        one_line(paragraphs[0 if framed else min(1, len(paragraphs) - 1)]).rstrip(".")
        or "wrong command line"
    )
    for pattern, words in _WORDS:
        if found := re.search(pattern, text):
            return words(found)
    return text


_KINDS = {
    "FLOAT": "a number",
    "INT": "a whole number",
    "PATH": "a path",
    "STR": "a word",
    "INT INT": "two whole numbers",
}
_WORDS: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (
        r"Error parsing (\S+): no type matching (.+?) could be instantiated from \['(.*)'\]",
        lambda found: f"{found[1]} takes {_in_words(found[2])}, got {found[3]}",
    ),
    (
        r"Error parsing (\S+): could not convert string to float: '(.*)'",
        lambda found: f"{found[1]} takes a number, got {found[2]}",
    ),
    (
        r"Error parsing (\S+): invalid literal for int\(\) with base 10: '(.*)'",
        lambda found: f"{found[1]} takes a whole number, got {found[2]}",
    ),
    (
        r"Error parsing (\S+): Could not find valid parse for arguments: \['(.*)'\]",
        lambda found: f"{found[1]} takes numbers, got {found[2]}",
    ),
    (
        r"invalid choice '(.*)' for argument '(\S+)'\. Expected one of \((.*)\)",
        lambda found: (
            f"{found[2]} takes {_choices(found[3])}; got {found[1]}"
            + did_you_mean(found[1], re.findall(r"'([^']+)'", found[3]))
        ),
    ),
    (r"Error parsing (?!--)\S+: (.*)", lambda found: found[1]),
    (r"Missing value for argument '(\S+)'", lambda found: f"{found[1]} needs a value"),
    (r"Unrecognized options: (-[^,]+)", lambda found: f"unknown option {found[1]}"),
    (r"Unrecognized options: ([^,]+)", lambda found: f"unexpected argument {found[1]}"),
)
"""What tyro says in terms of Python, and how a user would say it."""


def _choices(listed: str) -> str:
    """Python's `'a', None, 'b'`, in an order of their own: a or b; None is what a flag
    that is not given stands for."""
    *others, last = sorted(set(re.findall(r"'([^']+)'", listed)) - {"None"})
    return f"{', '.join(others)} or {last}" if others else f"only {last}"


def _in_words(metavar: str) -> str:
    """A type as tyro shows it: `{None}|FLOAT`, a flag that need not be given, takes a
    number."""
    return " or ".join(
        _KINDS.get(kind, kind)
        for part in metavar.split("|")
        if (kind := part.strip("{}")) != "None"
    )
