"""The policies that a run exports: judged beside the training, and the best kept as the
run's own."""

import dataclasses
import functools
import shutil
import signal
import threading
from concurrent.futures import Future
from pathlib import Path

import pytest
from aim import StandIn
from aim_run import small

from bp2_rl.base.errors import RunStopped, UserError
from bp2_rl.learning import run as training
from bp2_rl.learning.checkpoint import latest_step
from bp2_rl.learning.judged import JudgeResult, own_policy
from bp2_rl.learning.loop import is_finished
from bp2_rl.learning.policy import load_policy
from bp2_rl.learning.ppo import PPO
from bp2_rl.learning.writers import read_metrics

PER_STEP = 16 * 4  # control steps
STEPS = 8


def short(**run):
    """Return the settings of a short run whose fastest command is 15 m/s."""
    config = small(steps=STEPS * PER_STEP, checkpoints=4, logs=4, judged=STEPS)
    commands = dataclasses.replace(config.env.commands, max_forward=15.0)
    return dataclasses.replace(
        config,
        env=dataclasses.replace(config.env, commands=commands),
        run=dataclasses.replace(config.run, **run),
    )


@pytest.fixture(autouse=True, scope="module")
def quick_robot():
    """Replace the robot by a stand-in whose train step is compiled once."""
    learner = PPO(StandIn(), short().ppo)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "make_learner", lambda config, _=None: learner)
        yield


class Fake:
    """A judge whose results are known beforehand, by control steps, and which returns
    them after `after` seconds."""

    places = 1

    def __init__(self, results, after=0.0):
        self.results, self.after, self.asked = results, after, []
        self.held = {}

    def submit(self, policy: Path, *, slower: bool):
        assert load_policy(policy)
        self.asked.append(int(policy.name))
        known = self.held if slower else {}
        heard = {**self.results, **known}[int(policy.name)]
        future = Future()
        tell = functools.partial(
            future.set_exception if isinstance(heard, Exception) else future.set_result,
            heard,
        )
        if self.after:
            telling = threading.Timer(self.after, tell)
            telling.daemon = True
            telling.start()
        else:
            tell()
        return future


def steady(*speeds):
    """Return results without a fall for the policies of every train step, by control
    step."""
    return {
        (k + 1) * PER_STEP: JudgeResult(speed, 0, 3, speed, held=speed)
        for k, speed in enumerate(speeds)
    }


def weights(folder):
    return (folder / "weights.npz").read_bytes()


def judged_lines(run_dir):
    return {
        line["step"]: (line["judged/speed"], line["judged/falls"])
        for line in read_metrics(run_dir)
        if "judged/speed" in line
    }


def log(run_dir):
    return (run_dir / "log.txt").read_text()


def test_the_best_policy_is_the_runs_own_of_equal_ones_the_later(tmp_path):
    judge = Fake(steady(1, 5, 2, 9, 9, 3, 4, 2))
    run = training.start(short(), tmp_path / "run", judge=judge)
    assert judge.asked == [k * PER_STEP for k in range(1, STEPS + 1)]
    assert weights(own_policy(run)) == weights(run / "policies" / str(5 * PER_STEP))
    card = load_policy(run).card
    assert card.results["judged"] == {
        "control_steps": 5 * PER_STEP,
        "speed": 9.0,
        "falls": 0,
        "launches": 3,
        "score": 9.0,
        "fell_told": 0.0,
        "held": 9.0,
        "told": 0.0,
    }
    assert card.physics_steps == 5 * PER_STEP * 5
    assert judged_lines(run)[2 * PER_STEP] == (5.0, 0.0)
    assert len(judged_lines(run)) == STEPS


