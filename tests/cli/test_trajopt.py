import json
import re

from bp2_rl.base.assets import asset_path
from bp2_rl.base.folders import lock_folder
from bp2_rl.cli import trajopt
from bp2_rl.cli.trajopt import load_family
from bp2_rl.optimiser.program import Program
from bp2_rl.optimiser.solution import speed_name


def test_a_speed_without_a_trajectory_is_one_line_and_status_2(
    capsys, tmp_path, monkeypatch
):
    """IPOPT is given up on at once: that it finds none itself is tested where
    trajectories are."""
    monkeypatch.chdir(tmp_path)
    found = Program.solve
    monkeypatch.setattr(
        Program,
        "solve",
        lambda self, time_limit, perhaps_infeasible: found(
            self, 0.1, perhaps_infeasible
        ),
    )
    for flags, told in (
        (["--speed", "21", "--intervals", "2", "--starts", "1"], "no trajectory at 21"),
        (
            ["--rotor-coupling", "--hardware.rotor-inertia", "0.05"],
            "must be below the inertia of the thigh",
        ),
    ):
        assert trajopt.main(["solve", *flags]) == 2
        errors = re.findall("^error:.*", capsys.readouterr().err, re.MULTILINE)
        assert len(errors) == 1
        assert told in errors[0]
    assert not list(tmp_path.rglob("*.npz"))


def test_the_second_of_two_on_one_folder_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with lock_folder(tmp_path, "busy"):
        assert trajopt.main(["library", "build", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert (
        f"error: another process works in {tmp_path}: wait for it, or choose another --out"
        in error
    )
    assert not list(tmp_path.glob("*.json"))


def test_solve_and_verify(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert (
        trajopt.main(
            [
                "solve",
                "--intervals",
                "6",
                "--starts",
                "1",
                "--refine",
                "0",
                "--out",
                "here",
            ]
        )
        == 0
    )
    card = json.loads((tmp_path / "here/speed-10.00.json").read_text())
    assert card["problem"]["speed"] == 10.0
    assert card["checks"]["dynamics_residual"] < 1e-3
    assert (tmp_path / "here/speed-10.00.png").stat().st_size > 20_000
    # Six intervals are too few for the judge, which says so.
    assert trajopt.main(["verify", "here/speed-10.00.json"]) == 2
    captured = capsys.readouterr()
    assert "velocity_error is" in captured.out
    assert "finer mesh" in captured.err


def test_a_library_says_which_trots_it_leaves_out(tmp_path, monkeypatch, capsys):
    """A file of a speed that the family does not return is a trot that the verifier
    refused."""
    family = load_family(asset_path("reference_motions/bp2_trot_slow.npz"))[-2:]

    def build(settings, folder, **_):
        for name in ("speed-00.40", speed_name(family[0].problem.speed)):
            (folder / f"{name}.json").touch()
        return family

    monkeypatch.setattr(trajopt, "build_family", build)
    trajopt.main(
        [
            "library",
            "build",
            "--robot",
            "go1",
            "--out",
            str(tmp_path / "go1"),
            "--to",
            str(tmp_path / "go1.npz"),
        ]
    )
    left = capsys.readouterr().out.replace("\n", " ").split("left out")[1:]
    assert len(left) == 1
    assert "speed-00.40" in left[0]
    assert speed_name(family[0].problem.speed) not in left[0]
