"""Studies: the order of runs, the runs that are not repeated, and the metrics over
seeds."""

import asyncio
import dataclasses
import gc
import json
import math
import operator
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import lock_folder
from bp2_rl.base.serialization import save_config
from bp2_rl.cli import study as command
from bp2_rl.cli.train import TrainArguments, read_arguments
from bp2_rl.evaluation import judge
from bp2_rl.learning.judged import POLICIES
from bp2_rl.learning.policy import Policy, load_policy, save_policy
from bp2_rl.settings.env import TrackingShape
from bp2_rl.settings.jobs import JobsConfig
from bp2_rl.settings.presets import preset
from bp2_rl.settings.presets.rewards import PAPER
from bp2_rl.settings.training import RunConfig, Stage, TrainConfig
from bp2_rl.tools.study import outcome, running
from bp2_rl.tools.study.outcome import PolicyMeasurement
from bp2_rl.tools.study.plan import STAGES, VARIANTS, Plan, Training

PLAN = Plan(
    variants=("ours", "paper"), seeds=(0, 1), preset="smoke", steps=(2048, 1024)
)
FLAGS = ["--variants", "ours", "paper", "--seeds", "0", "1", "--preset", "smoke"]


# --- What is run ----------------------------------------------------------------------


def test_variants_of_the_relaxed_stage_go_on_from_the_same_imitation_run():
    names = [[training.name for training in chain] for chain in PLAN.chains]
    assert names == [
        [f"ours-{s}-imitation", f"ours-{s}-relaxed", f"paper-{s}-relaxed"]
        for s in (0, 1)
    ]
    words = PLAN.command(Training("paper", 1, "relaxed"), Path("folder"))
    assert words[words.index("--from") + 1] == "folder/ours-1-imitation"


def test_a_task_is_a_variant_whose_later_stage_inherits_it():
    [[first, then]] = Plan(("a/my_task.py:OTHER",), (0,), "smoke", (2, 1)).chains
    assert first.name == "my_task-OTHER-0-imitation"
    assert "a/my_task.py:OTHER" in PLAN.command(first, Path())
    assert "--task" not in PLAN.command(then, Path())
    with pytest.raises(UserError, match=r"each once"):
        Plan(("a/my_task.py", "b/my_task.py"), (0,), "smoke", (2, 1))


SETS = {
    "ours": {},
    "paper": {},
    "no_symmetry_reward": {},
    "kinematic": {"env.reference": "kinematic"},
    "none": {"env.reference": "none"},
    "standing": {"env.reset.standing_fraction": 1.0},
    "published": {"env.reference": "kinematic", "env.control.mode": "absolute"},
    "plain_networks": {"ppo.symmetric": False},
    "no_averaging": {"ppo.averaging": 0.0},
    "stock_mjx": {"impl": "jax"},
    "hopping": {"env.library.path": "bp2_trot"},
    "no_history": {"env.control.history": ()},
    "paper_kernel": {"env.reward.tracking_shape": TrackingShape()},
    "unscheduled": {"env.reward.schedule": "off"},
    "no_randomization": {"env.randomization.enabled": False},
}
"""What a variant changes in both stages, besides the weights of rewards."""
SETS_LATER = {
    "no_symmetry_reward": {"env.reward.symmetry": 0.0},
}
"""Likewise, in the relaxed stage alone."""


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_is_the_recipe_but_for_what_it_names(name, tmp_path):
    plan = dataclasses.replace(PLAN, variants=(name,), preset="gpu")
    first, second = plan.chains[0]
    imitation = read_arguments(plan.command(first, tmp_path))
    (tmp_path / first.name).mkdir()
    save_config(tmp_path / first.name / "config.json", _config(imitation, "imitation"))
    relaxed = read_arguments(plan.command(second, tmp_path))
    assert (imitation.run.steps, relaxed.run.steps) == PLAN.steps
    for stage, parsed in zip(STAGES, (imitation, relaxed), strict=True):
        config, recipe = _config(parsed, stage), preset(stage, "gpu")
        later = SETS_LATER.get(name, {}) if stage == "relaxed" else {}
        for field, value in (SETS[name] | later).items():
            got, ours = (
                operator.attrgetter(field)(settings) for settings in (config, recipe)
            )
            assert got == value != ours
            config = _with(config, field, ours)
        assert config.ppo == recipe.ppo
        assert dataclasses.replace(config.env, reward=recipe.env.reward) == recipe.env
        reward = (
            PAPER[stage]
            if name == "published" or (name, stage) == ("paper", "relaxed")
            else recipe.env.reward
        )
        assert config.env.reward == reward