def test_judging_changes_nothing_of_what_is_learned(tmp_path):
    alone = training.start(short(judged=0), tmp_path / "alone")
    judged = training.start(
        short(), tmp_path / "judged", judge=Fake(steady(*range(STEPS)))
    )
    assert "judged" not in load_policy(alone).card.results
    for step in (4, 8):
        saved = [
            folder / "policies" / str(step * PER_STEP) for folder in (alone, judged)
        ]
        assert weights(saved[0]) == weights(saved[1])
    states = [
        (run / "checkpoints" / str(STEPS) / "state.npz").read_bytes()
        for run in (alone, judged)
    ]
    assert states[0] == states[1]


def test_a_judge_that_is_behind_is_waited_for_and_given_saves_alone(tmp_path):
    """The judge takes a second for each, in which the whole run is done."""
    judge = Fake(steady(*range(STEPS)), after=1.0)
    run = training.start(short(), tmp_path / "run", judge=judge)
    saves = {k * PER_STEP for k in (2, 4, 6, 8)}
    assert saves <= set(judge.asked)
    assert len(judge.asked) < STEPS
    assert set(judged_lines(run)) == set(judge.asked)
    assert load_policy(run).card.results["judged"]["control_steps"] == STEPS * PER_STEP


def test_a_run_ends_with_a_save_when_it_is_as_fast_as_it_is_to_be(tmp_path):
    results = steady(1, 12, 9, 11, 12, 13, 14, 15)
    # it falls in the launch that counts
    results[2 * PER_STEP] = JudgeResult(0.0, 1, 3, 7.5)
    run = training.start(short(until=10.5), tmp_path / "run", judge=Fake(results))
    # Heard of during the train step after it.
    assert latest_step(run) == 5
    assert is_finished(run)
    assert load_policy(run).card.results["judged"]["control_steps"] == 4 * PER_STEP
    assert (
        f"reached 10.5 m/s: holds 11.0 m/s, 11.0 m/s after {4 * PER_STEP} control steps, known "
        in log(run)
    )
    # there is nothing left to do, and nothing to judge
    training.resume(run, judge=Fake({}))
    assert latest_step(run) == 5


@pytest.mark.parametrize(
    ("until", "results", "best", "last"),
    [
        # the first launch was the one in which it fell
        (
            None,
            dict.fromkeys(range(1, STEPS + 1), JudgeResult(13.0, 2, 3, 13.0 / 3))
            | {3: JudgeResult(0.0, 1, 3, 7.0)},
            3,
            STEPS,
        ),
        # heard of during the train step after it
        (
            10.5,
            {1: JudgeResult(1.0, 0, 3, 1.0), 2: JudgeResult(11.0, 0, 3, 9.0, held=10.4)}
            | dict.fromkeys(
                range(3, STEPS + 1), JudgeResult(11.0, 2, 3, 11.0 / 3, held=10.6)
            ),
            3,
            4,
        ),
        (12.0, dict.fromkeys(range(1, STEPS + 1), JudgeResult(9, 0, 3, 9)), 8, STEPS),
    ],
    ids=["fastest over all launches", "ends the run", "never gets there"],
)
def test_a_runs_own_policy_ends_the_run_or_is_the_fastest_over_all_launches(
    tmp_path, until, results, best, last
):
    judge = Fake({step * PER_STEP: result for step, result in results.items()})
    run = training.start(short(until=until), tmp_path / "run", judge=judge)
    assert load_policy(run).card.results["judged"]["control_steps"] == best * PER_STEP
    assert latest_step(run) == last
    assert ("reached" in log(run)) is (last < STEPS)


def test_where_all_fell_on_the_way_to_a_speed_the_newest_is_launched_slower(tmp_path):
    fell = JudgeResult(0.0, 3, 3, 0.0, fell_told=4.0)
    judge = Fake(dict.fromkeys(range(PER_STEP, (STEPS + 1) * PER_STEP, PER_STEP), fell))
    newest = STEPS * PER_STEP
    judge.held[newest] = dataclasses.replace(fell, score=0.5, held=1.5)
    run = training.start(short(until=10.5), tmp_path / "run", judge=judge)
    assert judge.asked == [*range(PER_STEP, newest + 1, PER_STEP), newest]
    judged = load_policy(run).card.results["judged"]
    assert (judged["control_steps"], judged["held"]) == (newest, 1.5)


