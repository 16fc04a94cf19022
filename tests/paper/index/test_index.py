"""The index: no item without a row, and every verdict by what the reports hold."""

import re
from pathlib import Path
from typing import get_args

import pytest
from paper_items import paper_items

from bp2_rl.base.errors import UserError
from bp2_rl.cli import eval as command
from bp2_rl.paper.cli import figures, trajectories
from bp2_rl.paper.cli.eval import DeepBenchmarkName
from bp2_rl.paper.index.item import (
    Check,
    Item,
    ReportNumber,
    fill,
    look_up,
    places,
    read_items,
)
from bp2_rl.paper.index.sources import SOURCES, arguments

SKELETON = Path(__file__).with_name("paper_items.tex")
"""The paper without its words: where its figures, tables, equations and movies are, and
what panels they have."""
ITEMS = [item for group in read_items().values() for item in group]
BY_NAME = {source.name: source for source in SOURCES}
REPORTS = {
    "one": {
        "runs": [{"name": "a.b", "speed": 10.0, "share": 0.5}],
        "said": "wind",
        "none": None,
    }
}


# --- The rows -------------------------------------------------------------------------


def test_no_item_of_the_paper_is_without_a_row():
    of_paper = [item.id for item in ITEMS if not item.beyond]
    assert sorted(paper_items(SKELETON.read_text())) == sorted(of_paper)
    assert len({item.id for item in ITEMS}) == len(ITEMS)


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item.id)
def test_a_row_says_how_it_is_known(item):
    """A number decides, or the row says why none can; every number comes from a command
    that there is."""
    assert bool(item.checks) != bool(item.stated)
    assert item.because or item.stated != "differs"
    assert item.because or item.stated != "needs hardware"
    assert item.source or item.command or item.stated == "needs hardware"
    for at in (*places(item), *(check.at for check in item.checks)):
        assert at.partition(":")[0] in BY_NAME
    assert item.source in ("", *BY_NAME)
    # All braces are places of numbers, and none of them is left as it is.
    assert not re.search(
        r"[{}]", re.sub(r"\{\w+:[^|{}]+\|[^{}]*\}", "", f"{item.ours} {item.because}")
    )


# --- Verdicts -------------------------------------------------------------------------


def row(**rest):
    return fill(
        Item("Fig. 9", "a run", "one", **rest),
        REPORTS,
        {"two": "this version has no bp2 two"},
    )


SHARE = "one:runs/name=a.b/share"


def test_all_checks_decide_and_their_numbers_are_the_files():
    found = row(
        ours="a share of {" + SHARE + "|.0%}, {one:none|.2f} and {one:said|}",
        checks=(Check(SHARE, 0.4, 0.6),),
    )
    assert found.verdict == "same"
    assert [part if isinstance(part, str) else part.text for part in found.ours] == [
        "a share of ",
        "50%",
        ", ",
        "-",
        " and ",
        "wind",
    ]
    assert [part.value for part in found.ours if isinstance(part, ReportNumber)] == [
        0.5,
        None,
        "wind",
    ]
    assert row(checks=(Check(SHARE, 0.4), Check(SHARE, most=0.45))).verdict == "differs"
    assert row(checks=(Check("one:said", words="rain"),)).verdict == "differs"
    assert row(checks=(Check("one:none", most=3.0),)).verdict == "differs"
    assert row(stated="not comparable").verdict == "not comparable"


def test_what_was_not_run_says_why():
    found = row(ours="{two:share|.2f}", stated="same")
    assert (found.verdict, found.ours, found.because) == (
        "not run",
        (),
        ("two: this version has no bp2 two",),
    )


def test_an_entry_is_found_by_place_by_number_and_by_name():
    assert (
        look_up(REPORTS, "one:runs/0/share")
        == look_up(REPORTS, "one:runs/speed=10/share")
        == 0.5
    )
    for path in ("runs/1", "runs/name=c", "said/x", "gone"):
        with pytest.raises(
            UserError, match=f"the report of one has no {path}: remove its folder"
        ):
            look_up(REPORTS, f"one:{path}")


# --- Commands -------------------------------------------------------------------------


def test_commands_are_told_what_is_chosen(tmp_path):
    def told(name):
        return arguments(
            BY_NAME[name], tmp_path, Path("POLICY"), quick=True, film=False
        )

    assert told("endurance") == [
        "paper",
        "eval",
        "POLICY",
        "--benchmark",
        "endurance",
        "--quick",
    ]
    assert told("topspeed")[-1] == "--no-video"
    assert told("race")[3:] == [
        "--runs",
        f"{tmp_path}/sprint",
        f"{tmp_path}/sprint_ideal",
    ]
    assert BY_NAME["endurance"].command == "bp2 paper eval --benchmark endurance"
    assert BY_NAME["exchange"].command == "bp2 paper figures exchange"


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.name)
def test_this_version_has_every_command(source):
    if source.benchmark is not None:
        deep = source.words[0] == "paper"
        names = get_args(DeepBenchmarkName) if deep else command.BENCHMARKS
        assert source.benchmark in names
    else:
        paper, group, name = source.words
        assert paper == "paper"
        assert (
            name in {"figures": figures, "trajectories": trajectories}[group].COMMANDS
        )
