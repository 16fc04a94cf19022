"""`bp2 paper figures --all` as a user meets it, with a few of its commands."""

import json
import os
import re

import pytest

import bp2_rl
from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.paper.cli import figures
from bp2_rl.paper.cli import index as all_figures
from bp2_rl.paper.cli.index import IndexReport
from bp2_rl.paper.index.item import Check, Item
from bp2_rl.paper.index.sources import Source

PEAK = "torque:results/lengths/length=1.0/peak/0"
SOURCES = (
    Source("torque", ("paper", "figures", "torque")),
    Source("bad", ("paper", "figures", "torque", "--frequency", "-1")),
    Source("after", ("paper", "figures", "race"), runs=("bad",)),
    Source("later", ("eval", "--benchmark", "later"), benchmark="later"),
)
GROUPS = {
    "Figures": (
        Item(
            "Fig. 1",
            "a < b",
            "torque/torque.png",
            ours="{" + PEAK + "|.3f}",
            checks=(Check(PEAK, 0.0, 1.0),),
        ),
        Item("Fig. 2", "x", "bad", stated="same"),
        Item("Fig. 3", "x", "after", stated="same"),
        Item("Fig. 4", "x", "later", stated="same"),
        Item("Fig. 5", "x", stated="needs hardware", because="a photograph"),
    )
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make the index of a few commands once, and yield its folder."""
    folder = tmp_path_factory.mktemp("all") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(all_figures, "SOURCES", SOURCES)
        patch.setattr(all_figures, "read_items", lambda: GROUPS)
        assert figures.main(["--all", "--out", str(folder)]) == 0
        yield folder


def test_the_page_holds_the_numbers_of_the_files_and_loads_nothing(made):
    page = (made / "index.html").read_text()
    report = json.loads((made / "torque" / "metrics.json").read_text())
    peak = next(one for one in report["results"]["lengths"] if one["length"] == 1.0)[
        "peak"
    ][0]
    shown = re.findall(r'<data data-at="(.*?)" value="(.*?)">(.*?)</data>', page)
    assert shown == [(PEAK, json.dumps(peak), f"{peak:.3f}")]
    assert load_config(IndexReport, made / "metrics.json").numbers == {
        "fig-1": {PEAK: peak}
    }
    ids = re.findall(r'id="?([\w-]+)', page)
    assert {item.id for item in GROUPS["Figures"]} <= set(ids)
    assert re.findall(r'<a href="(.*?)"', page) == ["#torque-torque-png"]
    assert "torque-torque-png" in ids
    loads = re.findall(r'(?:src|srcset|<link[^>]*href)="(.*?)"', page)
    assert loads
    assert all(load.startswith("data:") for load in loads)
    assert "a &lt; b" in page


def test_a_log_names_the_folder_where_its_command_left_its_report(made):
    log = (made / "torque" / "log.txt").read_text()
    assert f"pictures and numbers: {made / 'torque'}\n" in log


def test_a_command_that_cannot_be_run_costs_its_own_rows_alone(made):
    report = load_config(IndexReport, made / "metrics.json")
    assert report.verdicts == {
        "fig-1": "same",
        "fig-2": "not run",
        "fig-3": "not run",
        "fig-4": "not run",
        "fig-5": "needs hardware",
    }
    assert report.missing["bad"].startswith("failed: error: ")
    assert report.missing["after"] == "left out, as bad failed"
    assert "choose one of topspeed, sprint" in report.missing["later"]
    assert (
        "<code>bp2 eval --benchmark later</code>" in (made / "index.html").read_text()
    )
    assert set(report.commands) == set(report.seconds) == {"torque"}


def test_what_was_made_is_taken_as_it_is_until_its_numbers_are_touched(
    made, capsys, monkeypatch
):
    monkeypatch.setattr(all_figures, "SOURCES", SOURCES[:1])
    again = ["--all", "--out", str(made)]
    before = (made / "torque" / "made.json").read_bytes()
    assert figures.main(again) == 0
    assert "torque         as it was" in capsys.readouterr().out
    assert (made / "torque" / "made.json").read_bytes() == before
    (made / "torque" / "metrics.json").write_text("{}")
    assert figures.main(again) == 0
    assert "results" in (made / "torque" / "metrics.json").read_text()


def test_a_report_is_current_after_its_inputs_and_of_its_words_and_version(
    tmp_path, monkeypatch
):
    made, read = tmp_path / "made.json", tmp_path / "policy"
    read.touch()
    words = ["eval", "a"]
    save_config(made, all_figures.CommandRun(bp2_rl.__version__, tuple(words), 1.0))
    assert all_figures.is_current(tmp_path, words, [read])
    assert not all_figures.is_current(tmp_path, ["eval", "b"], [read])
    assert not all_figures.is_current(tmp_path, words, [read, tmp_path / "gone"])
    os.utime(read, (0, made.stat().st_mtime + 1.0))
    assert not all_figures.is_current(tmp_path, words, [read])
    os.utime(read, (0, 0))
    monkeypatch.setattr(bp2_rl, "__version__", "another")
    assert not all_figures.is_current(tmp_path, words, [read])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--policy", "nowhere"], "--policy nowhere is no folder"),
        (["--out", "there"], "--out there holds other files"),
    ],
)
def test_a_mistake_is_one_line(words, says, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "letter.txt").touch()
    assert figures.main(["--all", *words]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