@pytest.mark.parametrize("results_before", [0, 3, STEPS - 1])
def test_without_the_judge_training_goes_on_and_the_newest_policy_is_the_runs_own(
    tmp_path, results_before
):
    """One warning, whether he is killed, raises or cannot be asked."""
    results: dict = steady(*range(STEPS, 0, -1))
    for k in range(results_before + 1, STEPS + 1):
        results[k * PER_STEP] = RuntimeError("a process of his\nwas killed")
    run = training.start(short(), tmp_path / "run", judge=Fake(results))
    assert latest_step(run) == STEPS
    assert log(run).count("warning") == 1
    assert (
        "warning: no policy is judged any more, the newest is the run's own: a process of his was killed"
        in log(run)
    )
    assert weights(own_policy(run)) == weights(run / "policies" / str(STEPS * PER_STEP))
    assert len(judged_lines(run)) == results_before


def test_a_resumed_run_knows_the_judge_results_before_and_has_the_others_judged(
    tmp_path, monkeypatch
):
    results = steady(1, 2, 9, 4, 3, 2, 1, 1)
    whole = training.start(short(), tmp_path / "whole", judge=Fake(results))
    judge = Fake(results)

    def caught_in_the_fourth_step(signals):
        signals.caught = signal.SIGTERM if len(judge.asked) == 3 else None
        # he does not come to the last policy
        judge.after = 1e6 if signals.caught else 0.0
        return signals.caught

    with monkeypatch.context() as patch:
        patch.setattr(
            "bp2_rl.learning.cluster.StopSignals.received", caught_in_the_fourth_step
        )
        with pytest.raises(RunStopped):
            training.start(short(), tmp_path / "run", judge=judge)
    run = tmp_path / "run"
    assert latest_step(run) == 4
    assert set(judged_lines(run)) == {64, 128, 192}
    judge = Fake(results)
    training.resume(run, judge=judge)
    assert judge.asked == [k * PER_STEP for k in (4, 5, 6, 7, 8)]
    assert judged_lines(run) == judged_lines(whole)
    assert weights(own_policy(run)) == weights(own_policy(whole))
    states = [
        (folder / "checkpoints" / str(STEPS) / "state.npz").read_bytes()
        for folder in (run, whole)
    ]
    assert states[0] == states[1]


def test_a_damaged_policy_of_before_does_not_keep_a_run_from_going_on(tmp_path):
    run = training.start(
        short(), tmp_path / "run", judge=Fake(steady(1, 2, 3, 9, 3, 3, 3, 3))
    )
    shutil.rmtree(run / "checkpoints" / str(STEPS))
    (run / "policies" / str(4 * PER_STEP) / "weights.npz").write_bytes(b"")
    training.resume(run, judge=Fake(steady(*[3.0] * STEPS)))
    assert latest_step(run) == STEPS
    with pytest.raises(
        UserError, match=f"policies/{4 * PER_STEP}/weights.npz is trunc"
    ):
        load_policy(run)


def test_a_damaged_file_of_results_is_a_line_on_how_to_mend_it(tmp_path):
    run = training.start(short(), tmp_path / "run", judge=Fake(steady(*range(STEPS))))
    (run / "judged.json").write_text('{"began": 1.0, "own": "best"}')
    for read in (load_policy, lambda run: training.resume(run, judge=Fake({}))):
        with pytest.raises(UserError, match=r"own takes a whole number, .*; remove it"):
            read(run)
    (run / "judged.json").unlink()
    judge = Fake(steady(*range(STEPS)))
    training.resume(run, judge=judge)
    assert judge.asked == [k * PER_STEP for k in range(1, STEPS + 1)]
