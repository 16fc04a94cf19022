"""`bp2 paper figures` as a user meets it."""

import pytest

from bp2_rl.base.serialization import load_config
from bp2_rl.paper.cli.figures import METRICS, FigureReport, main
from bp2_rl.simulation import simulator


@pytest.fixture(autouse=True)
def settled_soon(monkeypatch):
    """Let the robot that is drawn come to rest sooner."""
    monkeypatch.setattr(simulator, "SETTLING_TIME", 0.1)


QUICK: dict[str, list[str]] = {
    "scaling": [],
    "race": [],
    "robot": [],
    "rewards": [],
    "exchange": ["--mass-ratio", "1", "10", "--periods", "4"],
    "sections": ["--mass-ratio", "2", "--periods", "6"],
    "torque": [],
    "map": ["--mass-ratio", "1"],
    "trapping": ["--thresholds", "1.5"],
    "gaits": ["--mass-ratio", "8.8"],
}
"""Figures that need no report, with flags that let them end in a moment."""


@pytest.mark.parametrize("name", QUICK)
def test_a_figure_leaves_its_picture_and_all_its_numbers(name, tmp_path, capsys):
    out = tmp_path / "out"
    # an old report is replaced; one figure tells for all
    for _ in range(2 if name == "rewards" else 1):
        assert main([name, *QUICK[name], "--out", str(out)]) == 0
    report = load_config(FigureReport, out / "metrics.json")
    assert report.figure == name
    assert report.results
    assert "out" not in report.settings
    assert (out / f"{name}.png").stat().st_size > 20_000
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


def test_what_is_infinite_and_what_rests_is_in_the_report(tmp_path):
    for name in ("torque", "gaits"):
        assert main([name, "--out", str(tmp_path / name)]) == 0
    torque, gaits = (
        load_config(FigureReport, tmp_path / name / METRICS).results
        for name in ("torque", "gaits")
    )
    assert torque["lengths"][-1]["length"] == "inf"
    trots = [row["peak"] for row in gaits["gaits"] if row["gait"] == "trot"]
    assert trots == pytest.approx([1.0, 1.0], abs=1e-12)


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
        (["swing"], "no command 'swing': did you mean scaling?"),
        (
            ["exchange", "--mass-ratio", "0"],
            "--mass-ratio must be from 0.05 to 10000, got 0",
        ),
        (
            ["exchange", "--mass-ratio", "nan"],
            "--mass-ratio must be from 0.05 to 10000, got nan",
        ),
        (["exchange", "--mass-ratio", "1", "1"], "--mass-ratio: 1 1 has a value twice"),
        (
            ["exchange", "--mass-ratio", *map(str, range(1, 14))],
            "--mass-ratio takes 1 to 12 values, got 13",
        ),
        (
            ["exchange", "--amplitude", "4"],
            "--amplitude must be from 0.001 to 3.1, got 4",
        ),
        (
            ["exchange", "--periods", "1e9"],
            "--periods must be from 2 to 1000, got 1e+09",
        ),
        (["torque", "--phase", "7"], "--phase must be from -6.28319 to 6.28319, got 7"),
        (["torque", "--length", "-1"], "--length must be from 0.001 to 1000, got -1"),
        (
            ["torque", "--frequency", "0.49848657"],
            "is a pendulum's own frequency at a length of 1 m",
        ),
        (
            ["map", "--frequency", "inf"],
            "--frequency must be from 0.01 to 1000, got inf",
        ),
        (
            ["trapping", "--thresholds", "2"],
            "--thresholds must be from 0.3 to 1.5, got 2",
        ),
        (["gaits", "--out", "/dev/null/here"], "cannot write to /dev/null/here"),
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
