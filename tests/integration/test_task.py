"""A task as its page has it: trained, stopped, resumed, judged, evaluated, exported,
rehearsed and studied, word by word."""

import contextlib
import io
import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from aim_run import SMALL
from refusals import is_told, python

from bp2_rl.cli.__main__ import main

PAGE = Path(__file__).parents[2] / "docs/howto/write_a_reward_term.md"
TEXT = PAGE.read_text(encoding="utf-8")
TRAIN, RELAXED, EVAL, EXPORT, _, STUDY = [
    shlex.split(line)[1:]
    for block in re.findall(r"```bash\n(.*?)```", TEXT, re.DOTALL)
    for line in block.splitlines()
]
SHORT = [*SMALL, "--impl", "kernel", "--run.steps", "1920", "--run.checkpoints", "4"]
FIRST = [*TRAIN, *SHORT, "--run.judged", "1"]


def bp2(folder, *words):
    """Run `bp2` in a folder; return its output, or a mistake in one line."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        status = main([*map(str, words)])
    errors = err.getvalue()
    assert status == 0 or (status == 2 and is_told(errors)), errors
    return errors or out.getvalue()


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Return a folder with the page's file, and a run on it, which was judged."""
    folder = tmp_path_factory.mktemp("task")
    [text] = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    (folder / "helper.py").write_text("SHARP = 20.0\n")
    text = text.replace("20.0", "SHARP")
    (folder / "my_task.py").write_text(f"from helper import SHARP\n{text}")
    assert "judged: " in bp2(folder, *FIRST)
    return folder


def newest(run, what):
    """Return the newest checkpoint or policy of a run."""
    return max((run / what).iterdir(), key=lambda folder: int(folder.name))


def test_a_stopped_run_resumes_exactly_and_notices_a_changed_task(here):
    """The run stopped before its last save."""
    run, resume = here / "runs/stopped", ("train", "--resume", "runs/stopped")
    shutil.copytree(here / "runs/mine", run)
    for what in ("checkpoints", "policies"):
        shutil.rmtree(newest(run, what))
    (here / "my_task.py").rename(here / "moved.py")  # the run has its own
    (run / "task/helper.py").write_text("SHARP = 21.0\n")
    assert "my_task.py is not as in training" in bp2(here, *resume)
    (run / "task/helper.py").write_text("SHARP = 20.0\n")
    copy = (run / "task/my_task.py").rename(run / "task/moved.py")
    assert "task/my_task.py cannot be read" in bp2(here, *resume)
    copy.rename(run / "task/my_task.py")
    bp2(here, *resume)
    (here / "moved.py").rename(here / "my_task.py")
    ours, theirs = (
        newest(here / "runs" / name, "policies") for name in ("stopped", "mine")
    )
    assert ours.name == theirs.name
    weights = "weights.npz"
    assert (ours / weights).read_bytes() == (theirs / weights).read_bytes()


def test_the_relaxed_stage_takes_its_parents_task(here):
    bp2(here, *RELAXED, *SHORT)
    config = json.loads((here / "runs/mine-relaxed/config.json").read_text())
    assert config["env"]["task"]["rewards"] == [["level_trunk", 0.05]]
    wrong = (
        "--preset",
        "smoke",
        "--task",
        "my_task.py",
        "--task.reward.levl-trunk",
        "1",
    )
    assert "--task.reward.level-trunk" in bp2(here, "train", *wrong)


def test_a_policy_runs_no_code_that_nobody_names(here):
    told = bp2(here, "eval", "runs/mine", "--no-video")
    assert "the policy sees lean, which its task my_task.py:TASK computes" in told
    assert "bundle does not make" in bp2(here, *EXPORT[:-2])
    bp2(here, *EVAL, "--hold", "0.1", "--out", "report")
    assert json.loads((here / "report/metrics.json").read_text())


def test_the_bundle_computes_the_entry_on_board(here):
    assert "cpp/ refuses" in bp2(here, *EXPORT)
    _, printed, errors = python(here / "my_robot", "-m", "onboard.rehearse")
    assert "ticks" in printed, errors  # it has learnt too little to stay upright


def test_a_study_measures_its_task_and_notices_a_change(here):
    """Both of its trainings are there already."""
    for run, stage in (("mine", "imitation"), ("mine-relaxed", "relaxed")):
        shutil.copytree(here / "runs" / run, here / f"study/my_task-0-{stage}")
    few = ["--variants", "my_task.py", "--seeds", "0", "--out", "study"]
    assert "\n| my_task.py | 0 |" in bp2(here, *STUDY, *few)
    (here / "helper.py").write_text("SHARP = 21.0\n")
    assert "runs of my_task.py with another sha256" in bp2(here, *STUDY, *few)
