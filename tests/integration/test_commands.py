"""Whole commands as a user types them: two stages and an evaluation."""

import json
from pathlib import Path

import aim_run

from bp2_rl.cli import eval as eval_command
from bp2_rl.cli import train as train_command
from bp2_rl.learning.policy import load_policy

SMALL = [
    *aim_run.SMALL,
    *["--impl", "kernel", "--run.steps", "128", "--run.checkpoints", "1"],
]


def test_both_stages_and_an_evaluation_run_one_after_the_other(
    tmp_path, monkeypatch, capfd
):
    """The second stage is judged beside."""
    monkeypatch.chdir(tmp_path)
    hardware = ["--env.hardware.gear-ratio", "7", "--env.hardware.friction", "0.9"]
    assert train_command.main(["--stage", "imitation", *SMALL, *hardware]) == 0
    assert train_command.main(["--stage", "relaxed", "--run.judged", "2", *SMALL]) == 0
    imitation, relaxed = sorted(Path("runs").iterdir())
    parent, child = (
        json.loads((run / "config.json").read_text()) for run in (imitation, relaxed)
    )
    # The robot goes on; the stage's rewards are its own.
    assert child["env"]["hardware"] == parent["env"]["hardware"]
    assert (
        child["env"]["hardware"]["gear_ratio"],
        child["env"]["hardware"]["friction"],
    ) == (7.0, 0.9)
    assert child["env"]["reward"] != parent["env"]["reward"]
    assert (child["parent"]["run"], child["parent"]["control_steps"]) == (
        imitation.name,
        128,
    )
    printed, errors = capfd.readouterr()
    assert errors == ""
    assert f"continues from {imitation}" in printed
    assert f"see it run: python eval.py {relaxed}" in printed
    assert_judged(relaxed, printed)
    assert (
        eval_command.main(
            [
                str(relaxed),
                "--speed",
                "1",
                "--hold",
                "0.5",
                "--no-video",
                "--out",
                "report",
            ]
        )
        == 0
    )
    assert "Best speed" in capfd.readouterr().out
    assert (
        json.loads(Path("report/metrics.json").read_text())["metrics"][
            "outside_envelope"
        ]
        == 0
    )


def assert_judged(run, printed):
    lines = [
        json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()
    ]
    judged = {line["step"]: line for line in lines if "judged/speed" in line}
    assert 128 in judged
    assert judged[128]["judged/launches"] == 3
    assert load_policy(run).card.results["judged"]["control_steps"] in judged
    assert "judged: " in printed
