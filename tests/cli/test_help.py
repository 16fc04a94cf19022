"""`--help` prints one screen, at once, with flags that the command has."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

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
    assert main(words) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", [*LEAVES, *WRITTEN, *GROUPS])
def test_help_is_one_screen_and_comes_at_once(command):
    began = time.monotonic()
    ended = subprocess.run(
        [sys.executable, "-c", WATCHED, *command.split(), "--help"],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "80"},
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert 3 < len(ended.stdout.splitlines()) <= 60
    # Half a second on an idle machine; importing JAX and MuJoCo takes three. The tests
    # share the processors.
    assert time.monotonic() - began < 10


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
def test_a_script_is_called_as_it_was_typed(script):
    said = subprocess.run(
        [sys.executable, ROOT / script, "--help"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert said.startswith(f"usage: python {script} [")
    assert "{prog}" not in said
