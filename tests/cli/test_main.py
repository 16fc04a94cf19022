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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "usage: bp2 COMMAND"),
        (["fly"], f"error: no command 'fly'; bp2 has: {', '.join(COMMANDS)}\n"),
        (["tarin"], "error: no command 'tarin': did you mean train?\n"),
    ],
)
def test_no_command_or_an_unknown_one_is_answered_with_status_2(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
):
    assert main(words) == 2
    assert capsys.readouterr().err.startswith(said)


def test_help_imports_nothing_slow():
    program = (
        "import sys; from bp2_rl.cli.__main__ import main; status = main(['--help']); "
        f"assert not {{'jax', 'numpy', 'mujoco', 'tyro', *{PLUGS}}} & set(sys.modules); sys.exit(status)"
    )
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert all(name in shown.stdout for name in COMMANDS)


def test_no_package_of_others_is_imported_unless_it_is_asked_for():
    """Only where it is used: within a function, or in a module that only such functions
    import."""
    root, found = Path(bp2_rl.__file__).parent, set()
    for path in root.rglob("*.py"):
        module = ".".join(("bp2_rl", *path.relative_to(root).with_suffix("").parts))
        for statement in ast.parse(path.read_text()).body:
            names: list[str] = []
            if isinstance(statement, ast.Import):
                names = [alias.name for alias in statement.names]
            if isinstance(statement, ast.ImportFrom):
                names = [statement.module or ""]
            if any(n.split(".")[0] in PLUGS or n in PLUG_MODULES for n in names):
                found.add(module)
    assert found <= set(PLUG_MODULES)


def test_the_package_tells_its_version(capsys: pytest.CaptureFixture[str]):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"bp2_rl {bp2_rl.__version__}\n"


@pytest.mark.parametrize(
    "words", [["train.py"], ["eval.py"], ["-m", "bp2_rl", "robot", "check"]]
)
def test_a_python_without_our_packages_is_told_to_activate_the_environment(words):
    ended = subprocess.run(
        [sys.executable, "-S", "-E", *words, "--help"],
        cwd=Path(bp2_rl.__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: this Python lacks ")
    assert ended.stderr.count("\n") == 1
