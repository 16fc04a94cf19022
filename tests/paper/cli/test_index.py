"""`bp2 paper figures --all` as a user meets it, with a few of its commands."""

import html.parser
import json

import pytest

from bp2_rl.base.serialization import load_config
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


class Page(html.parser.HTMLParser):
    """What the page shows: numbers by their place, ids, links, and what it would
    load."""

    def __init__(self, text):
        super().__init__()
        self.numbers, self.ids, self.links, self.loads, self._at = (
            {},
            set(),
            [],
            [],
            None,
        )
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        told = dict(attrs)
        if tag == "data":
            self._at = told["data-at"], json.loads(told["value"] or "")
        self.ids |= {told["id"]} if "id" in told else set()
        self.links += [told["href"]] if tag == "a" else []
        self.loads += [
            told[name]
            for name in ("src", "href", "srcset")
            if name in told and tag != "a"
        ]

    def handle_data(self, data):
        if self._at:
            self.numbers[self._at[0]] = (self._at[1], data)
            self._at = None


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a first run, its exit status and what it printed."""
    folder = tmp_path_factory.mktemp("all") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(all_figures, "SOURCES", SOURCES)
        patch.setattr(all_figures, "read_items", lambda: GROUPS)
        assert figures.main(["--all", "--out", str(folder)]) == 0
        yield folder


def test_the_page_holds_the_numbers_of_the_files_and_loads_nothing(made):
    page = Page((made / "index.html").read_text())
    report = json.loads((made / "torque" / "metrics.json").read_text())
    peak = next(one for one in report["results"]["lengths"] if one["length"] == 1.0)[
        "peak"
    ][0]
    assert page.numbers == {PEAK: (peak, f"{peak:.3f}")}
    assert load_config(IndexReport, made / "metrics.json").numbers == {
        "fig-1": {PEAK: peak}
    }
    assert {item.id for item in GROUPS["Figures"]} <= page.ids
    assert page.links == ["#torque-torque-png"]
    assert page.links[0][1:] in page.ids
    assert page.loads
    assert all(load.startswith("data:") for load in page.loads)
    assert "a &lt; b" in (made / "index.html").read_text()


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
    assert "--benchmark takes all, " in report.missing["later"]
    assert "or topspeed; got later" in report.missing["later"]
    assert (
        "<code>bp2 eval --benchmark later</code>" in (made / "index.html").read_text()
    )
    assert set(report.commands) == set(report.seconds) == {"torque"}


def test_what_was_made_is_taken_as_it_is_until_its_numbers_are_touched(
    made, capsys, monkeypatch
):
    before = (made / "torque" / "key.json").stat().st_mtime_ns
    asked = []
    run = all_figures.subprocess.run
    monkeypatch.setattr(
        all_figures.subprocess,
        "run",
        lambda words, **rest: asked.append(words[3:]) or run(words, **rest),
    )
    assert figures.main(["--all", "--out", str(made)]) == 0
    assert "torque         as it was" in capsys.readouterr().out
    assert (made / "torque" / "key.json").stat().st_mtime_ns == before
    (made / "torque" / "metrics.json").write_text("{}")
    assert figures.main(["--all", "--out", str(made)]) == 0
    assert "results" in (made / "torque" / "metrics.json").read_text()
    # the bad one each time, ours once
    assert [words[:3] for words in asked].count(["paper", "figures", "torque"]) == 3


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--policy", "nowhere"], "--policy nowhere is no folder"),
        (["--out", "there"], "--out there holds other files"),
        (["--speed", "3"], "--speed"),
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
