"""The house stays small and plain: limits on the statements of each room, on docstrings,
on class names and on untyped values."""

import ast
import collections
import pkgutil
import re
from pathlib import Path

import pytest
from closure import closure, count, modules

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "bp2_rl"
SOURCES = sorted(PACKAGE.rglob("*.py"))
TEXTS = {path: path.read_text(encoding="utf-8") for path in SOURCES}
TREES = {path: ast.parse(text) for path, text in TEXTS.items()}
LIMITS = {
    name: int(most.replace(",", ""))
    for name, most in re.findall(
        r"^ *(\w+)/ +([\d,]+)  ",
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
}
"""Statements at most, by room, as CONTRIBUTING's picture has them."""
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
ELLIPSES = re.compile(
    r"^What |^Whether |\bso (many|long|fast|far|much)\b|\bof (it|them|one|each)\b|"
    r"\b(that|those) of\b|\bas (those|that) of\b|\bin one's?\b|; [a-z`]+: "
)
"""First sentences of docstrings that stand in for nouns."""


def docstrings():
    return [
        (path, text)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(
            node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        )
        and (text := ast.get_docstring(node))
    ]


def test_every_room_has_a_limit():
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert LIMITS.keys() == rooms | {"tests"}


@pytest.mark.parametrize("room", LIMITS)
def test_a_room_does_not_grow_unseen(room):
    folder = ROOT / "tests" if room == "tests" else PACKAGE / room
    assert count(sorted(folder.rglob("*.py"))) <= LIMITS[room]


def test_statements_are_not_packed_to_keep_the_limits():
    nodes = sum(1 for tree in TREES.values() for _ in ast.walk(tree))
    assert 100 * nodes <= 1_783 * count(SOURCES)
    packed = [
        f"{path.name}:{node.lineno}"
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
        and node.end_lineno != node.lineno
    ]
    assert packed == []
    lines = sum(text.count("\n") for text in TEXTS.values())
    assert sum(map(len, TEXTS.values())) <= 40 * lines
    assert sum(text.count("fmt: skip") for text in TEXTS.values()) <= 5


def test_one_training_and_one_evaluation_can_be_read():
    known = modules(PACKAGE)
    assert count([known[name] for name in closure(known)]) <= 8_473


def test_a_class_name_means_one_thing():
    named = collections.Counter(
        node.name
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, times in named.items() if times > 1] == []


def test_docstrings_can_be_read_alone():
    found = docstrings()
    assert [text for _, text in found if text.startswith(MID_THOUGHT)] == []
    assert [text for _, text in found if STAND_INS.search(text)] == []
    first = [
        (path.name, " ".join(text.split("\n\n")[0].split())) for path, text in found
    ]
    assert len([1 for _, text in first if ELLIPSES.search(text)]) <= 20


def test_types_are_rarely_left_open():
    untyped = sum(len(re.findall(r"\bAny\b", text)) for text in TEXTS.values())
    ignored = re.findall(r"(?:type|pyright): *ignore", "\n".join(TEXTS.values()))
    assert untyped <= 268
    assert len(ignored) <= 10


def test_the_walks_through_the_house_name_what_there_is():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    walks = text[text.index("Two walks through") : text.index("[Words](docs")]
    names = re.findall(r"`([a-z_]+(?:\.\w+)+)`", walks)
    assert len(names) > 15
    for name in names:
        assert pkgutil.resolve_name(f"bp2_rl.{name}")
