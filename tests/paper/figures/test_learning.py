"""Learning curves from what the judge wrote beside a training."""

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import save_config
from bp2_rl.learning.judged import JUDGED, Judged, JudgedPolicy, JudgeResult
from bp2_rl.paper.figures.learning import learning, read_curve
from bp2_rl.paper.figures.settings import LearningFigureSettings


def run_in(folder, *verdicts):
    folder.mkdir()
    judged = [
        JudgedPolicy(step, seconds, JudgeResult(speed, falls, 3, speed, held=speed))
        for step, seconds, speed, falls in verdicts
    ]
    save_config(folder / JUDGED, Judged(1795383470.0, tuple(judged)))
    return folder


def test_the_first_that_reaches_ten_metres_a_second_is_told_beside_the_best(tmp_path):
    first = run_in(
        tmp_path / "a",
        (2_000_000, 90.0, 0.0, 3),
        (5_000_000, 300.0, 12.5, 0),
        (4_000_000, 240.0, 11.0, 1),
    )
    slow = run_in(tmp_path / "b", (2_000_000, 90.0, 9.0, 0))
    drawn = learning(LearningFigureSettings((first, slow)))
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


@pytest.mark.parametrize("make", [lambda folder: folder, run_in])
def test_what_has_no_curve_is_named(tmp_path, make):
    with pytest.raises(UserError, match="was judged: train with"):
        read_curve(make(tmp_path / "run"))


def test_no_run_is_asked_for():
    with pytest.raises(UserError, match="--runs: name the folders"):
        learning(LearningFigureSettings())
