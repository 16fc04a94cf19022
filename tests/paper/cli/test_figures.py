"""`bp2 paper figures` as a user meets it."""

import pytest

from bp2_rl.base.serialization import load_config
from bp2_rl.paper.cli.figures import FigureReport, main
from bp2_rl.paper.cli.report import METRICS
from bp2_rl.simulation import simulator


@pytest.fixture(autouse=True)
def settled_soon(monkeypatch):
    """The robot that is drawn comes to rest sooner."""
    monkeypatch.setattr(simulator, "SETTLING_TIME", 0.1)


@pytest.mark.parametrize("name", ["scaling", "race", "robot", "rewards"])
def test_a_figure_leaves_its_picture_and_all_its_numbers(name, tmp_path, capsys):
    out = tmp_path / "out"
    for _ in range(2):  # an old report is replaced
        assert main([name, "--out", str(out)]) == 0
    report = load_config(FigureReport, out / "metrics.json")
    assert report.figure == name
    assert report.comparisons
    assert report.results
    assert {path.suffix for path in out.iterdir()} == {".json", ".png"}
    assert str(out) in capsys.readouterr().out


@pytest.mark.parametrize(("form", "begins"), [("pdf", b"%PDF-"), ("svg", b"<?xml")])
def test_a_picture_is_left_in_the_format_that_is_named(form, begins, tmp_path):
    assert main(["rewards", "--out", str(tmp_path), "--format", form]) == 0
    assert (tmp_path / f"rewards.{form}").read_bytes().startswith(begins)
    assert not list(tmp_path.glob("*.png"))


def test_the_terminal_shows_what_the_file_holds(tmp_path, capsys):
    assert main(["race", "--out", str(tmp_path)]) == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    report = load_config(FigureReport, tmp_path / "metrics.json")
    (table_s2,) = (said for said in report.comparisons if said.item == "Table S2")
    assert table_s2.ours == "12.2 s is level 3 of men and level 1 of women"
    assert table_s2.verdict == "differs"
    assert f"it {report.results['paper']['deficit']:.2f} s" in shown


def test_an_item_without_its_number_is_left_out(tmp_path):
    """Fig. 3 C asks for R = 2; items that need what a flag has taken away say
    nothing."""
    words = ["exchange", "--mass-ratio", "1", "--periods", "4"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    said = load_config(FigureReport, tmp_path / "metrics.json").comparisons
    assert [one.item for one in said] == ["Fig. 3 B", "Eq. 5", "Eq. 6"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["scaling", "--mammals", "{bad}"], "needs one column 'species'"),
        (["race", "--athletes", "{bad}"], "needs one column 'athlete'"),
        (["race", "--athletes", "nowhere.csv"], "cannot be read"),
        (["race", "--runs", "nowhere"], "no report in nowhere"),
        (["scaling", "--runs", "nowhere"], "no report in nowhere"),
        (["strides"], "--runs takes one report"),
        (["operating"], "--runs takes reports"),
        (["learning"], "--runs: name the folders of one training or more"),
        (["scaling", "--speed", "3"], "--speed"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    words, says, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    bad = tmp_path / "bad.csv"
    bad.write_text("beast,weight\ncheetah,50\n")
    assert main([word.format(bad=bad) for word in words]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == [bad]


def test_a_folder_of_another_figure_is_kept(tmp_path, capsys):
    assert main(["race", "--out", str(tmp_path)]) == 0
    before = (tmp_path / METRICS).read_bytes()
    assert main(["scaling", "--out", str(tmp_path)]) == 2
    assert "holds a report of race" in capsys.readouterr().err
    assert (tmp_path / METRICS).read_bytes() == before
