"""Runs on disk: exact resume, the relaxed stage's inheritance, and what a run leaves behind."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from bp2_rl.env.observations import LAYOUT
from bp2_rl.errors import UserError
from bp2_rl.learning import train
from bp2_rl.learning.checkpoint import CheckpointError, latest_step, restore_checkpoint
from bp2_rl.learning.policy import load_policy
from bp2_rl.learning.stages import Stage, TrainConfig, make_config


def tiny(stage: Stage = "imitation", **run) -> TrainConfig:
    config = make_config(stage, "smoke")
    ppo = dataclasses.replace(
        config.ppo, num_envs=16, unroll_length=4, num_minibatches=2, policy_layers=(16,), value_layers=(16,)
    )
    settings = {"steps": 4 * ppo.steps_per_train_step, "checkpoints": 2, "logs": 4} | run
    return dataclasses.replace(config, ppo=ppo, run=dataclasses.replace(config.run, **settings))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train.start(tiny(), tmp_path_factory.mktemp("runs") / "uninterrupted")


def leaves(run_dir, step):
    config = train.load_run_config(run_dir)
    template = train.make_learner(config).shape()
    return jax.tree.leaves(restore_checkpoint(run_dir, template, step)[1])


def metrics(run_dir):
    lines = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    return [{name: value for name, value in line.items() if name != "wall_time"} for line in lines]


def test_a_run_leaves_config_metrics_checkpoints_policy_and_tensorboard(run):
    assert train.load_run_config(run) == tiny()
    assert train.is_finished(run)
    lines = metrics(run)
    assert [line["step"] for line in lines] == [64, 128, 192, 256]
    assert {"reward", "falls", "speed_error", "curriculum_level", "reward/tracking", "loss/kl_mean"} <= lines[0].keys()
    policy = load_policy(run / "policy", expected_layout=LAYOUT)
    assert policy.card.stage == "imitation"
    assert list(run.glob("events.*"))
    assert (run / "log.txt").read_text()


def test_the_exported_policy_acts_as_the_trained_network_does(run):
    config = train.load_run_config(run)
    learner = train.make_learner(config)
    _, state = restore_checkpoint(run, learner.shape())
    observation = {"state": np.random.default_rng(0).normal(size=(8, 47)).astype(np.float32)}
    mean, _ = learner.network.policy_network.apply(state.normalizer, state.params.policy, observation)
    # Two implementations of the same float32 network.
    np.testing.assert_allclose(load_policy(run)(observation["state"]), mean, rtol=1e-4, atol=1e-6)


def test_a_run_stopped_and_resumed_equals_the_uninterrupted_one(run, tmp_path):
    stopped = tmp_path / "stopped"
    shutil.copytree(run, stopped)
    shutil.rmtree(stopped / "checkpoints" / "4")
    train.resume(stopped)
    assert latest_step(stopped) == 4
    for a, b in zip(leaves(run, 4), leaves(stopped, 4), strict=True):
        np.testing.assert_array_equal(a, b)
    assert metrics(stopped) == metrics(run)


def test_the_relaxed_stage_takes_policy_critic_normaliser_and_levels(run, tmp_path):
    config = tiny("relaxed")
    parent = train._inherit(run, config)
    levels = np.linspace(0.1, 0.9, 16, dtype=np.float32)
    parent = parent.replace(
        fleet=dataclasses.replace(parent.fleet, info={**parent.fleet.info, "curriculum": levels}),
    )
    fresh = train.make_learner(config).init(3)
    key = np.asarray(fresh.key)
    adopted = train._adopt(fresh, parent)
    for name in ("params", "normalizer"):
        for a, b in zip(jax.tree.leaves(getattr(adopted, name)), jax.tree.leaves(getattr(parent, name)), strict=True):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(adopted.fleet.info["curriculum"], levels)
    np.testing.assert_array_equal(adopted.key, key)
    assert int(adopted.step) == 0


def test_a_run_is_never_written_over(run):
    before = sorted(path.name for path in run.iterdir())
    with pytest.raises(UserError, match="holds a run already"):
        train.start(tiny(), run)
    assert sorted(path.name for path in run.iterdir()) == before


def test_a_parent_with_other_networks_is_refused_by_name(run, tmp_path):
    config = tiny("relaxed")
    config = dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, policy_layers=(8,)))
    with pytest.raises(UserError, match="policy_layers"):
        train.start(config, tmp_path / "other", parent=run)
    assert not (tmp_path / "other" / "config.json").exists()


@pytest.mark.parametrize("what", ["no run", "no checkpoint", "truncated", "foreign"])
def test_resuming_what_cannot_be_resumed_is_refused_and_changes_nothing(run, tmp_path, what):
    broken = tmp_path / "run"
    if what == "no run":
        broken.mkdir()
    else:
        shutil.copytree(run, broken)
        shutil.rmtree(broken / "checkpoints" / "4")
    if what == "no checkpoint":
        shutil.rmtree(broken / "checkpoints" / "2")
    elif what == "truncated":
        largest = max((broken / "checkpoints" / "2").rglob("*"), key=lambda path: path.stat().st_size)
        largest.write_bytes(largest.read_bytes()[:-10])
    elif what == "foreign":
        config = train.load_run_config(broken)
        other = dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, value_layers=(8,)))
        train.save_config(broken / "config.json", other)
    before = {path: path.stat().st_size for path in broken.rglob("*") if path.is_file()}
    with pytest.raises((UserError, CheckpointError)) as error:
        train.resume(broken)
    assert "\n" not in str(error.value)
    assert {path: path.stat().st_size for path in broken.rglob("*") if path.is_file()} == before


def test_summaries_turn_means_into_rates():
    raw = {f"{kind}/{lower:g}": 0.0 for kind in ("share", "error") for lower in train.SPEED_BINS}
    raw |= {"share/4": 0.25, "error/4": 0.05, "falls": 0.0003, "time_outs": 0.0001}
    out = train.summarize(raw)
    assert out["speed_error/4"] == pytest.approx(0.2)
    assert out["falls"] == pytest.approx(0.75)
    assert out["falls_per_second"] == pytest.approx(0.06)
    assert "speed_error/0" not in out
