"""The examples of `examples/`, each once, as small as they can be; that which trains is
in learning/test_run.py."""

import json
import re
import sqlite3
import subprocess
import sys
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import reward_term
import spring
import tune
import watch
from refusals import python

from bp2_rl.base.assets import asset_path
from bp2_rl.env.rewards import TERMS
from bp2_rl.simulation import simulator
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.tools.study.outcome import PolicyMeasurement

EXAMPLES = Path(__file__).parents[1] / "examples"
TRAINED = 'bp2.preset("imitation", "smoke")'
SHORTER = """
from dataclasses import replace
def shorter(config):
    return replace(config, run=replace(config.run, steps=config.run.steps // 8))
"""


@pytest.fixture(autouse=True)
def _briefly_settled(monkeypatch):
    """Let robots settle for 0.3 s, which is within 4 % of a settled stand: where all
    shapes are checked, every millisecond counts."""
    monkeypatch.setattr(simulator, "SETTLING_TIME", 0.3)


def test_a_policy_is_watched(tmp_path):
    metrics = watch.watch(
        asset_path("policies/built"), speed=1.0, hold=0.3, out=tmp_path
    )
    assert metrics.fell_at is None
    # slow running is not this policy's strength
    assert metrics.mean_speed == pytest.approx(1.0, abs=0.5)
    run = Trajectory.load(tmp_path / "trajectory.npz")
    assert len(run) * run.dt == pytest.approx(1.0 / 2.4 + 0.3, abs=0.01)
    assert (tmp_path / "gait.png").stat().st_size > 1000


def test_springs_of_any_stiffness_bear_the_same_robot():
    soft, hard = (
        spring.try_spring(stiffness, speed=0.2, hold=0.1)
        for stiffness in (4000.0, 8000.0)
    )
    # Hooke; legs stand a little differently
    assert 4000.0 * soft.sag == pytest.approx(8000.0 * hard.sag, rel=0.03)
    assert soft.fell_at is None


def test_a_reward_term_is_weighed_among_the_others():
    # by 60 degrees
    leaning: Any = types.SimpleNamespace(e_z=jnp.array([np.sqrt(0.75), 0.0, 0.5]))
    unread: Any = None
    assert reward_term.level_trunk(leaning, unread, unread) == pytest.approx(
        np.exp(-10.0), rel=1e-5
    )
    means = reward_term.weigh(steps=2, robots=2)
    assert means.keys() == {*TERMS, "level_trunk"}
    # the reference holds the trunk all but level
    assert 0.09 < means["level_trunk"] <= 0.1


def test_the_notebook_runs(tmp_path, monkeypatch):
    """Run its cells one after the other as a program, without the notebook's magic, and
    with an eighth of its training."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    cells = json.loads((EXAMPLES / "quickstart.ipynb").read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    program = re.sub("^%.*$", "", "\n".join(code), flags=re.MULTILINE)
    assert TRAINED in program
    program = program.replace(TRAINED, f"shorter({TRAINED})")
    status, _, errors = python(tmp_path, "-c", SHORTER + program)
    assert status == 0, errors


def test_a_stride_is_followed_from_the_optimiser_to_the_policy():
    """In a process of its own, where shapes are not checked at each of the run's
    milliseconds."""
    program = (
        "import json; from optimiser_to_policy import played, run, solved; found, missing = solved(8.0, 6); "
        "print(json.dumps([missing, found.period, played(8.0).period, run(8.0, 1.0).period]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=EXAMPLES,
        capture_output=True,
        text=True,
        check=True,
    )
    missing, found, played, run = json.loads(done.stdout.splitlines()[-1])
    # of the motors' work, on six intervals; docs/notes/trajectories.md has finer meshes
    assert missing < 0.05
    # the library keeps a reserve, and stays near its neighbours
    assert played == pytest.approx(found, rel=0.1)
    assert run == pytest.approx(played, rel=0.02)  # the policy's clock is the library's


def test_a_search_keeps_what_it_knows_and_finds_the_better_settings(
    tmp_path, monkeypatch
):
    """With Optuna itself; a policy is as fast as tracking weighs, which takes no
    training."""
    pytest.importorskip("optuna", reason="Optuna is not installed (the extra `tune`)")
    monkeypatch.setattr(tune, "OUT", tmp_path)
    monkeypatch.setattr(
        tune, "top_speed", lambda config, folder: config.env.reward.tracking
    )
    with ThreadPoolExecutor(2) as here:
        first = tune.search(here, trials=4, at_once=2)
        best = tune.search(here, trials=4, at_once=2)
    assert best.value is not None
    assert first.value is not None
    assert 0.5 <= first.value <= best.value <= 3.0
    assert best.value == best.params["tracking"]
    with sqlite3.connect(tmp_path / "tune.db") as kept:
        [(trials,)] = kept.execute("select count(*) from trials where state='COMPLETE'")
    kept.close()
    assert trials == 8


def test_what_a_search_chooses_is_trained(tmp_path, monkeypatch):
    """The settings that were asked for reach the training, and the fastest of its
    policies counts."""
    chosen = {"tracking": 2.0, "learning_rate": 3e-4, "entropy_cost": 1e-3}
    trial: Any = types.SimpleNamespace(
        suggest_float=lambda name, low, high, log=False: chosen[name]
    )
    trained = []
    monkeypatch.setattr(tune.bp2, "train", lambda *asked: trained.append(asked))
    judged = [PolicyMeasurement(1, "", speed, 0) for speed in (3.0, 9.0, 0.0)]
    monkeypatch.setattr(tune, "measure_policies", lambda folder: judged)
    assert tune.top_speed(tune.settings(trial), tmp_path) == 9.0
    [(config, folder)] = trained
    assert folder == tmp_path
    assert config.env.reward.tracking == 2.0
    assert (config.ppo.learning_rate, config.ppo.entropy_cost) == (3e-4, 1e-3)
    assert config.run.judged == 0