def _config(parsed: TrainArguments, stage: Stage) -> TrainConfig:
    return TrainConfig(stage, parsed.env, parsed.ppo, parsed.run, parsed.impl)


def _with(settings, field, value):
    """Return the settings with another value of one field, by its dotted name."""
    head, _, rest = field.partition(".")
    return dataclasses.replace(
        settings,
        **{head: _with(getattr(settings, head), rest, value) if rest else value},
    )


@pytest.fixture
def trained(tmp_path, monkeypatch, make_card):
    """Return a folder for a study in which trainings take no time; `started` names the
    trainings that were run."""
    started: list[str] = []

    async def run_train(self, arguments, run_dir, gpu, task):
        started.append(run_dir.name)
        if run_dir.name in failing:
            return False
        config = dataclasses.replace(
            preset("imitation", "smoke"), run=RunConfig(steps=2048)
        )
        for steps in (1024, 2048):
            card = make_card(physics_steps=5 * steps)
            layers = tuple(
                (np.zeros(shape, np.float32), np.zeros(shape[1], np.float32))
                for shape in ((47, 4), (4, 12))
            )
            mean = np.full(47, steps + len(started), np.float32)
            save_policy(
                run_dir / POLICIES / str(steps),
                Policy(card, mean, np.ones(47, np.float32), layers),
            )
        save_config(run_dir / "config.json", config)
        return True

    def measure(policy):
        steps = policy.card.physics_steps // 5
        return PolicyMeasurement(steps, policy.card.weights_sha256, steps / 128, 0)

    failing: set[str] = set()
    monkeypatch.setattr(running.Here, "train", run_train)
    monkeypatch.setattr(
        running, "spawned", lambda count, initializer: ThreadPoolExecutor(count)
    )
    monkeypatch.setattr(outcome, "_measure", measure)
    return tmp_path / "study", started, failing


def run(folder, plan=PLAN):
    said: list[str] = []
    return running.run_study(
        plan, folder, running.Resources(("0", "1"), 1, said.append)
    ), said


def test_a_study_trains_each_run_once_and_judges_every_saved_policy(trained):
    folder, started, _ = trained
    names = sorted(training.name for chain in PLAN.chains for training in chain)
    for _ in range(2):  # nothing is left to do for the second
        assert run(folder)[0] == []
        assert sorted(started) == names
    judged = outcome.read_measurements(folder / "paper-1-relaxed")
    assert [(j.control_steps, j.top_speed) for j in judged] == [
        (1024, 8.0),
        (2048, 16.0),
    ]


def test_a_policy_that_was_replaced_is_judged_anew(trained, monkeypatch):
    folder, *_ = trained
    run(folder)
    run_dir = folder / "paper-1-relaxed"
    save_policy(run_dir / POLICIES / "1024", load_policy(run_dir / POLICIES / "2048"))
    assert [j.control_steps for j in outcome.measure_policies(run_dir)] == [
        2048,
        2048,
    ]


def test_what_needs_a_failed_run_is_not_begun_and_the_others_go_on(trained):
    folder, started, failing = trained
    failing |= {"ours-0-imitation", "ours-1-relaxed"}
    without, said = run(folder)
    assert sorted(training.name for training in without) == [
        "ours-0-imitation",
        "ours-0-relaxed",
        "ours-1-relaxed",
        "paper-0-relaxed",
    ]
    assert "paper-1-relaxed" in started
    assert "ours-0-relaxed" not in started
    assert any("ours-0-imitation failed: see" in line for line in said)


def test_the_command_leaves_a_table_of_the_seeds_that_are_there_and_figures(
    trained, capsys
):
    folder, _, failing = trained
    failing.add("ours-0-relaxed")
    assert command.main([*FLAGS, "--out", str(folder)]) == 1
    printed = capsys.readouterr()
    assert "| ours | 1 | 16.00 |" in printed.out
    assert "| paper | 0, 1 | 16.00 |" in printed.out
    assert printed.err == "not trained: ours-0-relaxed; call again to go on\n"
    failing.clear()
    assert command.main([*FLAGS, "--out", str(folder)]) == 0
    assert "| ours | 0, 1 | 16.00 |" in (folder / "table.md").read_text()
    steps = json.loads((folder / "ours.json").read_text())["steps_to_goal"]
    assert steps == [2048, 2048]
    assert (folder / "learning_curves.png").stat().st_size > 10_000


