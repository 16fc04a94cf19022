"""What `--help` prints: one screen, at once, with the flags that the command has."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.cli import train, usage
from bp2_rl.cli.__main__ import main
from bp2_rl.settings.presets import preset

ROOT = Path(__file__).parents[2]
LEAVES = (
    "train",
    "eval",
    "play",
    "study",
    "tune",
    "bench",
    "export",
    "trajopt solve",
    "trajopt verify",
    "trajopt library build",
    "paper eval",
    "paper figures race",
    "paper figures --all",
    "paper figures exchange",
    "paper trajectories limits",
    "paper trajectories codesign",
    "paper scaling",
)
GROUPS = ("trajopt", "paper", "paper figures", "paper trajectories")
WATCHED = """
import sys
from bp2_rl.cli.__main__ import main
try:
    status = main(sys.argv[1:])
except SystemExit as end:
    status = end.code
slow = {"jax", "brax", "mujoco", "casadi", "scipy", "matplotlib"} & set(sys.modules)
sys.exit(f"imports {slow}" if slow else status)
"""


def shown(capsys, *words: str) -> str:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", [*LEAVES, *GROUPS])
def test_help_is_one_screen_and_comes_at_once(command):
    began = time.monotonic()
    ended = subprocess.run(
        [sys.executable, "-c", WATCHED, *command.split(), "--help"],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "80"},
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    lines = ended.stdout.splitlines()
    assert 3 < len(lines) <= 60
    # a name of many choices is longer than the terminal is wide
    assert max(map(len, lines)) <= 90
    # Half a second on an idle machine; importing JAX and MuJoCo takes three. The tests
    # share the processors.
    assert time.monotonic() - began < 10


def test_every_everyday_flag_of_train_is_shown_and_none_of_its_own_is_left_out(capsys):
    text = shown(capsys, "train", "--help")
    for flag in (flag for flags in train.EVERYDAY.values() for flag in flags):
        assert f"--{flag}" in text.replace("[no-]", "")
    assert "--env.hardware.gear-ratio" not in text
    assert "--env.hardware.*" in text
    # flags that are not nested are all in EVERYDAY, or this would count the others
    assert "--*" not in text


def test_all_settings_are_listed_with_their_defaults(capsys):
    text = shown(capsys, "train", "--preset", "gpu", "--help-all")
    assert "those of the preset gpu" in " ".join(text.split())
    rows = " ".join(text.split())
    assert f"--ppo.num-envs INT [{preset('imitation', 'gpu').ppo.num_envs}]" in rows
    assert "--env.hardware.gear-ratio FLOAT [8.5]" in rows
    assert "--run.[no-]films" in rows
    assert "{None" not in text
    assert "[None]" not in text


def test_the_words_of_all_flags_begin_in_one_column(capsys):
    lines = shown(capsys, "train", "--help-all").splitlines()
    words = [line for line in lines if line.startswith(" " * usage.FLAGS)]
    assert len(words) > 100
    assert all(line[usage.FLAGS] != " " for line in words)


def test_a_command_that_is_short_shows_everything(capsys):
    assert shown(capsys, "play", "--help") == shown(capsys, "play", "--help-all")
    assert "--seconds FLOAT" in shown(capsys, "play", "--help")
    assert "--operator.limit FLOAT" in shown(capsys, "eval", "--help-all")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("eval", "usage: bp2 eval [POLICY_OR_RUN] [FLAGS]"),
        ("train", "usage: bp2 train [FLAGS]"),
        ("export", "usage: bp2 export RUN_OR_POLICY --to DIR [FLAGS]"),
        ("trajopt library", "usage: bp2 trajopt library build [FLAGS]"),
    ],
)
def test_the_usage_is_what_one_types_with_what_may_be_left_out_in_brackets(
    words, line, capsys
):
    assert shown(capsys, *words.split(), "--help").splitlines()[0] == line


@pytest.mark.parametrize(
    "command",
    [
        "train",
        "eval",
        "play",
        "robot new",
        "robot check",
        "study",
        "tune",
        "bench",
        "export",
    ],
)
def test_help_ends_with_examples_that_name_the_command(command, capsys):
    *_, last = shown(capsys, *command.split(), "--help").split("\n\n")
    title, *lines = last.splitlines()
    assert title == "examples:"
    assert all(
        line.startswith((f"  bp2 {command}", f"  python {command}.py"))
        for line in lines
    )


@pytest.mark.parametrize("script", ["train.py", "eval.py"])
def test_a_script_is_called_as_it_was_typed(script):
    said = subprocess.run(
        [sys.executable, ROOT / script, "--help"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert said.startswith(f"usage: python {script} [")


def test_a_flag_that_tune_does_not_find_is_answered_with_the_help_of_train(capsys):
    assert main(["tune", "--search", "ppo.lerning-rate=1:2"]) == 2
    line = "error: unknown option --ppo.lerning-rate: did you mean --ppo.learning-rate? (see bp2 train --help)\n"
    assert capsys.readouterr().err == line


def test_help_answers_before_any_mistake_on_the_line(capsys):
    assert "--stage" in shown(capsys, "train", "--nope", "--preset", "huge", "--help")


def test_a_command_line_without_help_is_parsed():
    with pytest.raises(UserError, match=r"see train\.py --help"):
        train.answer_early(["--nope"], "train.py", train.train_arguments)
