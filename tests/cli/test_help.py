"""`--help` prints one screen, at once, with flags that the command has; mistakes are
answered at once, too."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import is_told, python

from bp2_rl.cli.__main__ import main
from bp2_rl.settings.presets import preset

ROOT = Path(__file__).parents[2]
LEAVES = (
    "play",
    "export",
    "robot new",
    "robot check",
    "trajopt verify",
    "paper figures race",
    "paper figures --all",
    "paper figures exchange",
    "paper scaling",
)
WRITTEN = (
    "train",
    "eval",
    "study",
    "bench",
    "trajopt solve",
    "trajopt library build",
    "paper eval",
    "paper trajectories limits",
    "paper trajectories codesign",
)
"""Commands whose first screen is written by hand, as tyro's help is longer."""
GROUPS = ("trajopt", "paper", "paper figures", "paper trajectories")
MISTAKES = (
    "train --track neptune",
    "train --nope",
    "train --ppo.clipping nan",
    "train --preset cpu --run.seed x",
    "bench --seconds 0",
    "study --judges 0",
    "eval --speed fast",
    "eval --speed 1e308",
    "eval --hold 1e6",
    "eval nowhere",
    "play nowhere --web",
    "export nowhere --to here",
    "train --resume nowhere",
    "train --resume nowhere --preset smoke",
    "export --nope",
    "trajopt solve --fly",
    "trajopt verify --fly",
    "trajopt library --fly",
    "paper figures torque --length 0",
    "paper figures scaling --nope",
    "paper figures speed",
    "play --port 0",
    "play --speed fast",
    "robot check nobody",
    "robot new robot.xml --foot-radius 0",
)
HELP = tuple(f"{command} --help" for command in (*LEAVES, *WRITTEN, *GROUPS))
ANSWERING = """
import contextlib, io, json, sys, time
from bp2_rl.cli.__main__ import main
answers = {}
for line in json.load(sys.stdin):
    began, out = time.monotonic(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()) as err:
        status = main(line.split())
    slow = {"jax", "brax", "mujoco", "casadi", "scipy", "matplotlib"} & set(sys.modules)
    answers[line] = status, out.getvalue(), err.getvalue(), sorted(slow), time.monotonic() - began
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def answers():
    """Return the answers to all these command lines, given in one process: status,
    output, errors, slow modules imported by then, and seconds."""
    ended = subprocess.run(
        [sys.executable, "-c", ANSWERING],
        input=json.dumps([*HELP, *MISTAKES]),
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"COLUMNS": "80"},
    )
    return json.loads(ended.stdout)


@pytest.mark.parametrize("line", HELP)
def test_help_is_one_screen_and_comes_at_once(line, answers):
    status, out, err, slow, seconds = answers[line]
    assert (status, err, slow) == (0, "", [])
    assert 3 < len(out.splitlines()) <= 60
    # A tenth of it on an idle machine; the tests share the processors.
    assert seconds < 5


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_answered_before_anything_slow_is_imported(line, answers):
    status, out, err, slow, _ = answers[line]
    assert (status, out, slow) == (2, "", []), err
    assert is_told(err)


def shown(capsys, *words: str) -> str:
    assert main(words) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", WRITTEN)
def test_the_first_screen_names_flags_that_there_are(command, capsys):
    """It is written by hand, and the whole help by tyro; each choice is one of tyro's
    choices, too."""
    first = shown(capsys, *command.split(), "--help")
    everything = shown(capsys, *command.split(), "--help-all")
    flags = set(re.findall(r"^  (--[\w.-]+)(?: (\{[\w,-]+\}))?", first, re.MULTILINE))
    for flag, choices in flags:
        known = re.search(rf"{re.escape(flag)}[ ,|\n](\{{[\w,-]+\}})?", everything)
        assert known or flag.endswith("."), flag
        if choices and known:
            assert set(choices[1:-1].split(",")) == set(
                (known[1] or "{}")[1:-1].split(",")
            ) - {"None"}, flag


def test_all_settings_are_listed_with_their_defaults(capsys):
    assert "--stage" in shown(capsys, "train", "--nope", "--preset", "huge", "--help")
    text = shown(capsys, "train", "--preset", "gpu", "--help-all")
    robots = preset("imitation", "gpu").ppo.num_envs
    assert re.search(rf"--ppo.num-envs INT\W+\(default: {robots}\)", text)
    assert re.search(r"--env.hardware.gear-ratio FLOAT\W+\(default: 8.5\)", text)
    assert "--operator.limit FLOAT" in shown(capsys, "eval", "--help-all")


@pytest.mark.parametrize("script", ["train.py", "eval.py"])
def test_a_script_is_called_as_it_was_typed_from_anywhere(script, tmp_path):
    status, said, _ = python(tmp_path, str(ROOT / script), "--help")
    assert status == 0
    assert said.startswith(f"usage: python {script} [")
    assert "{prog}" not in said
