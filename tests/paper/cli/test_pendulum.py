import json
import subprocess
import sys
from pathlib import Path

import pytest

from bp2_rl.cli.__main__ import main
from bp2_rl.paper.cli import figures

QUICK = {
    "exchange": ["--mass-ratio", "1", "10", "--periods", "4"],
    "sections": ["--mass-ratio", "2", "--periods", "6"],
    "torque": [],
    "map": ["--mass-ratio", "1"],
    "trapping": ["--thresholds", "1.5"],
    "gaits": ["--mass-ratio", "8.8"],
}
"""Every command, with flags that let it end in a moment."""


def test_the_commands_are_listed(capsys):
    assert main(["paper", "figures", "--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {name}" in out for name in QUICK)


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["swing"], "no command 'swing': did you mean scaling?"),
        (
            ["exchange", "--mass-ratio", "0"],
            "--mass-ratio must be from 0.05 to 10000, got 0",
        ),
        (
            ["exchange", "--mass-ratio", "nan"],
            "--mass-ratio must be from 0.05 to 10000, got nan",
        ),
        (["exchange", "--mass-ratio"], "--mass-ratio"),
        (["exchange", "--mass-ratio", "1", "1"], "--mass-ratio: 1 1 has a value twice"),
        (
            ["exchange", "--mass-ratio", *"1234567"],
            "--mass-ratio takes 1 to 6 values, got 7",
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
        (["gaits", "--mass-ratio", *"1234"], "--mass-ratio takes 1 to 3 values, got 4"),
        (["gaits", "--out", "/dev/null/here"], "cannot write to /dev/null/here"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    argv, message, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert figures.main(argv) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert message in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("what", QUICK)
def test_help_and_mistakes_wait_for_no_import(what):
    """JAX, MuJoCo, SciPy and Matplotlib take seconds, a mistaken flag none."""
    program = (
        "import sys; from bp2_rl.cli.__main__ import main; "
        f"assert main(['paper', 'figures', '{what}', '--fly']) == 2; "
        "assert not {'casadi', 'mujoco', 'jax', 'scipy', 'matplotlib'} & set(sys.modules), sys.modules.keys()"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr.startswith("error: ")


@pytest.fixture(scope="module")
def reports(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("reports")
    for name, flags in QUICK.items():
        assert figures.main([name, *flags, "--out", str(folder / name)]) == 0
    return folder


def metrics(reports: Path, name: str) -> dict:
    return json.loads((reports / name / "metrics.json").read_text())


@pytest.mark.parametrize("name", QUICK)
def test_a_report_has_its_numbers_and_its_picture(name, reports):
    report = metrics(reports, name)
    assert report["figure"] == name
    assert report["results"]
    assert "out" not in report["settings"]
    assert (reports / name / f"{name}.png").stat().st_size > 20_000


def test_what_is_infinite_and_what_rests_is_in_the_report(reports):
    assert metrics(reports, "torque")["results"]["lengths"][-1]["length"] == "inf"
    gaits = {row["gait"]: row for row in metrics(reports, "gaits")["results"]["gaits"]}
    assert gaits["trot"]["peak"] == pytest.approx(1.0, abs=1e-12)


def test_the_tables_numbers_are_the_reports(reports, capsys, tmp_path):
    assert figures.main(["gaits", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for row in json.loads((tmp_path / "metrics.json").read_text())["results"]["gaits"]:
        assert f"{row['least_peak']:.3f}" in out
        assert f"{row['peak']:.3f}" in out


def test_a_report_is_written_again_but_over_no_other(reports, capsys, tmp_path):
    again = ["torque", "--phase", "0", "--out", str(tmp_path)]
    assert figures.main(again) == 0
    assert figures.main(again) == 0
    assert figures.main(["gaits", "--out", str(tmp_path)]) == 2
    assert (
        "holds a report of torque: name another folder for gaits"
        in capsys.readouterr().err
    )
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes").touch()
    assert figures.main(["torque", "--out", str(tmp_path / "mine")]) == 2
    assert "holds other files" in capsys.readouterr().err
