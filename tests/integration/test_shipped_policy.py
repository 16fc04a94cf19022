"""The policies that ship, run by the commands that a newcomer types first."""

import json
from pathlib import Path

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.cli import eval as command
from bp2_rl.evaluation.benchmarks.conditions import on_card
from bp2_rl.learning.policy import load_policy

FASTEST = "policies/fastest"

either = pytest.mark.parametrize(
    ("shipped", "words"),
    [
        (command.DEFAULT_POLICY, ()),
        (FASTEST, (str(asset_path(FASTEST)), "--robot", "ideal")),
    ],
    ids=["without arguments", "the fastest"],
)


@pytest.fixture
def evaluate(tmp_path, monkeypatch):
    """Run eval.py in a folder without runs, so on a shipped policy, and return its
    report."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "")

    def evaluate(*words: str) -> dict:
        assert command.main([*words, "--no-video", "--out", "report"]) == 0
        return json.loads(Path("report/metrics.json").read_text())

    return evaluate


@either
def test_eval_reproduces_the_top_speed_on_the_card(evaluate, shipped, words):
    report = evaluate(*words, "--hold", "6")
    policy = load_policy(asset_path(shipped))
    assert report["conditions"]["weights_sha256"] == policy.card.weights_sha256
    measured = report["metrics"]
    assert measured["fell_at"] is None
    assert measured["outside_envelope"] == 0
    assert measured["commanded_speed"] == pytest.approx(
        on_card(policy, "topspeed", "commanded_speed")
    )
    # The card's 20 s of hold see the best of twenty near-equal seconds, and these 6 s
    # end when the robot, which lags the ramp, is within 0.02 m/s of its final speed;
    # the rest is for float32 on another processor. After 3 s of hold 0.1 m/s would
    # still be missing.
    assert measured["best_speed"] == pytest.approx(
        on_card(policy, "topspeed", "best_speed"), abs=0.05
    )


@either
def test_the_sprint_on_the_card_is_run_again(evaluate, shipped, words):
    results = evaluate(*words, "--benchmark", "sprint")["results"]["sprint"]
    policy = load_policy(asset_path(shipped))
    assert results["time_100m"] == pytest.approx(
        on_card(policy, "sprint", "time_100m"), abs=0.05
    )
    assert results["time_100m"] < 12.2  # s, the paper's
    assert results["mean_acceleration"] > 2.38  # m/s2, the paper's
    assert results["lane_kept"]
    assert results["outside_envelope"] == 0