def test_a_study_of_another_size_or_recipe_or_process_is_not_mixed_in(
    trained, monkeypatch
):
    folder, *_ = trained
    run(folder)
    with (
        lock_folder(folder, "busy"),
        pytest.raises(UserError, match="another study is at work"),
    ):
        run(folder)
    with pytest.raises(UserError, match="holds a study with another steps "):
        run(folder, dataclasses.replace(PLAN, steps=(4096, 1024)))
    monkeypatch.setattr(
        running, "preset", lambda stage, _, robot: preset(stage, "cpu", robot=robot)
    )
    with pytest.raises(UserError, match="holds a study with another settings "):
        run(folder)


def test_variants_that_all_fall_are_not_compared(trained, monkeypatch, capsys):
    folder, *_ = trained
    measured = outcome._measure
    monkeypatch.setattr(
        outcome,
        "_measure",
        lambda *a: dataclasses.replace(measured(*a), top_speed=0.0, falls=3),
    )
    assert command.main([*FLAGS, "--out", str(folder)]) == 0
    assert (
        "all last policies of ours, paper fell in every launch"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--variants", "fast"], "no variant 'fast'"),
        (["--seeds"], "seed"),
        (["--seeds", "1", "1"], "each once"),
        (["--seeds", "-1"], "--seeds must be from 0 to 4294967295, got -1"),
        (["--seeds", str(2**63)], "--seeds must be from 0 to 4294967295"),
        (["--no-train", "--out", "x" * 5000], "no file or folder can be called"),
        (["--steps", "0", "5"], "--steps must be"),
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


# --- A training's process -------------------------------------------------------------


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Return a maker of places of one GPU, whose train.py prints its arguments and then
    does what `code` says."""

    lock = (tmp_path / ".lock").open("w")

    def make(code=""):
        script = tmp_path / "python"
        script.write_text(
            f"#!{PYTHON}\nimport os, sys, time\n"
            f"print(os.environ['CUDA_VISIBLE_DEVICES'], sys.argv[1:], flush=True)\n{code}\n"
        )
        script.chmod(0o755)
        monkeypatch.setattr(running.sys, "executable", str(script))
        return running.Here(("3",), lock.fileno())

    yield make
    lock.close()


RUN, PYTHON = PLAN.chains[0][0], sys.executable


def begin(place, folder):
    [gpu] = place.slots
    return running._train(PLAN, folder, place, gpu, RUN, print)


@pytest.mark.parametrize(
    ("told", "gpus"),
    [("", ()), ("-1", ()), ("2", ("2",)), ("0,2", ("0", "2")), ("3,-1,1", ("3",))],
)
def test_only_gpus_before_one_that_cannot_be_are_there(monkeypatch, told, gpus):
    """As CUDA reads its variable."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", told)
    assert running.visible_gpus() == gpus


@pytest.mark.parametrize(
    ("code", "ended"), [("", True), ("raise SystemExit(2)", False)]
)
def test_a_training_is_a_process_of_its_own_on_its_gpu(tmp_path, here, code, ended):
    killed_early = tmp_path / RUN.name
    policy = killed_early / POLICIES / "1024"
    killed_early.mkdir()
    output = killed_early.with_suffix(".txt")
    assert asyncio.run(begin(here(code), tmp_path)) is ended
    assert "3 ['-m', 'bp2_rl', 'train', '--stage', 'imitation'" in output.read_text()
    assert not killed_early.exists()
    policy.mkdir(parents=True)  # a run that has policies is never deleted
    asyncio.run(begin(here(code), tmp_path))
    assert policy.is_dir()
    (killed_early / "checkpoints" / "2").mkdir(parents=True)
    (killed_early / "checkpoints" / "2" / "metadata.json").touch()
    asyncio.run(begin(here(code), tmp_path))
    assert f"'--resume', '{killed_early}'" in output.read_text()


def test_neither_a_training_nor_what_it_prints_goes_through_a_link(
    tmp_path, here, capsys
):
    run_dir, elsewhere, victim = (
        tmp_path / name for name in (RUN.name, "elsewhere", "victim")
    )
    victim.write_text("theirs")
    run_dir.with_suffix(".txt").symlink_to(victim)
    assert asyncio.run(begin(here(), tmp_path)) is False
    assert victim.read_text() == "theirs"
    elsewhere.mkdir()
    run_dir.symlink_to(elsewhere)
    assert asyncio.run(begin(here(), tmp_path)) is False
    said = capsys.readouterr().out
    assert f"{run_dir} is a link to elsewhere: remove it\n" in said
    assert list(elsewhere.iterdir()) == []


