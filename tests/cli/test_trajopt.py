import json

import pytest

from bp2_rl.cli import trajopt
from bp2_rl.cli.__main__ import main


def test_the_commands_are_listed(capsys):
    assert main(["trajopt", "--help"]) == 0
    out = capsys.readouterr().out
    for name in ("solve", "sweep", "limits", "verify", "schemes", "library", "codesign", "figures"):
        assert f"  {name}" in out
    assert trajopt.main([]) == 2


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["leap"], "no command 'leap'; bp2 trajopt has: solve, sweep"),
        (["solve", "--speed", "0"], "speed must be greater than 0"),
        (["solve", "--gait", "gallop"], "gallop"),
        (["solve", "--hardware.spring-stiffness", "-6000"], "spring_stiffness must be from 100 to"),
        (["solve", "--speed", "60", "--intervals", "2", "--starts", "1"], "no trajectory at 60 m/s"),
        (["sweep", "--slowest", "5", "--fastest", "4"], "a sweep goes from --slowest up to --fastest"),
        (["solve", "--starts", "0"], "starts must be at least 1, got 0"),
        (["solve", "--refine", "1"], "--refine must be 0 or at least 2"),
        (["solve", "--out", "/dev/null/here"], "cannot write to /dev/null/here"),
        (["sweep", "--starts", "0"], "--starts must be at least 1"),
        (["sweep", "--workers", "0"], "workers must be at least 1, got 0"),
        (["library", "build", "--workers", "0"], "workers must be at least 1, got 0"),
        (["schemes", "--meshes", "16", "8"], "give the coarsest first"),
        (["library", "build", "--to", "library.json"], "a library is an .npz file"),
        (["library", "burn"], "burn"),
        (["verify", "nowhere.npz"], "nowhere.npz cannot be read"),
        (["figures", "nowhere.npz"], "nowhere.npz cannot be read"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(argv, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert trajopt.main(argv) == 2
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    assert message in lines[0]
    assert not list(tmp_path.rglob("*.npz"))


def test_solve_verify_and_draw(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert trajopt.main(["solve", "--intervals", "6", "--starts", "1", "--refine", "0", "--out", "here"]) == 0
    card = json.loads((tmp_path / "here/speed-10.00.json").read_text())
    assert card["problem"]["speed"] == 10.0
    assert card["checks"]["dynamics_residual"] < 1e-3
    assert (tmp_path / "here/speed-10.00.png").stat().st_size > 20_000
    # Six intervals are too few for the judge, which says so.
    assert trajopt.main(["verify", "here/speed-10.00.json"]) == 2
    captured = capsys.readouterr()
    assert "velocity_error is" in captured.out
    assert "finer mesh" in captured.err
    assert trajopt.main(["figures", "here", "--speed", "3"]) == 2
    assert "there are only 10 m/s" in capsys.readouterr().err
