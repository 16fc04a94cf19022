"""Studies: what is run in which order, what is not run again, and the figures over seeds."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from bp2_rl.cli import study as command
from bp2_rl.cli.train import _parse
from bp2_rl.errors import UserError
from bp2_rl.evaluation import study
from bp2_rl.evaluation.study import Judgement, Plan, Training
from bp2_rl.learning import train
from bp2_rl.learning.policy import Policy, save_policy

PLAN = Plan(variants=("ours", "paper"), seeds=(0, 1), preset="smoke", steps=(2048, 1024))


# --- What is run ---------------------------------------------------------------------------------------------


def test_variants_of_the_relaxed_stage_go_on_from_the_same_imitation_run():
    names = [[training.name for training in chain] for chain in PLAN.chains]
    assert names == [[f"ours-{s}-imitation", f"ours-{s}-relaxed", f"paper-{s}-relaxed"] for s in (0, 1)]
    words = PLAN.command(Training("paper", 1, "relaxed"), Path("folder"))
    assert words[words.index("--from") + 1] == "folder/ours-1-imitation"


@pytest.mark.parametrize("name", study.VARIANTS)
def test_train_understands_the_flags_of_every_variant(name):
    """Each sets what its meaning says, on top of the preset."""
    plan = dataclasses.replace(PLAN, variants=(name,), preset="gpu")
    imitation = _parse(plan.command(plan.chains[0][0], Path("folder")))
    assert imitation.run.steps == 2048
    assert imitation.env.reference == (name if name in ("kinematic", "none") else "collocation")
    assert imitation.env.reset.standing_fraction == (1.0 if name == "standing" else 0.3)


def test_the_steps_of_a_study_are_the_presets():
    assert study.default_steps("gpu") == (60_000_000, 100_000_000)


@pytest.fixture
def trained(tmp_path, monkeypatch, make_card):
    """A folder for a study in which trainings take no time; `started` names those that were run."""
    started: list[str] = []

    def run_train(arguments, run_dir, gpu):
        started.append(run_dir.name)
        if run_dir.name in failing:
            return False
        for steps in (512, 1024):
            card = make_card(physics_steps=5 * steps, created="2026-01-01T00:01:00Z")
            layers = tuple(
                (np.zeros(shape, np.float32), np.zeros(shape[1], np.float32)) for shape in ((47, 4), (4, 12))
            )
            policy = Policy(card, np.zeros(47, np.float32), np.ones(47, np.float32), layers)
            save_policy(run_dir / train.POLICIES / str(steps), policy)
        train.save_config(run_dir / "config.json", train.TrainConfig())
        run_dir.with_suffix(".txt").write_text(f"2026-01-01T00:00:00+00:00 --out {run_dir}\nnoise\n")
        return True

    failing: set[str] = set()
    monkeypatch.setattr(study, "_train", run_train)
    monkeypatch.setattr(study, "is_finished", lambda run_dir: run_dir.name in started)
    monkeypatch.setattr(study.concurrent.futures, "ProcessPoolExecutor", _Here)
    monkeypatch.setattr(
        study, "_judge", lambda policy, steps, wall: Judgement(steps, wall, steps / 64, None, 10.0, 0.5)
    )
    return tmp_path / "study", started, failing


class _Here(study.concurrent.futures.ThreadPoolExecutor):
    """Judges in a thread, where what a test replaces is seen."""

    def __init__(self, workers, **_):
        super().__init__(workers)


def run(folder, plan=PLAN):
    said: list[str] = []
    return study.run(plan, folder, gpus=("0", "1"), judges=1, say=said.append), said


def test_a_study_trains_each_run_once_and_judges_every_saved_policy(trained):
    folder, started, _ = trained
    assert run(folder)[0] == []
    assert sorted(started) == sorted(training.name for chain in PLAN.chains for training in chain)
    judged = study.judgements(folder / "paper-1-relaxed")
    assert [(j.control_steps, j.top_speed, j.wall_time) for j in judged] == [(512, 8.0, 60.0), (1024, 16.0, 60.0)]
    before = list(started)
    assert run(folder)[0] == []
    assert started == before


def test_what_needs_a_failed_run_is_not_begun_and_the_others_go_on(trained):
    folder, started, failing = trained
    failing.add("ours-0-imitation")
    without, said = run(folder)
    assert [training.name for training in without] == ["ours-0-imitation", "ours-0-relaxed", "paper-0-relaxed"]
    assert "paper-1-relaxed" in started
    assert "ours-0-relaxed" not in started
    assert any("ours-0-imitation failed: see" in line for line in said)


def test_a_study_of_another_size_is_not_mixed_in(trained):
    folder, *_ = trained
    run(folder)
    with pytest.raises(UserError, match=r"holds a study with --preset smoke --steps 2048 1024"):
        run(folder, dataclasses.replace(PLAN, steps=(4096, 1024)))


def test_the_command_leaves_a_table_and_learning_curves(trained, capsys):
    folder, *_ = trained
    flags = ["--variants", "ours", "paper", "--seeds", "0", "1", "--preset", "smoke", "--out", str(folder)]
    assert command.main(flags) == 0
    assert "| paper | 16.00 |" in capsys.readouterr().out
    assert json.loads((folder / "ours.json").read_text())["steps_to_goal"] == [1024, 1024]
    assert (folder / "learning_curves.png").stat().st_size > 10_000
    assert "| ours | 16.00 |" in (folder / "table.md").read_text()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--variants", "fast"], "no variant 'fast'"),
        (["--seeds"], "seed"),
        (["--steps", "0", "5"], "steps must be positive"),
        (["--judges", "0"], "--judges"),
        (["--no-train"], "no judged run of ours"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, monkeypatch, capsys, flags, words):
    monkeypatch.chdir(tmp_path)
    assert command.main(flags) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not any(tmp_path.iterdir())


# --- A training's process ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("code", "ended"), [("", True), ("raise SystemExit(2)", False)])
def test_a_training_is_a_process_of_its_own_on_its_gpu(tmp_path, monkeypatch, code, ended):
    script = tmp_path / "python"
    script.write_text(
        f"#!{sys.executable}\nimport os, sys\nprint(os.environ['CUDA_VISIBLE_DEVICES'], sys.argv[1:])\n{code}\n"
    )
    script.chmod(0o755)
    monkeypatch.setattr(study.sys, "executable", str(script))
    killed_early = tmp_path / "run"
    killed_early.mkdir()
    assert study._train(["--stage", "imitation"], killed_early, "3") is ended
    assert "3 ['-m', 'bp2_rl', 'train', '--stage', 'imitation']" in (tmp_path / "run.txt").read_text()
    assert not killed_early.exists()
    (killed_early / "checkpoints" / "2").mkdir(parents=True)
    study._train(["--stage", "imitation"], killed_early, "3")
    assert f"'--resume', '{killed_early}'" in (tmp_path / "run.txt").read_text()


# --- Judging and figures -------------------------------------------------------------------------------------


def test_a_policy_that_falls_has_no_top_speed(monkeypatch, make_policy, make_run):
    for fell_at, speed in ((None, 5.0), (7.9, 0.0)):
        monkeypatch.setattr(study, "rollout_mujoco", lambda *_, fell_at=fell_at: make_run(fell_at=fell_at))
        judgement = study._judge(make_policy(), 5, None)
        assert judgement.top_speed == pytest.approx(speed)
        assert judgement.cruise_speed == pytest.approx(speed)
        assert judgement.cruise_cost is None  # 5 m/s are not 10


def test_the_cost_of_cruising_is_that_at_10_m_s_of_a_policy_that_runs_slower_than_told(
    monkeypatch, make_policy, make_run
):
    told: list[float] = []

    def rollout(policy, ramp, config):
        told.append(ramp.target[0])
        return make_run(speed=0.8 * ramp.target[0], acceleration=5.0)

    monkeypatch.setattr(study, "rollout_mujoco", rollout)
    judgement = study._judge(make_policy(), 5, None)
    assert told == pytest.approx([15.5, 10.0, 12.5], rel=1e-3)
    assert judgement.cruise_speed == pytest.approx(10.0, rel=1e-3)
    assert judgement.cruise_cost == 0.0  # nothing in this run takes power


def test_the_interquartile_mean_leaves_out_the_outer_quarters():
    assert study.interquartile_mean(np.array([0.0, 1.0, 2.0, 3.0, 100.0])) == pytest.approx(2.0)
    assert study.interquartile_mean(np.array([1.0, 2.0, 6.0])) == pytest.approx(3.0)


def test_the_bootstrap_interval_is_scipys():
    values = np.random.default_rng(3).normal(15.0, 0.2, 12)
    peer = stats.bootstrap((values,), study.interquartile_mean, method="percentile", rng=np.random.default_rng(5))
    assert study.bootstrap_interval(values) == pytest.approx(tuple(peer.confidence_interval), abs=0.01)


def test_the_goal_is_reached_by_the_first_policy_that_does_in_either_stage():
    def judged(*speeds, wall=10.0, before=0):
        return [Judgement(before + i, wall * i, v, None, 0.0, None) for i, v in enumerate(speeds, start=1)]

    slow, fast = judged(3.0, 9.0), judged(9.0, 10.74, 10.0, before=2)
    assert study._goal(fast, fast) == (4, 20.0)
    assert study._goal(slow, fast) == (4, 40.0)
    assert study._goal(slow, slow) == (None, None)
    resumed = [dataclasses.replace(j, wall_time=None) for j in slow]
    assert study._goal(resumed, fast) == (4, None)
