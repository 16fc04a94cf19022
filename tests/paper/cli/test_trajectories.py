import subprocess
import sys

import pytest

from bp2_rl.base.folders import lock_folder
from bp2_rl.optimiser.solution import save_solution
from bp2_rl.paper.cli import figures, trajectories


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["leap"], "no command 'leap'; bp2 paper trajectories has: limits"),
        (["limits", "--losses"], "this robot has none; choose --robot built"),
        (
            ["limits", "--robot", "bilt"],
            "there is no robot 'bilt': did you mean built? choose one of ideal, built",
        ),
        (["limits", "--workers", "-1"], "workers must be from 1 to 256, got -1"),
        (["codesign", "--confirm", "16", "0"], "confirm must be from 2 to 500, got 0"),
        (
            ["codesign", "--bounds.gear-ratio", "5", "inf"],
            "bounds.gear_ratio must be positive and finite",
        ),
        (
            ["objective", "--body-weights", "0"],
            "body_weights must be from 0.1 to 100, got 0",
        ),
        (["objective", "--speeds", "nan"], "speeds must be from 0.01 to 100, got nan"),
        (["objective", "--starts", "0"], "starts must be from 1 to 1000, got 0"),
        (["schemes", "--meshes", "-1"], "meshes must be from 2 to 500, got -1"),
        (["schemes", "--speed", "nan"], "speed must be from 0.01 to 100, got nan"),
        (["figures", "--speed", "-2"], "speed must be from 0.01 to 100, got -2"),
        (["schemes", "--meshes", "16", "8"], "give the coarsest first"),
        (["figures", "nowhere.npz"], "nowhere.npz cannot be read"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    argv, message, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert trajectories.main(argv) == 2
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    assert message in lines[0]
    assert not list(tmp_path.rglob("*.npz"))


@pytest.mark.parametrize("words", [["limits"], ["codesign"]], ids=" ".join)
def test_the_second_of_two_on_one_folder_is_refused(
    words, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with lock_folder(tmp_path, "busy"):
        assert trajectories.main([*words, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert (
        f"error: another process works in {tmp_path}: wait for it, or choose another --out"
        in error
    )
    assert not list(tmp_path.glob("*.json"))


def test_help_and_mistakes_wait_for_no_import():
    """CasADi, MuJoCo, JAX, SciPy and Matplotlib take seconds, a mistaken flag none."""
    commands = [
        (group, what)
        for group, module in (("trajectories", trajectories), ("figures", figures))
        for what in module.COMMANDS
        if what != "--all"
    ]
    program = f"""
import sys
from bp2_rl.cli.__main__ import main
for words in {commands}:
    assert main(["paper", *words, "--fly"]) == 2, words
    slow = {{"casadi", "mujoco", "jax", "scipy", "matplotlib"}} & set(sys.modules)
    assert not slow, (words, slow)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr.count("--fly") >= len(commands)


def test_figures_name_the_speeds_there_are(trot, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").mkdir()
    save_solution(tmp_path / "here" / "speed-10.00", trot)
    assert trajectories.main(["figures", "here", "--speed", "3"]) == 2
    assert "there are only 10 m/s" in capsys.readouterr().err
