"""What `--help` prints: aligned columns on one screen; `--help-all` prints every
setting, in sections."""

import inspect
import pkgutil
import re
import shutil
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from bp2_rl.base.errors import did_you_mean

HELP_ALL = "--help-all"
HELP = ("-h", "--help", HELP_ALL)
SCREEN = 60  # lines
WIDEST = 110  # columns
FLAGS = 34  # columns; the words of a longer flag begin on the next line


class Flag(NamedTuple):
    """An argument or a flag: its names, how it is written, and what it does."""

    names: tuple[str, ...]  # without the dashes; empty for an argument
    written: str
    what: str


class HelpSection(NamedTuple):
    """The settings of one dataclass."""

    # of the field that holds the dataclass, `env.hardware`; empty for the command's own
    # flags
    name: str
    what: str
    flags: Sequence[Flag]


def is_asked(words: Iterable[str]) -> bool:
    """Return whether a command line asks for help."""
    return not set(HELP).isdisjoint(words)


def describe(
    config: type[Any],
    prog: str,
    default: Any = None,
    everyday: Mapping[str, Sequence[str]] | None = None,
    note: str = "",
    everything: bool = False,
) -> str:
    """Return the help of a command.

    Args:
        config: the dataclass of its flags; the section `Examples:` of its docstring
            ends the help.
        prog: the command as the user types it.
        default: the instance whose values are shown as defaults; None for the
            dataclass's own defaults.
        everyday: headings and flags of the screen that stands for a longer help; None
            for those that are not nested.
        note: a sentence after the description.
        everything: show all flags, however many there are.
    """
    parser = _parser(config, prog, default)
    sections = list(_sections(parser))
    given = [
        action
        for action in parser._actions
        if action.required or not action.option_strings
    ]
    words = [
        _flag(action).written if action.required else f"[{_flag(action).written}]"
        for action in given
    ]
    head = [
        " ".join(("usage:", prog, *words, "[FLAGS]")),
        *_wrap(f"{parser.description or ''} {note}"),
    ]
    whole = [
        line
        for section in sections
        for line in _show(section.what or "flags", section.flags)
    ]
    foot = _examples(config)
    if everything or len(head) + len(whole) + len(foot) <= SCREEN:
        return "\n".join([*head, *whole, *foot])
    known = {
        name: flag
        for section in sections
        for flag in section.flags
        for name in flag.names or (flag.written,)
    }
    own = {
        "flags": [
            flag.names[0] if flag.names else flag.written for flag in sections[0].flags
        ]
    }
    chosen = {
        title: [known[name] for name in names]
        for title, names in (everyday or own).items()
    }
    shown = [flag for flags in chosen.values() for flag in flags]
    # name of a nested dataclass -> what it is, and how many flags are not shown
    rest: dict[str, tuple[str, int]] = {}
    for section in sections:
        if hidden := len(set(section.flags) - set(shown)):
            name = ".".join(section.name.split(".")[:2])
            what, count = rest.get(name, (re.split("[:;,] ", section.what)[0], 0))
            rest[name] = what, count + hidden
    more = [
        Flag((), f"--{name}.*", f"{what} ({count})")
        for name, (what, count) in rest.items()
    ]
    short = [line for title, flags in chosen.items() for line in _show(title, flags)]
    return "\n".join(
        [*head, *short, *_show(f"all of them with {HELP_ALL}", more), *foot]
    )


def _examples(config: type[Any]) -> list[str]:
    _, _, lines = inspect.cleandoc(config.__doc__ or "").partition("\nExamples:\n")
    return (
        ["", "examples:", *textwrap.indent(textwrap.dedent(lines), "  ").splitlines()]
        if lines
        else []
    )


def one_of_several() -> tuple[Any, ...]:
    """Return tyro's setting by which a field that may hold several dataclasses has the
    flags of the one it holds."""
    import tyro  # not for `bp2 --help`

    return (tyro.conf.AvoidSubcommands,)


def nearest_flag(word: str, config: type[Any], prog: str, default: Any) -> str:
    """Return the question whether a command's flag was meant that is spelled somewhat
    like a word."""
    return did_you_mean(word, _parser(config, prog, default)._option_string_actions)


def _parser(config: type[Any], prog: str, default: Any) -> Any:
    """Return an ArgumentParser of tyro's own copy of argparse."""
    # no public function that is not deprecated
    get_parser = pkgutil.resolve_name("tyro.extras:get_parser")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        chosen: dict[str, Any] = {} if default is None else {"default": default}
        return get_parser(
            config, prog=prog, add_help=False, config=one_of_several(), **chosen
        )


def _sections(parser: Any) -> Iterator[HelpSection]:
    """Yield the command's own arguments and flags, then each nested dataclass's."""
    groups = {group.title or "": group for group in parser._action_groups}
    flags = {
        title: [_flag(action) for action in group._group_actions]
        for title, group in groups.items()
    }
    yield HelpSection(
        "", "", flags.pop("positional arguments", []) + flags.pop("options", [])
    )
    for title, some in flags.items():
        what = re.split(r"\.\s|\.$|\n\n", groups[title].description or "")[0]
        yield HelpSection(title.removesuffix(" options"), " ".join(what.split()), some)


def _flag(action: Any) -> Flag:
    names = tuple(name.removeprefix("--") for name in action.option_strings)
    what = " ".join((action.help or "").replace("%%", "%").split())
    for pattern, default in (
        (r" ?\(default: None\)", ""),
        (r"\(default: True\)", "[on]"),
        (r"\(default: False\)", "[off]"),
        (r"\(default: (.*)\)$", r"[\1]"),
    ):
        what = re.sub(pattern, default, what)
    if len(names) == 2:  # --video, --no-video
        path, dot, name = names[0].rpartition(".")
        return Flag(names, f"--{path}{dot}[no-]{name}", what)
    takes = re.sub(
        r"\{None\}\||(?<=\{)None,|,None(?=[,}])", "", str(action.metavar or "")
    )
    takes = re.sub(r"^\{([^,]*)\}$", r"\1", takes)  # a choice of one
    return Flag(names, " ".join(filter(None, (*action.option_strings, takes))), what)


def _show(title: str, flags: Iterable[Flag]) -> list[str]:
    return [
        "",
        f"{title}:",
        *lay_out(((flag.written, flag.what) for flag in flags), FLAGS),
    ]


def lay_out(rows: Iterable[tuple[str, str]], column: int) -> list[str]:
    """Return lines of names, and of words that begin in a column; a name that reaches
    it has its own line."""
    lines: list[str] = []
    for name, words in rows:
        text = _wrap(words, " " * column)
        if len(name) + 4 > column:
            lines += [f"  {name}", *text]
        else:
            lines += [
                f"  {name:{column - 2}}{text[0].strip() if text else ''}",
                *text[1:],
            ]
    return lines


def _wrap(text: str, indent: str = "") -> list[str]:
    width = min(shutil.get_terminal_size().columns, WIDEST)
    return [
        line
        for paragraph in text.strip().split("\n\n")
        for line in textwrap.wrap(
            " ".join(paragraph.split()),
            width,
            initial_indent=indent,
            subsequent_indent=indent,
            break_on_hyphens=False,
        )
    ]
