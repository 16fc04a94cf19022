"""How a command can end but for success and failure: by a user's mistake, or early,
with the work kept."""

import difflib
from collections.abc import Iterable

OK, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit statuses; a command that signal n stopped has 128 + n."""


class UserError(ValueError):
    """Wrong input: one line that says what is wrong and how to mend it; the command
    exits with status 2."""


def not_installed(
    what: str, package: str, extra: str, otherwise: str = ""
) -> UserError:
    """Return the error that names a missing package and the extra that installs it."""
    return UserError(
        f'{what} needs the package {package}: pip install -c constraints.txt -e ".[{extra}]"{otherwise}'
    )


LONGEST_LINE = 2000
"""Characters of a message, beyond which its middle is left out."""


def one_line(text: str) -> str:
    """Return the text without line breaks, and with escapes for what no terminal shows,
    or what steers one."""
    line = "".join(
        c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split())
    )
    return (
        line
        if len(line) <= LONGEST_LINE
        else f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    )


class RunStopped(Exception):
    """A run that ends before its last step, with its work kept: one line that says why
    and how to go on.

    Args:
        message: the line.
        status: the command's exit status: 1 where something failed, 128 + n for signal
            n.
    """

    def __init__(self, message: str, status: int):
        super().__init__(message)
        self.status = status


def require_one_of(what: str, name: object, choices: Iterable[str]) -> None:
    """Raise a `UserError` that lists the choices, unless `name` is one of them."""
    if name not in (names := tuple(choices)):
        near = did_you_mean(str(name), names) or ":"
        raise UserError(
            f"there is no {what} {name!r}{near} choose one of {', '.join(names)}"
        )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the question whether the most similar of the `known` words was meant.

    It is empty where no known word is similar.
    """
    return "".join(
        f": did you mean {near}?"
        for near in difflib.get_close_matches(word, list(known), 1)
    )


def require_kind(
    what: str, value: object, kinds: type | tuple[type, ...], such_as: str
) -> None:
    """Raise a `UserError` with an example where a value is of none of these kinds."""
    if not isinstance(value, kinds):
        raise UserError(f"{what} takes {such_as}, got {shown(value)}")


def shown(value: object) -> str:
    """Return a value for a message: as it is written, or only its type where that is
    long."""
    text = one_line(repr(value))
    return text if len(text) < 80 else f"a {type(value).__name__}"
