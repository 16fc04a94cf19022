"""`bp2 robot` writes a robot file from a model and checks it."""

import re
from pathlib import Path

import pytest
from odd_robots import anymal_like, without_a_base
from refusals import refused

from bp2_rl.cli.robot import main


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "dog.xml"
    path.write_text(anymal_like())
    return path


@pytest.mark.parametrize("flags", [[], ["--numbers"]])
def test_from_a_model_to_a_picture(
    flags: list[str], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    picture = tmp_path / "dog.png"
    assert main(["new", str(model), *flags]) == 0
    assert "CONFIRM" in (tmp_path / "dog.toml").read_text()
    assert main(["check", str(tmp_path / "dog.toml"), "--out", str(picture)]) == 0
    assert re.search("anymal-like.*FR_knee", capsys.readouterr().out, re.DOTALL)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_robot_that_ships_is_found_by_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["check", "mini_cheetah", "--out", str(tmp_path / "picture.svg")]) == 0
    assert "stands 5 s" in capsys.readouterr().out


def test_mistakes_are_told(
    model: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.toml").write_text("")
    (binary := tmp_path / "binary.toml").write_bytes(bytes([255, 0, 254]))
    (tmp_path / "fused.xml").write_text(without_a_base())
    for words, complaint in (
        (
            ["new", str(model), "--out", str(tmp_path / "there.toml")],
            "exists already",
        ),
        (
            ["new", str(model), "--out", str(tmp_path / "no" / "x.toml")],
            "in a folder that exists",
        ),
        (["new", str(tmp_path / "gone.xml")], "cannot be read"),
        (["new", str(tmp_path / "fused.xml")], "base is fixed"),
        (["new", str(model), "--foot-radius", "-1"], "--foot-radius must be"),
        (["new", str(model), "--feet", "a"], "four names"),
        (["check", "nobody"], "built, real, b2, black_panther, go1"),
        (["check", "go1", "--out", str(tmp_path)], "must be a name that ends in"),
        (
            ["check", str(tmp_path / "there.toml")],
            "it has no name, [motors], [trunk], [fore], [hind], [stand]: `bp2",
        ),
        (["check", str(model)], "is no robot file"),
        (["check", str(binary)], "is damaged or not TOML"),
    ):
        assert complaint in refused(capsys, main, *words)
