"""Numbers that are not finite: which results they may touch, which message follows, and
which files are kept."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from aim import TINY, StandIn, assert_equal
from aim_run import SMALL
from killer import save_checkpoint

from bp2_rl.base.serialization import to_json
from bp2_rl.cli import train as command
from bp2_rl.learning import checkpoint, guards, loop, monitor, policy
from bp2_rl.learning import run as training
from bp2_rl.learning.batched_env import FAULTS, BatchedEnv
from bp2_rl.learning.checkpoint import (
    FAILED,
    latest_step,
    leaves_by_path,
    restore_checkpoint,
)
from bp2_rl.learning.monitor import Log, Monitor, Unlogged
from bp2_rl.learning.ppo import NOT_FINITE, PPO
from bp2_rl.learning.writers import read_metrics
from bp2_rl.settings.training import TrainConfig

STEPS = 12
RUN = [
    *SMALL,
    "--run.steps",
    str(STEPS * 64),
    "--run.checkpoints",
    "6",
    "--run.logs",
    "6",
]
ROBOTS = 64


@functools.cache
def learner_of(env_faults, rarity, ppo):
    return PPO(StandIn(*env_faults, rarity=rarity), ppo)


@pytest.fixture
def faults(monkeypatch):
    """Return a function, `faults("reward", rarity=50)`, that gives the robots of
    training runs these faults from then on."""

    def choose(*names, rarity=100.0):
        monkeypatch.setattr(
            training,
            "make_learner",
            lambda config, _=None: learner_of(names, rarity, config.ppo),
        )

    choose()
    return choose


def restore(run, **where) -> Any:
    return restore_checkpoint(
        run, learner_of((), 100.0, training.load_run_config(run).ppo).shape, **where
    )[1]


def assert_finite(tree):
    for path, leaf in leaves_by_path(tree).items():
        assert np.isfinite(leaf).all(), path


# --- A robot's fault stays with the robot ---------------------------------------------
def step_fleet(env, change=lambda state, action: (state, action)):
    """Return a fleet after one step, and the fresh episodes that it was given."""
    fleet = BatchedEnv(env, episode_length=100)
    state = fleet.reset(jax.random.split(jax.random.PRNGKey(0), ROBOTS))
    fresh = fleet.fresh_episodes(state, jax.random.split(jax.random.PRNGKey(1), ROBOTS))
    young = dataclasses.replace(
        state, info={**state.info, "steps": jnp.zeros(ROBOTS, jnp.int32)}
    )
    state, action = change(young, jnp.zeros((ROBOTS, 12)))
    return fleet.step(state, action, fresh), fresh


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("physics", "fault/physics"),
        ("state", "fault/observation"),
        ("privileged_state", "fault/observation"),
        ("reward", "fault/reward"),
    ],
)
def test_a_step_that_is_not_finite_ends_that_robots_episode_and_no_others(fault, cause):
    after, fresh = step_fleet(StandIn(fault, rarity=4))
    sound, _ = step_fleet(StandIn())
    struck = np.asarray(after.metrics[cause]) == 1
    assert 5 < struck.sum() < 30
    assert_finite(after)
    np.testing.assert_array_equal(np.asarray(after.done) == 1, struck)
    assert np.all(np.asarray(after.info["truncation"]) == 0)
    assert np.all(np.asarray(after.reward)[struck] == 0)
    for name in after.obs:
        np.testing.assert_array_equal(
            np.asarray(after.obs[name])[struck], np.asarray(fresh.obs[name])[struck]
        )
    for ours, theirs in zip(
        jax.tree.leaves(after), jax.tree.leaves(sound), strict=True
    ):
        np.testing.assert_array_equal(
            np.asarray(ours)[~struck], np.asarray(theirs)[~struck]
        )
    assert sum(float(jnp.sum(after.metrics[name])) for name in FAULTS) == struck.sum()


def test_an_action_or_a_state_that_is_not_finite_is_the_same():
    def break_robots(state, action):
        time = state.pipeline_state.at[1].set(jnp.inf)
        return dataclasses.replace(state, pipeline_state=time), action.at[2].set(
            jnp.nan
        )

    after, _ = step_fleet(StandIn(), break_robots)
    assert_finite(after)
    np.testing.assert_array_equal(np.flatnonzero(after.done), [1, 2])
    assert (
        float(after.metrics["fault/physics"][1])
        == float(after.metrics["fault/reward"][2])
        == 1
    )


def test_a_level_that_is_not_finite_does_not_outlive_the_episode():
    class Broken(StandIn):
        def step(self, state, action):
            after = super().step(state, action)
            return after.replace(info={**after.info, "curriculum": jnp.nan})

    def promote(state, action):
        return dataclasses.replace(
            state, info={**state.info, "curriculum": jnp.full(ROBOTS, 0.5)}
        ), action

    after, _ = step_fleet(Broken(), promote)
    assert_finite(after)
    assert np.all(np.asarray(after.info["curriculum"]) == 0.5)
    assert np.all(np.asarray(after.done) == 1)


def test_an_end_that_is_neither_yes_nor_no_is_an_end():
    class Broken(StandIn):
        def step(self, state, action):
            return super().step(state, action).replace(done=jnp.nan)

    after, fresh = step_fleet(Broken())
    assert_finite(after)
    assert np.all(np.asarray(after.done) == 1)
    np.testing.assert_array_equal(after.obs["state"], fresh.obs["state"])


def test_a_reset_that_is_not_finite_is_replaced_by_the_robots_own_state_and_counted_where_it_was_used():
    fleet = BatchedEnv(StandIn("reset", rarity=4), episode_length=100)
    state = fleet.reset(jax.random.split(jax.random.PRNGKey(0), ROBOTS))
    fresh = fleet.fresh_episodes(state, jax.random.split(jax.random.PRNGKey(1), ROBOTS))
    bad = np.asarray(fresh.metrics["fault/reset"]) == 1
    assert 5 < bad.sum() < 30
    assert_finite(fresh)
    np.testing.assert_array_equal(
        np.asarray(fresh.obs["state"])[bad], np.asarray(state.obs["state"])[bad]
    )
    assert not np.any(
        np.asarray(fresh.obs["state"])[~bad] == np.asarray(state.obs["state"])[~bad]
    )
    assert np.all(np.asarray(fresh.info["steps"]) == 0)
    ending = np.arange(ROBOTS) < 32
    state = dataclasses.replace(
        state, info={**state.info, "steps": jnp.where(ending, 99, 0)}
    )
    after = fleet.step(state, jnp.zeros((ROBOTS, 12)), fresh)
    np.testing.assert_array_equal(after.metrics["fault/reset"], bad & ending)


def test_a_run_survives_faulty_robots_and_says_so(faults, tmp_path):
    faults("physics", "state", "privileged_state", "reward", "reset", rarity=40)
    assert command.main([*RUN, "--out", str(tmp_path / "run")]) == 0
    assert_finite(restore(tmp_path / "run"))
    for name in FAULTS:
        assert max(record[name] for record in read_metrics(tmp_path / "run")) > 0
    assert all(
        value is not None
        for record in read_metrics(tmp_path / "run")
        for value in record.values()
    )
    log = (tmp_path / "run/log.txt").read_text()
    assert (
        log.count(
            "warning: steps that are not finite (a robot a control step): fault/physics"
        )
        == 1
    )


# --- A train step that is not finite is not taken -------------------------------------
def test_a_loss_that_overflows_leaves_the_state_as_it_was_and_stops_the_run(
    faults, tmp_path, capsys
):
    """A reward of -1e30 is finite; its square is not."""
    faults("huge", rarity=1000)
    run = tmp_path / "run"
    assert command.main([*RUN, "--out", str(run)]) == 1
    step = latest_step(run, FAILED)
    assert step is not None
    assert 2 < step < STEPS, "some train steps went well, one did not"
    error = capsys.readouterr().err
    kept = step - step % 2
    assert error == (
        f"train step {step + 1} is not finite and nothing was learned from it; kept step {kept} of {STEPS}; "
        f"see what it was: python train.py --replay {run}\n"
    )
    assert error.strip() in (run / "log.txt").read_text()
    assert latest_step(run) == kept
    assert all(record["step"] <= step * 64 for record in read_metrics(run))
    assert all(
        value is not None for record in read_metrics(run) for value in record.values()
    )

    # What was saved is the state that the sound train steps led to: parameters, Adam,
    # learning rate, robots, clock.
    learner = training.make_learner(training.load_run_config(run))
    state = learner.init(0)
    for _ in range(step):
        state, metrics = learner.train_step(state)
        assert float(metrics["not_finite"]) == 0
    failed = restore(run, folder=FAILED)
    assert_equal(state, failed)
    for _ in range(3):
        state, metrics = learner.train_step(state)
        assert float(metrics["not_finite"]) == 1
    assert_equal(state, failed)

    assert command.main(["--replay", str(run)]) == 0
    words = capsys.readouterr().out
    assert words.startswith(f"train step {step + 1}: in minibatch ")
    assert words.endswith("of 2, epoch 1 of 2: loss/v_loss is not finite\n")
    assert command.main(["--resume", str(run)]) == 1
    assert capsys.readouterr().err == error


@pytest.mark.parametrize(
    "path",
    [
        "params/policy/params/Dense_0/kernel",
        "optimizer/1/inner_state/0/nu/value/params/hidden_0/bias",
        "normalizer/mean/privileged_state",
        "fleet/obs/state",
    ],
)
def test_a_state_that_is_not_finite_is_named(faults, tmp_path, capsys, path):
    run = tmp_path / "run"
    assert (
        command.main(
            [*RUN, "--run.steps", "128", "--run.checkpoints", "1", "--out", str(run)]
        )
        == 0
    )
    config = training.load_run_config(run)
    longer = dataclasses.replace(
        config, run=dataclasses.replace(config.run, steps=STEPS * 64)
    )
    training.save_config(run / "config.json", longer)
    state = restore(run)
    leaves = {name: np.array(leaf) for name, leaf in leaves_by_path(state).items()}
    leaves[path].flat[5] = np.nan
    save_checkpoint(
        run,
        2,
        jax.tree.unflatten(jax.tree.structure(state), leaves.values()),
        to_json(longer),
    )
    capsys.readouterr()
    assert command.main(["--resume", str(run)]) == 1
    assert "train step 3 is not finite" in capsys.readouterr().err
    assert command.main(["--replay", str(run)]) == 0
    assert capsys.readouterr().out.startswith(
        f"train step 3: before the train step: {path} is not finite: 1 of "
    )


def explain(change=lambda state: state, **patched):
    learner = PPO(StandIn(), dataclasses.replace(TINY, num_epochs=1))
    for name, value in patched.items():
        setattr(learner, name, functools.partial(value, learner))
    return guards.explain(learner, change(learner.init(0)))


def test_actions_that_overflow_are_named_by_robot_and_time():
    def enlarge(state):
        policy = jax.tree.map(lambda x: x, state.params.policy)
        policy["params"]["Dense_0"]["kernel"] += 3e38
        return state.replace(params=state.params.replace(policy=policy))

    words = explain(enlarge)
    assert words.startswith(
        "in the batch (of robots and times): action is not finite: "
    )
    assert words.endswith(" of 960 numbers, the first at [0, 0, 0]")


def test_a_gradient_that_is_not_finite_is_named():
    """sqrt(0) is fine, its slope is not."""

    def loss(self, params, *rest):
        value, metrics = PPO.loss(self, params, *rest)
        return value + jnp.sqrt(
            0.0 * jnp.sum(params.value["params"]["hidden_0"]["bias"])
        ), metrics

    assert explain(loss=loss).startswith(
        "in minibatch 1 of 2, epoch 1 of 1: gradient/value/params/hidden_0/bias is not "
    )


def test_a_train_step_that_is_sound_after_all_is_said_to_be():
    assert explain().startswith(
        "nothing: done piece by piece, this train step is finite"
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--replay", "nowhere"], "no training run at nowhere"),
        (["--replay", "nowhere", "--run.steps", "5"], "--run.steps"),
        (["--replay", "sound"], "has no train step to replay: all that it made were"),
    ],
)
def test_what_cannot_be_replayed_is_refused(
    arguments, words, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sound").mkdir()
    training.save_config(tmp_path / "sound/config.json", TrainConfig())
    assert command.main(arguments) == 2
    assert words in capsys.readouterr().err


# --- Files that cannot be written -----------------------------------------------------
@pytest.mark.parametrize(
    ("owner", "name", "said"),
    [
        (checkpoint, "_write", "cannot save checkpoint 4 in "),
        (loop.Monitor, "log", "cannot write to "),
        (policy, "write_npz", "cannot write policy "),
    ],
    ids=["checkpoint", "metrics", "policy"],
)
def test_a_full_disk_stops_the_run_whatever_it_was_writing(
    faults, tmp_path, monkeypatch, capsys, owner, name, said
):
    """From the checkpoint of train step 2 on nothing can be written."""
    run = tmp_path / "run"
    real = getattr(owner, name)

    def full(*arguments):
        # saves go on beside the training: it may be 4 already when the next is asked
        if (latest_step(run) or 0) >= 2:
            raise OSError(28, "No space left on device")
        return real(*arguments)

    with monkeypatch.context() as disk:
        disk.setattr(owner, name, full)
        assert command.main([*RUN, "--out", str(run)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(said)
    assert "No space left on device" in error
    kept = latest_step(run)
    assert error.endswith(
        f"; kept step {kept} of {STEPS}, fix that and continue: python train.py --resume {run}\n"
    )
    assert error.count("\n") == 1
    assert error.strip() in (run / "log.txt").read_text()
    assert command.main(["--resume", str(run)]) == 0
    assert [record["step"] for record in read_metrics(run)] == [
        128 * n for n in range(1, 7)
    ]


def test_an_unexpected_failure_leaves_its_traceback_in_the_run(
    faults, tmp_path, monkeypatch, capsys
):
    def crash(*_):
        raise RuntimeError("the device\nis gone")

    monkeypatch.setattr(loop._Loop, "repeat", crash)
    assert command.main([*RUN, "--out", str(tmp_path / "run")]) == 1
    (log,) = (tmp_path / "run").glob("failure-*.log")
    assert (
        capsys.readouterr().err
        == f"failed: RuntimeError: the device is gone; log: {log}\n"
    )
    assert "in crash" in log.read_text()


# --- Warnings -------------------------------------------------------------------------
FINE = {
    "loss/policy_dist_mean_std": 0.2,
    "loss/kl_mean": 0.011,
    "loss/v_loss": 0.01,
    "reward_square": 1e-4,
    "falls": 1e-3,
    "fall/exploded": 0.0,
    "loss/learning_rate": 3e-4,
    **dict.fromkeys(FAULTS, 0.0),
}


@pytest.mark.parametrize(
    ("change", "name", "words"),
    [
        (
            {"loss/policy_dist_mean_std": 0.0149},
            "entropy",
            "standard deviation 0.015; raise ppo.entropy_cost",
        ),
        (
            {"loss/kl_mean": 0.101, "loss/learning_rate": 1.1e-5},
            "kl",
            "mean KL 0.1, desired 0.01",
        ),
        # Rewards of 0.01 over 1 / (1 - 0.985) control steps make returns of 0.67; ten
        # times its square is 4.4.
        ({"loss/v_loss": 4.5}, "value", "value loss 4.5, returns of 0.67 at most"),
        ({"falls": 0.051}, "falls", "fall at once"),
        ({"fall/exploded": 0.0011}, "exploded", "physics explodes"),
        (
            {"fault/reset": 1e-7, "fault/reward": 0.02},
            "faults",
            "fault/reward 0.02, fault/reset 1e-07",
        ),
    ],
)
def test_signs_of_a_training_that_goes_wrong_are_put_into_words(change, name, words):
    config = TrainConfig().ppo
    assert guards.warnings(FINE, config) == {}
    found = guards.warnings(FINE | change, config)
    assert list(found) == [name]
    assert words in found[name]


@pytest.mark.parametrize(
    ("settings", "change"),
    [
        # a first jump, which a lower learning rate mends
        ({}, {"loss/kl_mean": 0.2, "loss/learning_rate": 4e-5}),
        ({"desired_kl": None}, {"loss/kl_mean": 9.0, "loss/learning_rate": 1e-5}),
        ({"reward_scaling": 2.0}, {"loss/v_loss": 4.5}),
        ({"initial_std": 0.1}, {"loss/policy_dist_mean_std": 0.01}),
    ],
)
def test_what_the_settings_allow_is_no_sign(settings, change):
    config = dataclasses.replace(TrainConfig().ppo, **settings)
    assert guards.warnings(FINE | change, config) == {}


def test_a_warning_is_said_once_until_it_has_been_away(monkeypatch):
    kl, falls = {"kl": "jumps"}, {"falls": "fall"}
    told, said, heard = Monitor(None, 1), [], []
    monkeypatch.setattr(told, "note", said.append)
    monkeypatch.setattr(monitor, "summarize", lambda means: means)
    lines = Log(told, TINY, Unlogged())
    for step, present in enumerate((kl, kl | falls, kl, {}, kl)):
        monkeypatch.setattr(
            guards, "warnings", lambda means, ppo, present=present: present
        )
        lines.add({NOT_FINITE: jnp.zeros(())})
        lines.close(step)
        lines.flush()
        heard.append([said.pop() for _ in list(said)])
    assert heard == [["warning: jumps"], ["warning: fall"], [], [], ["warning: jumps"]]
