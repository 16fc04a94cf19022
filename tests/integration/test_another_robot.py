"""From a public model to a rehearsed controller by commands alone, as a user with
another robot types them."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import aim_run
import pytest

from bp2_rl.__main__ import main as bp2
from bp2_rl.cli import eval as eval_command
from bp2_rl.cli import train as train_command
from bp2_rl.learning.policy import load_policy

SMALL = [
    *aim_run.SMALL,
    *["--impl", "kernel", "--run.steps", "256", "--run.checkpoints", "1"],
]


@pytest.fixture
def go1() -> Path:
    """Return the path of the Go1's model in the package playground, without meshes and
    unchanged."""
    spec = importlib.util.find_spec("mujoco_playground")
    assert spec is not None
    root = Path((spec.submodule_search_locations or [])[0])
    return root / "_src/locomotion/go1/xmls/scene_mjx_feetonly_flat_terrain.xml"


def assert_judged(run: Path):
    lines = map(json.loads, (run / "metrics.jsonl").read_text().splitlines())
    judged = {line["step"]: line for line in lines if "judged/speed" in line}
    assert judged[256]["judged/launches"] == 3
    assert load_policy(run).card.results["judged"]["control_steps"] in judged


def test_an_untouched_model_is_checked_trained_judged_and_rehearsed(
    go1, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    assert bp2(["robot", "new", str(go1), "--out", "go1.toml"]) == 0
    assert bp2(["robot", "check", "go1.toml", "--out", "go1.svg"]) == 0
    assert "stands 5 s" in capfd.readouterr().out
    changed = ["--robot", "go1.toml", "--env.hardware.friction", "0.9"]
    words = ["--stage", "imitation", "--run.judged", "2", *SMALL, *changed]
    assert train_command.main(words) == 0
    [run] = Path("runs").iterdir()
    settings = json.loads((run / "config.json").read_text())["env"]
    assert settings["hardware"]["friction"] == 0.9
    assert_judged(run)
    assert settings["hardware"]["body"]["name"] == json.loads(
        re.findall(r"name = (.*?)  #", Path("go1.toml").read_text())[0]
    )
    assert settings["reference"] == "kinematic"
    assert (
        eval_command.main(
            [
                str(run),
                "--speed",
                "0.5",
                "--hold",
                "0.5",
                "--no-video",
                "--out",
                "report",
            ]
        )
        == 0
    )
    metrics = json.loads(Path("report/metrics.json").read_text())["metrics"]
    assert metrics["outside_envelope"] == 0
    assert metrics["peak_spring_travel"] == 0.0
    page = re.sub(
        r"data:[^\"]*|<script.*?</script>",
        "",
        Path("report/index.html").read_text(),
        flags=re.S,
    )
    assert not re.search(
        r"\bBP2\b|Spring|paper", re.sub(r"<style.*?</style>", "", page, flags=re.S)
    )
    assert bp2(["export", str(run), "--to", "bundle", "--format", "onnx"]) == 0
    words = ["--speed", "0.1", "--hold", "0.5", "--core", "-1", "--json"]
    line = [sys.executable, "-m", "onboard.rehearse", *words]
    done = subprocess.run(
        line, cwd="bundle", capture_output=True, text=True, check=False
    )
    assert done.stderr.endswith("on the own robot for 0.5 s; ground: flat\n")
    rehearsed = json.loads(done.stdout)
    assert (done.returncode, rehearsed["fault"], rehearsed["fell_at"]) == (0, "", None)
    assert rehearsed["ticks"] > 50