def test_stopping_ends_what_runs(tmp_path, here, capsys):
    output = (tmp_path / RUN.name).with_suffix(".txt")

    async def stop_early():
        training = asyncio.ensure_future(begin(here("time.sleep(60)"), tmp_path))
        while not (output.is_file() and "-m" in output.read_text()):
            await asyncio.sleep(0.01)
        training.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(training, timeout=30.0)

    asyncio.run(stop_early())
    assert capsys.readouterr().out == f"{RUN.name} stopped: see {output}\n"


def test_an_interrupted_study_ends_its_trainings_and_goes_on_later(
    trained, monkeypatch, caplog
):
    folder, started, _ = trained
    train, stopped = running.Here.train, []

    async def interrupt(self, arguments, run_dir, gpu, task):
        if run_dir.name == "ours-1-relaxed":
            raise KeyboardInterrupt
        if run_dir.name == "ours-0-relaxed":
            try:
                await asyncio.sleep(60)
            except asyncio.CancelledError:
                stopped.append(run_dir.name)
                raise
        return await train(self, arguments, run_dir, gpu, task)

    with monkeypatch.context() as patch:
        patch.setattr(running.Here, "train", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run(folder)
    assert stopped == ["ours-0-relaxed"]
    gc.collect()  # then asyncio would say what nobody asked for
    assert caplog.records == []
    before = len(started)
    assert run(folder)[0] == []
    assert len(set(started)) == len(started) == 6 > before


def test_what_cannot_be_measured_ends_the_study_with_its_own_error(
    trained, monkeypatch
):
    folder, *_ = trained

    def fail(policy):
        raise UserError("the disk is full")

    monkeypatch.setattr(outcome, "_measure", fail)
    with pytest.raises(UserError, match="the disk is full"):
        run(folder)


STUDY = """
import sys
from pathlib import Path
from bp2_rl.tools.study import running
from bp2_rl.tools.study.plan import Plan

if __name__ == "__main__":
    running.sys.executable = sys.argv[1]
    plan = Plan(("ours",), (0,), "smoke", (2048, 1024))
    running.run_study(plan, Path(sys.argv[2]), running.Resources((), 1, print))
"""
TRAINING = """
import os, signal, time
from bp2_rl.base.processes import end_with_caller

def save(*_):
    while not os.path.exists("let go"):
        time.sleep(0.01)
    os._exit(0)

signal.signal(signal.SIGTERM, save)
end_with_caller()
print("training", flush=True)
time.sleep(600)
"""


def test_a_killed_studys_trainings_save_and_end_and_nobody_else_works_there_before(
    tmp_path,
):
    folder, study, fake = tmp_path / "study", tmp_path / "study.py", tmp_path / "python"
    study.write_text(STUDY)
    fake.write_text(f"#!{PYTHON}\n{TRAINING}")
    fake.chmod(0o755)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    log = folder / "ours-0-imitation.txt"
    with subprocess.Popen(
        [PYTHON, study, fake, folder], cwd=tmp_path, env=environment
    ) as process:
        wait_until(lambda: log.is_file() and log.read_text().endswith("training\n"))
        process.kill()
    with pytest.raises(UserError, match="busy"), lock_folder(folder, "busy"):
        pass
    (tmp_path / "let go").touch()
    wait_until(lambda: is_free(folder))


def is_free(folder):
    try:
        with lock_folder(folder, "busy"):
            return True
    except UserError:
        return False


def wait_until(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


JOB = """
import os, shutil, signal, sys
from pathlib import Path

def save(*_):
    (run_dir / "checkpoints" / "2").mkdir(parents=True)
    (run_dir / "checkpoints" / "2" / "metadata.json").touch()
    sys.exit(143)

words = sys.argv[1:]
run_dir = Path(words[words.index("--resume" if "--resume" in words else "--out") + 1])
if run_dir.name.endswith("imitation") and "--resume" not in words:
    signal.signal(signal.SIGTERM, save)
    os.kill(os.getppid(), signal.SIGUSR2)  # as Slurm, that wants its machine back
    signal.pause()
shutil.copytree(Path(os.environ["PREPARED"]) / run_dir.name, run_dir, dirs_exist_ok=True)
"""


def test_on_a_cluster_each_training_is_a_job_that_outlives_preemption(
    trained, tmp_path, monkeypatch
):
    """submitit itself, its local executor; the training alone is a stand-in, which the
    scheduler stops once."""
    pytest.importorskip(
        "submitit", reason="submitit is not installed (the extra `cluster`)"
    )
    folder, *_ = trained
    plan = dataclasses.replace(PLAN, variants=("ours",), seeds=(0,))
    run(folder, plan)
    monkeypatch.setenv("PREPARED", str(folder.rename(tmp_path / "prepared")))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    monkeypatch.setattr(running, "TRAIN", ("-c", JOB))
    gathered: list[str] = []
    jobs = JobsConfig(executor="local", gpus=0, cpus=1)
    resources = running.Resources((), 1, print, jobs)
    missing = running.run_study(
        plan, folder, resources, lambda training: gathered.append(training.name)
    )
    assert missing == []
    assert gathered == ["ours-0-imitation", "ours-0-relaxed"]
    first, second = (folder / "ours-0-imitation.txt").read_text().splitlines()
    assert " --stage imitation " in first
    assert second.endswith(f" --resume {folder / 'ours-0-imitation'}")
    assert len(list((folder / "jobs").glob("*_result.pkl"))) == 2


# --- Judging and figures --------------------------------------------------------------


@pytest.mark.parametrize(
    ("ran", "survives", "top_speed", "told"),
    [
        (lambda told: 9.0, 10.0, 9.0, [15.5, 12.4, 9.3]),
        (lambda told: 9.0, 0.0, 0.0, [15.5, 12.4, 9.3]),  # it always falls
        # no slower command can make a faster run than 12.4 m/s
        (lambda told: 0.8001 * told, 20.0, 0.8001 * 15.5, [15.5]),
    ],
)
def test_the_top_speed_is_the_best_under_any_command_that_the_robot_survives(
    monkeypatch, make_policy, make_run, ran, survives, top_speed, told
):
    asked: list[float] = []

    def simulate(policy, requests, config=None):
        asked.append(speed := requests[0].schedule.target[0])
        fell_at = 7.9 if speed > survives else None
        return [make_run(speed=ran(speed), acceleration=5.0, fell_at=fell_at)]

    monkeypatch.setattr(judge, "simulate", simulate)
    measured = outcome._measure(make_policy())
    assert measured.top_speed == pytest.approx(top_speed)
    assert asked == pytest.approx(told)
    assert measured.falls == sum(speed > survives for speed in told)


@pytest.mark.parametrize(
    ("values", "mean"), [([0.0, 1.0, 2.0, 3.0, 100.0], 2.0), ([1.0, 2.0, 6.0], 3.0)]
)
def test_the_interquartile_mean_leaves_out_the_outer_quarters(values, mean):
    assert outcome.interquartile_mean(np.array(values)) == pytest.approx(mean)


def test_the_bootstrap_interval_is_scipys():
    values = np.random.default_rng(3).normal(15.0, 0.2, 12)
    peer = stats.bootstrap(
        (values,),
        outcome.interquartile_mean,
        method="percentile",
        rng=np.random.default_rng(5),
    )
    assert outcome.bootstrap_interval(values) == pytest.approx(
        tuple(peer.confidence_interval), abs=0.01
    )


def test_the_interval_of_a_difference_is_welchs_and_there_is_none_where_nothing_scatters():
    values, others = (13.4, 13.9, 13.1), (11.0, 12.1, 11.4)
    means, variances = (
        tuple(f(x) for x in (values, others))
        for f in (np.mean, lambda x: np.var(x, ddof=1) / 3)
    )
    freedom = sum(variances) ** 2 / sum(v**2 / 2 for v in variances)
    reach = stats.t.ppf(0.975, freedom) * np.sqrt(sum(variances))
    found = outcome.difference_interval(values, others)
    assert found == pytest.approx(
        (means[0] - means[1] - reach, means[0] - means[1] + reach)
    )
    for same in ((13.0,), (13.0, 13.0)):
        assert outcome.difference_interval((0.0, 0.0), same) == (-math.inf, math.inf)


@pytest.mark.parametrize(
    ("speeds", "reached"), [((3.0, 9.0, 9.0, 10.74, 10.0), 4), ((3.0, 9.0), None)]
)
def test_the_goal_is_reached_by_the_first_policy_that_does(speeds, reached):
    judged = [PolicyMeasurement(i, "", v, 0) for i, v in enumerate(speeds, start=1)]
    assert outcome._steps_to_goal(judged) == reached
