"""The house stays small and plain: limits on statements, imports, class names,
docstrings and ignored types."""

import ast
import collections
import re
from pathlib import Path

import pytest
from closure import closure, count, modules

PACKAGE = Path(__file__).parents[1] / "bp2_rl"
SOURCES = sorted(PACKAGE.rglob("*.py"))
MID_THOUGHT = (
    "The same",
    "Likewise",
    "That of",
    "Those",
    "Their",
    "Of ",
    "And back",
    "Nothing",
    "There is none",
    "It ",
    "Its ",
)
STAND_INS = re.compile(
    r"\b(he|him|his|whose robot|who stands|likewise|the former|the latter)\b",
    re.IGNORECASE,
)


def nodes():
    return [
        (path, node)
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    ]


def docstrings():
    return [
        (path, text)
        for path, node in nodes()
        if isinstance(
            node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        )
        and (text := ast.get_docstring(node))
    ]


@pytest.mark.parametrize(
    ("what", "paths", "most"),
    [
        ("all", SOURCES, 20_600),
        (
            "the core",
            [
                path
                for path in SOURCES
                if "paper" not in path.relative_to(PACKAGE).parts
            ],
            14_297,
        ),
    ],
)
def test_the_house_does_not_grow_unseen(what, paths, most):
    assert count(paths) <= most, (
        f"{what} has grown: take something away, or raise the limit and say why"
    )


def test_one_training_and_one_evaluation_can_be_read():
    known = modules(PACKAGE)
    assert count([known[name] for name in closure(known)]) <= 7_750


def test_a_class_name_means_one_thing():
    named = collections.Counter(
        node.name for _, node in nodes() if isinstance(node, ast.ClassDef)
    )
    assert [name for name, times in named.items() if times > 1] == []


def test_docstrings_can_be_read_alone():
    assert [
        (str(path), text.splitlines()[0])
        for path, text in docstrings()
        if text.startswith(MID_THOUGHT)
    ] == []
    assert [
        (str(path), found[0])
        for path, text in docstrings()
        if (found := STAND_INS.search(text))
    ] == []


def test_types_are_rarely_ignored():
    ignored = [
        path
        for path in SOURCES
        for _ in re.findall(
            r"(?:type|pyright): *ignore", path.read_text(encoding="utf-8")
        )
    ]
    assert len(ignored) <= 10, ignored
