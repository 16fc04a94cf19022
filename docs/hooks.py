"""Hooks of `mkdocs`, which add pages to those of this folder: files of the repository's
root, and every command's help."""

import contextlib
import importlib
import importlib.util
import io
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from bp2_rl.cli import __main__ as bp2

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}
COLUMNS = "80"  # of the terminal in which the help is printed
INTRODUCTION = """# Commands

This page is the output of `--help-all` on a machine without a GPU, where `bp2 train` takes the preset `cpu`.
`python train.py` is `bp2 train`, and `python eval.py` is `bp2 eval`.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not files in `docs/`."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=_linked(ROOT / source)))
    files.append(File.generated(config, "reference/commands.md", content=_commands()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Redirect links to files of the root, which work when browsing the repository, to
    their pages.

    Give public names the heading that users type, such as `bp2.rollout`.
    """
    markdown = re.sub(
        r"^::: bp2_rl(\.\w+)$",
        r"\g<0>\n    options: {heading: bp2\1, toc_label: bp2\1}",
        markdown,
        flags=re.M,
    )
    names = "|".join(map(re.escape, PAGES))
    return re.sub(
        rf"\]\(\.\./((?:\.\./)*)({names})",
        lambda match: f"]({match[1]}{PAGES[match[2]]}",
        markdown,
    )


def _linked(source: Path) -> str:
    """Return the text of a file of the root, with links relative to `docs/`; links to
    code become plain text."""

    def link(found: re.Match[str]) -> str:
        text, target, anchor = found["text"], found["target"], found["anchor"] or ""
        if target in PAGES:
            return f"[{text}]({PAGES[target]}{anchor})"
        if target.startswith("docs/"):
            return f"[{text}]({target.removeprefix('docs/')}{anchor})"
        return found[0] if "://" in target else f"`{text}`"

    return re.sub(
        r"\[(?P<text>[^]]*)\]\((?P<target>[^)#]+)(?P<anchor>#[^)]*)?\)",
        link,
        source.read_text(encoding="utf-8"),
    )


def _commands() -> str:
    sections = [INTRODUCTION, "## bp2\n", _block(["--help"])]
    for name in bp2.COMMANDS:
        sections += _sections("##", "bp2_rl.cli", [name])
    return "\n".join(sections)


def _sections(heading: str, package: str, words: list[str]) -> list[str]:
    """Return the help of a command of this package, and of its subcommands, with a
    section for each."""
    sections = [f"{heading} bp2 {' '.join(words)}\n", _block([*words, "--help-all"])]
    below = "bp2_rl.paper.cli" if words == ["paper"] else f"{package}.{words[-1]}"
    if (
        hasattr(importlib.import_module(package), "__path__")
        and importlib.util.find_spec(below) is not None
    ):
        for part in getattr(importlib.import_module(below), "COMMANDS", ()):
            sections += _sections(f"{heading}#", below, [*words, part])
    return sections


def _block(words: list[str]) -> str:
    output = io.StringIO()
    with _terminal(), contextlib.redirect_stdout(output):
        try:
            status = bp2.main(words)
        except SystemExit as end:
            status = end.code
    if status:
        raise RuntimeError(f"bp2 {' '.join(words)} ended with status {status}")
    lines = [
        line.rstrip()
        for line in output.getvalue().replace(str(Path.home()), "~").splitlines()
    ]
    return "\n".join(["```text", *lines, "```\n"])


@contextlib.contextmanager
def _terminal() -> Iterator[None]:
    """Context manager for a terminal as wide as a page and without colours, which
    restores the environment."""
    with mock.patch.dict(
        os.environ, {"COLUMNS": COLUMNS, "NO_COLOR": "1", "JAX_PLATFORMS": "cpu"}
    ):
        yield
