"""Errors that end a command with one line: a user's mistake, or a run that stops early
with its work kept."""

import difflib
from collections.abc import Iterable

OK, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit statuses of commands; a command that signal n stopped has 128 + n."""


class UserError(ValueError):
    """Wrong input: one line that says what is wrong and how to correct it; the command
    exits with status 2."""


def not_installed(
    what: str, package: str, extra: str, otherwise: str = ""
) -> UserError:
    """Return the error that names a missing package and the extra that installs it."""
    return UserError(
        f'{what} needs the package {package}: pip install -c constraints.txt -e ".[{extra}]"{otherwise}'
    )


LONGEST_LINE = 2000
"""Longest error message, in characters; the middle of a longer message is left out."""


def one_line(text: str) -> str:
    """Return a text as one printable line: control characters escaped, the middle of a
    long text left out."""
    line = "".join(
        c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split())
    )
    return (
        line
        if len(line) <= LONGEST_LINE
        else f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    )


class RunStopped(Exception):
    """Raised when a run ends before its last step, with its work kept; the line says
    why and how to go on.

    Args:
        message: the line.
        status: the command's exit status: 1 where something failed, 128 + n for signal
            n.
    """

    def __init__(self, message: str, status: int):
        super().__init__(message)
        self.status = status


def require_one_of(what: str, name: object, choices: Iterable[str]) -> None:
    """Raise a `UserError` that lists the choices if `name` is not among them."""
    if name not in (names := tuple(choices)):
        near = did_you_mean(str(name), names) or ":"
        raise UserError(
            f"there is no {what} {name!r}{near} choose one of {', '.join(names)}"
        )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ": did you mean X?" for the word X of `known` that is most similar to
    `word`.

    It is empty where no known word is similar.
    """
    return "".join(
        f": did you mean {near}?"
        for near in difflib.get_close_matches(word, list(known), 1)
    )


def require_kind(
    what: str, value: object, kinds: type | tuple[type, ...], such_as: str
) -> None:
    """Raise a `UserError` with an example if a value has none of the given types."""
    if not isinstance(value, kinds):
        raise UserError(f"{what} takes {such_as}, got {shown(value)}")


def shown(value: object) -> str:
    """Return a value as text for an error message, or only its type where the text is
    long."""
    text = one_line(repr(value))
    return text if len(text) < 80 else f"a {type(value).__name__}"
