"""Runs on disk: exact resume, the relaxed stage's inheritance, and what a run leaves
behind."""

import dataclasses
import functools
import os
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest
import slow_trot
from aim_run import metrics, small
from killer import save_checkpoint

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import lock_folder
from bp2_rl.base.serialization import config_hash
from bp2_rl.cli import train as command
from bp2_rl.env.metrics import SPEED_BINS
from bp2_rl.env.observations import layout_of
from bp2_rl.learning import run as training
from bp2_rl.learning import writers
from bp2_rl.learning.checkpoint import latest_step, restore_checkpoint
from bp2_rl.learning.loop import is_finished
from bp2_rl.learning.monitor import summarize
from bp2_rl.learning.policy import load_policy
from bp2_rl.settings.tracker import Tracked, tracked
from bp2_rl.settings.training import Parent, TrainConfig
from bp2_rl.tools.throughput import COMPILED, compilations

tiny = functools.partial(small, steps=256, checkpoints=2, logs=4)


@pytest.fixture(autouse=True, scope="module")
def shared_learners():
    """Share a compiled train step between runs of the same environment and sizes: it
    takes a minute to compile."""
    make = functools.cache(lambda env, ppo: make_learner(TrainConfig(env=env, ppo=ppo)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            training,
            "make_learner",
            lambda config, _=None: make(config.env, config.ppo),
        )
        yield


make_learner = training.make_learner


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return training.start(tiny(), tmp_path_factory.mktemp("runs") / "uninterrupted")


def leaves(run_dir, step):
    config = training.load_run_config(run_dir)
    template = training.make_learner(config).shape
    return jax.tree.leaves(restore_checkpoint(run_dir, template, step)[1])


def test_a_run_leaves_config_metrics_checkpoints_policy_and_tensorboard(run):
    assert training.load_run_config(run) == tiny()
    assert latest_step(run) == 4
    assert is_finished(run)
    lines = metrics(run)
    assert [line["step"] for line in lines] == [64, 128, 192, 256]
    assert {
        "reward",
        "falls",
        "speed_error",
        "curriculum_level",
        "reward/tracking",
        "loss/kl_mean",
    } <= lines[0].keys()
    assert {"share/0", "falls_per_second"} <= lines[0].keys()
    assert all("steps_per_second" in line for line in writers.read_metrics(run))
    policy = load_policy(run, layout_of=layout_of)
    assert policy.card.stage == "imitation"
    assert list(run.glob("events.*"))
    assert (run / "log.txt").read_text()


def test_the_example_of_a_slow_trot_trains_a_run_and_reads_what_came_of_it(tmp_path):
    """Here, where runs of its size share their compiled programs."""
    assert slow_trot.settings().env.commands.max_forward == 1.5
    lines = slow_trot.train(tiny(), tmp_path / "slow_trot")
    assert [line["step"] for line in lines] == [64, 128, 192, 256]
    assert all(np.isfinite(line["reward/tracking"]) for line in lines)
    assert load_policy(tmp_path / "slow_trot").card.stage == "imitation"


def test_the_logged_rate_is_that_of_the_time_between_the_lines(run):
    lines = writers.read_metrics(run)
    seconds = [64 / line["steps_per_second"] for line in lines]
    # Lines are stamped to 1 ms, a moment after the interval's end.
    np.testing.assert_allclose(
        seconds[1:], np.diff([line["wall_time"] for line in lines]), rtol=0.1, atol=0.02
    )


def test_the_exported_policy_acts_as_the_trained_network_does(run):
    config = training.load_run_config(run)
    learner = training.make_learner(config)
    _, state = restore_checkpoint(run, learner.shape)
    observation = {
        "state": np.random.default_rng(0).normal(size=(8, 47)).astype(np.float32)
    }
    mean, _ = learner.network.policy_network.apply(
        state.normalizer, state.params.policy, observation
    )
    # Two implementations of the same float32 network.
    np.testing.assert_allclose(
        load_policy(run)(observation["state"]), mean, rtol=1e-4, atol=1e-6
    )


def test_a_run_stopped_and_resumed_equals_the_uninterrupted_one(run, tmp_path):
    stopped = tmp_path / "stopped"
    shutil.copytree(run, stopped)
    shutil.rmtree(stopped / "checkpoints" / "4")
    training.resume(stopped)
    assert latest_step(stopped) == 4
    for a, b in zip(leaves(run, 4), leaves(stopped, 4), strict=True):
        np.testing.assert_array_equal(a, b)
    assert metrics(stopped) == metrics(run)
    # What has been restored runs the program that the first run compiled.
    assert training.make_learner(tiny()).programs.train_step._cache_size() == 1


def test_a_tracker_follows_a_run_over_its_stops(run, tmp_path, monkeypatch):
    """A writer in the place of W&B's, which has its own tests."""
    opened, told = [], []

    class Follower(writers.Writer):
        def __init__(self, run_dir, config, had):
            self.tracked = Tracked("wandb", "12ab", "bp2_rl")
            opened.append(had)

        def write(self, record):
            told.append((record.step, record.metrics["reward"]))

    monkeypatch.setattr(writers, "WandbRun", Follower)
    stopped = tmp_path / "stopped"
    shutil.copytree(run, stopped)
    for _ in range(2):
        shutil.rmtree(stopped / "checkpoints" / "4")
        training.resume(stopped, tracker="wandb")
    assert opened == [None, tracked(stopped)]
    lines = {line["step"]: line["reward"] for line in metrics(run)}
    assert told == 2 * [(step, lines[step]) for step in (192, 256)]


def test_the_relaxed_stage_takes_policy_critic_normaliser_and_levels(run, tmp_path):
    learner = training.make_learner(tiny())
    _, old = restore_checkpoint(run, learner.shape)
    levels = np.linspace(0.1, 0.9, 16, dtype=np.float32)
    old = old.replace(
        fleet=dataclasses.replace(
            old.fleet, info={**old.fleet.info, "curriculum": levels}
        )
    )
    parent = tmp_path / "parent"
    parent.mkdir()
    training.save_config(parent / "config.json", tiny())
    save_checkpoint(parent, 4, old)
    config = dataclasses.replace(tiny(), stage="relaxed")
    learner = training.make_learner(config)
    with learner.compiling():
        fresh = learner.init(3)
    key = np.asarray(fresh.key)
    adopted = training._with_inherited(
        fresh, training._inherit(parent, config, learner.shape)[0]
    )
    for name in ("params", "normalizer"):
        for a, b in zip(
            jax.tree.leaves(getattr(adopted, name)),
            jax.tree.leaves(getattr(old, name)),
            strict=True,
        ):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(adopted.fleet.info["curriculum"], levels)
    np.testing.assert_array_equal(adopted.key, key)
    assert int(adopted.step) == 0
    with compilations() as later:
        learner.train_step(adopted)
    assert later[COMPILED] == 0


def test_a_child_counts_its_parents_steps(run, tmp_path):
    config = dataclasses.replace(tiny(), stage="relaxed")
    child = training.start(config, tmp_path / "child", parent=run)
    parent = training.load_run_config(child).parent
    assert parent == Parent(
        run="uninterrupted", config_hash=config_hash(tiny()), control_steps=4 * 64
    )
    config = dataclasses.replace(tiny(steps=64), stage="relaxed")
    grandchild = training.start(config, tmp_path / "grandchild", parent=child)
    steps = [
        load_policy(folder).card.physics_steps for folder in (run, child, grandchild)
    ]
    # 5 physics steps a control step
    assert steps == [4 * 64 * 5, 8 * 64 * 5, 9 * 64 * 5]
    # What is written before the first step is what was inherited.
    at_birth, at_death = leaves(child, 0), leaves(run, 4)
    assert any(
        np.array_equal(a, b) and np.ndim(a) == 2
        for a, b in zip(at_birth, at_death, strict=True)
    )


def test_the_relaxed_stage_goes_on_from_the_newest_finished_imitation_run(
    run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for age, name in enumerate(("unfinished", "newest", "older")):
        config = shutil.copytree(run, Path("runs") / name) / "config.json"
        os.utime(config, (1e9 - age, 1e9 - age))
    shutil.rmtree("runs/unfinished/policies/256")
    assert command._newest_imitation_run() == Path("runs/newest")


@pytest.mark.parametrize(
    ("holds", "said"), [("config.json", "a run already"), ("thesis.tex", "other files")]
)
def test_a_folder_with_files_is_refused_and_left_as_it_was(tmp_path, holds, said):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / holds).write_text("years of work")
    with pytest.raises(UserError, match=f"holds {said}"):
        training.start(tiny(), folder)
    assert [path.name for path in folder.iterdir()] == [holds]
    assert (folder / holds).read_text() == "years of work"


def test_a_parent_with_other_networks_is_refused_by_name(run, tmp_path):
    config = tiny("relaxed")
    config = dataclasses.replace(
        config, ppo=dataclasses.replace(config.ppo, policy_layers=(8,))
    )
    with pytest.raises(UserError, match="policy_layers"):
        training.start(config, tmp_path / "other", parent=run)
    assert not (tmp_path / "other" / "config.json").exists()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda run: (run / "config.json").unlink(), "is not a training run"),
        (lambda run: shutil.rmtree(run / "checkpoints"), "before its first checkpoint"),
        (
            lambda run: (run / "checkpoints/2/state.npz").write_bytes(b""),
            "state.npz is damaged",
        ),
        (
            lambda run: training.save_config(run / "config.json", tiny(seed=7)),
            "is of another training: run.seed is 0 there and 7 in config.json",
        ),
    ],
    ids=["no run", "no checkpoint", "damaged", "foreign"],
)
def test_resuming_what_cannot_be_resumed_is_refused_and_changes_nothing(
    run, tmp_path, spoil, words
):
    broken = shutil.copytree(run, tmp_path / "run")
    shutil.rmtree(broken / "checkpoints" / "4")
    spoil(broken)
    before = {path: path.stat().st_size for path in broken.rglob("*") if path.is_file()}
    with pytest.raises(UserError, match=words) as error:
        training.resume(broken)
    assert "\n" not in str(error.value)
    after = {path: path.stat().st_size for path in broken.rglob("*") if path.is_file()}
    assert after == before


