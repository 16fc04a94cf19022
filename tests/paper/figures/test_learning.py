"""Learning curves from what the judge wrote beside a training."""

import json
import os

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.figures.learning import learning, read_curve
from bp2_rl.paper.figures.settings import LearningSettings

BEGAN = "2026-11-22T21:37:50Z"  # 1795383470 s


def run_in(folder, *verdicts):
    folder.mkdir()
    (folder / "config.json").write_text("{}")
    (folder / "log.txt").write_text(f"{BEGAN} started at step 0 of 245\n")
    lines = [{"step": 1000, "wall_time": 1795383500.0, "reward": 1.0}]
    lines += [
        {
            "step": step,
            "wall_time": 1795383470.0 + seconds,
            "judged/speed": speed,
            "judged/falls": falls,
            "judged/launches": 3.0,
            "judged/mean": speed,
            "judged/fell_told": 0.0,
            "judged/fell_after": 0.0,
        }
        for step, seconds, speed, falls in verdicts
    ]
    (folder / "metrics.jsonl").write_text(
        "".join(json.dumps(line) + "\n" for line in lines) + "torn off {"
    )
    return folder


def test_the_first_that_reaches_ten_metres_a_second_is_told_beside_the_best(tmp_path):
    first = run_in(
        tmp_path / "a",
        (2_000_000, 90.0, 0.0, 3.0),
        (5_000_000, 300.0, 12.5, 0.0),
        (4_000_000, 240.0, 11.0, 1.0),
    )
    slow = run_in(tmp_path / "b", (2_000_000, 90.0, 9.0, 0.0))
    drawn = learning(LearningSettings((first, slow)))
    (table,) = drawn.tables
    assert table.lines == [
        ["a", "4.0", "240", "11.0", "12.5", "5.0"],
        ["b", "-", "-", "-", "9.0", "2.0"],
    ]
    assert [one.steps for one in drawn.results["curves"][0].judged] == [
        2_000_000,
        4_000_000,
        5_000_000,
    ]
    assert list(drawn.pictures) == ["learning"]


def test_a_training_begins_with_its_settings_before_it_compiles_and_logs(tmp_path):
    run = run_in(tmp_path / "a", (2_000_000, 90.0, 9.0, 0.0))
    copied = read_curve(run)
    os.utime(run / "config.json", (1795383440.0, 1795383440.0))
    assert [curve.judged[0].seconds for curve in (copied, read_curve(run))] == [
        90.0,
        120.0,
    ]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda folder: folder, "not the folder of a training that has begun"),
        (run_in, "was judged: train with --run.judged 1 or more"),
    ],
)
def test_what_has_no_curve_is_named(tmp_path, make, said):
    with pytest.raises(UserError, match=said):
        read_curve(make(tmp_path / "run"))


def test_no_run_is_asked_for():
    with pytest.raises(UserError, match="--runs: name the folders"):
        learning(LearningSettings())
