"""How every command ends: 0 done; 2 a user's mistake; 1 a failure, with what to do or the place of its log; 128 + n
stopped by signal n, with the work kept. All but 0 with one line on standard error."""

import contextlib
import io
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro

from bp2_rl.errors import RunStopped, UserError

Config = TypeVar("Config")

HELP = ("-h", "--help")
OK, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130


def run(command: Callable[[], None]) -> int:
    """Run a command and turn how it ends into an exit status; no traceback reaches the terminal."""
    try:
        command()
    except UserError as error:
        print(f"error: {_one_line(str(error))}", file=sys.stderr)
        return WRONG_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except RunStopped as stop:
        print(_one_line(str(stop)), file=sys.stderr)
        return stop.status
    except Exception as error:
        logged = error if isinstance(error, LoggedError) else LoggedError(error)
        print(f"failed: {logged}", file=sys.stderr)
        return FAILED
    return OK


class LoggedError(Exception):
    """A failure whose traceback is written down: in `folder` where there is one, else among the temporary files."""

    def __init__(self, error: Exception, folder: Path | None = None):
        folder = folder if folder is not None and os.access(folder, os.W_OK) else None
        with tempfile.NamedTemporaryFile("w", prefix="failure-", suffix=".log", dir=folder, delete=False) as log:
            traceback.print_exception(error, file=log)
        super().__init__(f"{type(error).__name__}: {_one_line(str(error))}; log: {log.name}")


@contextlib.contextmanager
def failures_into(folder: Path) -> Iterator[None]:
    """The traceback of a failure within goes into `folder`, if it is there by then."""
    try:
        yield
    except (UserError, RunStopped):
        raise
    except Exception as error:
        raise LoggedError(error, folder) from error


def parse(
    config: type[Config], argv: Sequence[str] | None, prog: str, default: Config | None = None, *, part: bool = False
) -> Config:
    """The config that the command line describes; `--help` prints and exits with status 0.

    Args:
        config: a dataclass; its docstring and its fields' are the help.
        argv: the arguments; None for the process's own.
        prog: the command as the user types it.
        default: what holds where no flag says otherwise; None for the dataclass's own defaults.
        part: pass over flags that are not the config's, and over `--help`.

    Raises:
        UserError: one line that names the flag at fault.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            # To tyro, None is a default like any other.
            chosen: dict[str, Any] = {} if default is None else {"default": default}
            if part:
                argv = [word for word in (sys.argv[1:] if argv is None else argv) if word not in HELP]
                return tyro.cli(config, args=argv, prog=prog, return_unknown_args=True, **chosen)[0]
            return tyro.cli(config, args=argv, prog=prog, **chosen)
    except SystemExit as end:
        if end.code in (0, None):
            raise
        raise UserError(f"{_in_one_line(complaint.getvalue())} (see {prog} --help)") from None


def _in_one_line(box: str) -> str:
    """What tyro says in the framed message it prints: up to its first rule or blank line, and the flag it suggests."""
    lines = [line.strip("│ ─") for line in box.splitlines() if not re.match("[╭╰]", line)]
    end = lines.index("") if "" in lines else len(lines)
    text = _one_line(" ".join(lines[:end])).rstrip(".") or "wrong command line"
    suggestion = re.search(r"Perhaps you meant:\s+(--[\w.-]+)", " ".join(lines))
    return f"{text}; perhaps {suggestion[1]}?" if suggestion else text


def _one_line(text: str) -> str:
    return " ".join(text.split())
