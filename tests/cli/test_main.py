import ast
import subprocess
import sys
import types
from pathlib import Path

import pytest

import bp2_rl
from bp2_rl.cli.__main__ import COMMANDS, main

PLUGS = ("gymnasium", "mujoco_playground", "optuna", "submitit", "wandb")
"""Packages of others, which only those who ask for them wait for."""
PLUG_MODULES = tuple(
    f"bp2_rl.{name}" for name in ("peers.gymnasium_env", "peers.gymnasium_vector")
)


def test_a_command_gets_the_rest_of_the_line_and_its_status_is_ours(
    monkeypatch: pytest.MonkeyPatch,
):
    seen = []
    command = types.SimpleNamespace(main=lambda argv: seen.append(argv) or 2)
    monkeypatch.setitem(sys.modules, "bp2_rl.cli.train", command)
    assert main(["train", "--stage", "relaxed"]) == 2
    assert seen == [["--stage", "relaxed"]]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]):
    assert main([name, "--help"]) == 0
    assert "usage" in capsys.readouterr().out.lower()


def test_no_command_shows_the_usage(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 2
    assert capsys.readouterr().err.startswith("usage: bp2 COMMAND")


def test_an_unknown_command_is_one_line_and_status_2(
    capsys: pytest.CaptureFixture[str],
):
    assert main(["fly"]) == 2
    assert (
        capsys.readouterr().err
        == f"error: no command 'fly'; bp2 has: {', '.join(COMMANDS)}\n"
    )


def test_a_mistyped_command_is_answered_with_the_one_that_was_meant(
    capsys: pytest.CaptureFixture[str],
):
    assert main(["tarin"]) == 2
    assert capsys.readouterr().err == "error: no command 'tarin': did you mean train?\n"


def test_help_imports_nothing_slow():
    program = (
        "import sys; from bp2_rl.cli.__main__ import main; status = main(['--help']); "
        f"assert not {{'jax', 'numpy', 'mujoco', 'tyro', *{PLUGS}}} & set(sys.modules); sys.exit(status)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert all(name in shown.stdout for name in COMMANDS)


@pytest.mark.parametrize(
    "words",
    [
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
        "trajopt solve --speed 0",
        "paper figures torque --length 0",
        "paper figures scaling --nope",
        "paper figures speed",
        "play --port 0",
        "play --speed fast",
        "robot check nobody",
        "robot new robot.xml --foot-radius 0",
    ],
)
def test_a_mistake_is_answered_before_anything_slow_is_imported(words: str):
    program = (
        f"import sys; from bp2_rl.cli.__main__ import main; status = main({words.split()}); "
        "print(sorted({'jax', 'brax', 'mujoco', 'casadi', 'matplotlib'} & set(sys.modules))); sys.exit(status)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stdout) == (2, "[]\n"), ended.stderr


def test_no_package_of_others_is_imported_unless_it_is_asked_for():
    """Only where it is used: within a function, or in a module that only such functions
    import."""
    root, found = Path(bp2_rl.__file__).parent, set()
    for path in root.rglob("*.py"):
        for statement in ast.parse(path.read_text()).body:
            names = (
                [alias.name for alias in statement.names]
                if isinstance(statement, ast.Import)
                else []
            )
            names += (
                [statement.module or ""]
                if isinstance(statement, ast.ImportFrom)
                else []
            )
            plugs = {
                name
                for name in names
                if name.split(".")[0] in PLUGS or name in PLUG_MODULES
            }
            found |= {
                (
                    ".".join(("bp2_rl", *path.relative_to(root).with_suffix("").parts)),
                    name,
                )
                for name in plugs
            }
    assert {module for module, _ in found} <= set(PLUG_MODULES), found


def test_the_package_runs_as_a_module():
    ended = subprocess.run(
        [sys.executable, "-m", "bp2_rl", "fly"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert "no command 'fly'" in ended.stderr


def test_the_version_is_the_packages(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"bp2_rl {bp2_rl.__version__}\n"


@pytest.mark.parametrize("script", ["train.py", "eval.py"])
def test_a_python_without_our_packages_is_told_to_activate_the_environment(script):
    path = Path(bp2_rl.__file__).parents[1] / script
    ended = subprocess.run(
        [sys.executable, "-S", "-E", path, "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: this Python lacks ")
    assert ended.stderr.count("\n") == 1