def test_summaries_turn_means_into_rates():
    raw = {
        f"{kind}/{lower:g}": 0.0 for kind in ("share", "error") for lower in SPEED_BINS
    }
    raw |= {
        "share/4": 0.25,
        "error/4": 0.05,
        "falls": 0.0003,
        "time_outs": 0.0001,
        "reward_square": 0.25,
    }
    out = summarize(raw)
    assert out["speed_error/4"] == pytest.approx(0.2)
    assert out["falls"] == pytest.approx(0.75)
    assert out["falls_per_second"] == pytest.approx(0.06)
    assert out["reward_rms"] == pytest.approx(0.5)
    assert "speed_error/0" not in out


@pytest.mark.parametrize("lost", [(256,), (128,), (128, 256)])
def test_a_policy_that_a_kill_kept_from_being_exported_is_exported_on_resume(
    run, tmp_path, lost
):
    killed = tmp_path / "killed"
    shutil.copytree(run, killed)
    for steps in lost:
        shutil.rmtree(killed / "policies" / str(steps))
    training.resume(killed)
    for name in ("policies/128", "policies/256"):
        assert (killed / name / "weights.npz").read_bytes() == (
            run / name / "weights.npz"
        ).read_bytes()
        assert (
            load_policy(killed / name).card.physics_steps
            == load_policy(run / name).card.physics_steps
        )


