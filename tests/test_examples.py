"""The examples of `examples/`, each once, as small as they can be."""

import types

import jax.numpy as jnp
import numpy as np
import optimiser_to_policy
import pytest
import reward_row
import slow_trot
import spring
import watch
from smallest import tiny

from bp2_rl.assets import asset_path
from bp2_rl.env.rewards import ROWS
from bp2_rl.evaluation.runs.trajectory import Trajectory
from bp2_rl.learning.policy import load_policy


def test_a_slow_trot_is_trained_into_a_folder(tmp_path):
    assert slow_trot.settings().env.commands.max_forward == 2.0
    lines = slow_trot.train(tiny(), tmp_path / "run")  # the programs of tests/learning/test_run.py, compiled once
    assert [line["step"] for line in lines] == [64, 128, 192, 256]
    assert all(np.isfinite(line["reward/tracking"]) for line in lines)
    assert load_policy(tmp_path / "run").card.stage == "imitation"


def test_a_policy_is_watched(tmp_path):
    metrics = watch.watch(asset_path("policies/default"), speed=2.0, hold=1.0, out=tmp_path)
    assert metrics.fell_at is None
    assert metrics.mean_speed == pytest.approx(2.0, abs=0.5)  # slow running is not this policy's strength
    run = Trajectory.load(tmp_path / "trajectory.npz")
    assert len(run) * run.dt == pytest.approx(2.0 / 2.4 + 1.0, abs=0.01)
    assert (tmp_path / "gait.png").stat().st_size > 1000


def test_springs_of_any_stiffness_bear_the_same_robot():
    soft, hard = (spring.try_spring(stiffness, speed=1.0, hold=0.2) for stiffness in (4000.0, 8000.0))
    assert 4000.0 * soft.sag == pytest.approx(8000.0 * hard.sag, rel=0.03)  # Hooke; a softer leg stands a bit steeper
    assert soft.fell_at is None


def test_a_reward_row_is_weighed_among_the_others():
    leaning = types.SimpleNamespace(e_z=jnp.array([np.sqrt(0.75), 0.0, 0.5]))  # by 60 degrees
    assert reward_row.level_trunk(leaning, None, None) == pytest.approx(0.1 * np.exp(-10.0), rel=1e-5)
    means = reward_row.weigh(steps=2, robots=2)
    assert means.keys() == {*ROWS, "level_trunk"}
    assert 0.09 < means["level_trunk"] <= 0.1  # the reference holds the trunk all but level


def test_a_stride_is_followed_from_the_optimiser_to_the_policy():
    found, missing = optimiser_to_policy.solved(8.0, 6)
    played = optimiser_to_policy.played(8.0)
    assert missing < 0.05  # of the motors' work, on six intervals; docs/notes/trajectories.md has finer meshes
    assert played.period == pytest.approx(found.period, rel=0.1)  # the library keeps a reserve, and near its neighbours
    slow, run = optimiser_to_policy.played(3.0), optimiser_to_policy.run(3.0, hold=1.5)
    assert run.period == pytest.approx(slow.period, rel=0.02)  # the policy's clock is the library's