def test_a_damaged_older_checkpoint_does_not_keep_a_run_from_going_on(run, tmp_path):
    killed = tmp_path / "killed"
    shutil.copytree(run, killed)
    shutil.rmtree(killed / "policies" / "128")
    (killed / "checkpoints" / "2" / "state.npz").write_bytes(b"")
    training.resume(killed)
    assert "warning: no policy of step 2: " in (killed / "log.txt").read_text()


def test_a_second_process_is_refused_in_one_line_and_changes_nothing(run, tmp_path):
    copy, fresh = tmp_path / "copy", tmp_path / "fresh"
    shutil.copytree(run, copy)
    fresh.mkdir()
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file()}
    with (
        lock_folder(copy, "busy"),
        pytest.raises(
            UserError, match=f"another process trains in {copy}: wait for it"
        ),
    ):
        training.resume(copy)
    with (
        lock_folder(fresh, "busy"),
        pytest.raises(UserError, match="another process trains in"),
    ):
        training.start(tiny(), fresh)
    with pytest.raises(UserError, match=f"{copy} holds a run already"):
        training.start(tiny(), copy)
    assert {
        path: path.read_bytes() for path in copy.rglob("*") if path.is_file()
    } == before | {copy / ".lock": b""}
    assert [path.name for path in fresh.iterdir()] == [".lock"]


def test_a_resume_on_other_devices_says_that_it_is_not_bit_for_bit(
    run, tmp_path, monkeypatch
):
    """Sums in another order: `test_devices` has how much they differ."""
    said = "trained on 3 x TPU v9 before: what follows is not bit for bit what it had been there"
    with monkeypatch.context() as patch:
        patch.setattr("bp2_rl.learning.cluster.devices", lambda: "3 x TPU v9")
        moved = training.start(tiny(), tmp_path / "moved")
    for folder in (moved, shutil.copytree(run, tmp_path / "same")):
        training.resume(folder)
        assert (said in (folder / "log.txt").read_text()) is (folder == moved)


def test_somebody_elses_run_does_not_write_outside_its_folder(run, tmp_path):
    """But for its checkpoints, which may lie on another disk; a run that is read may be
    made of links."""
    copy, elsewhere = tmp_path / "copy", tmp_path / "elsewhere"
    shutil.copytree(run, copy)
    elsewhere.mkdir()
    for name in ("log.txt", "metrics.jsonl", "events", "policies", ".lock"):
        aside = copy / f"{name}.aside"
        if (copy / name).exists():
            (copy / name).rename(aside)
        (copy / name).symlink_to(
            elsewhere / ("" if name in ("events", "policies") else name)
        )
        with pytest.raises(
            UserError, match=rf"{name} is a link to elsewhere: .*; remove it$"
        ):
            training.resume(copy)
        (copy / name).unlink()
        if aside.exists():
            aside.rename(copy / name)
    assert list(elsewhere.iterdir()) == []
    shutil.move(copy / "checkpoints", elsewhere)
    (copy / "checkpoints").symlink_to(elsewhere / "checkpoints")
    training.resume(copy)
    assert latest_step(copy) == 4
    assert load_policy(copy).card.stage == "imitation"


NAMES = ("x" * 5000, "a\0b", "a\udcff")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        *(
            ([flag, name], "no file or folder can be called ")
            for flag in ("--resume", "--replay", "--from", "--out")
            for name in NAMES
        ),
        *(
            (
                ["--preset", "smoke", "--run.seed", str(seed)],
                f"run.seed must be from 0 to 4294967295, got {seed}",
            )
            for seed in (-1, 2**32, 9223372036854775808)
        ),
        (
            ["--resume", "nowhere"],
            "no training run at nowhere: there is no such folder",
        ),
    ],
    ids=range(16),
)
def test_what_cannot_be_trained_is_a_mistake_of_the_user(
    arguments, line, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert line in error
    assert error.count("\n") == 1
    assert len(error) < 150
    assert not list(tmp_path.iterdir())
