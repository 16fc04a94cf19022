"""`python eval.py` as a user meets it: what it prints, what it leaves, how it ends."""

import dataclasses
import json
import os
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from bp2_rl.cli import eval as command
from bp2_rl.env.observations import LAYOUT
from bp2_rl.evaluation.benchmarks.registry import BENCHMARKS
from bp2_rl.evaluation.benchmarks.run import topspeed
from bp2_rl.learning.policy import make_policy, save_policy

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def export(make_card):
    """Write a policy that outputs zeros around the standing pose, so that the robot
    stands."""

    def export(folder, layout=LAYOUT, **results):
        size = sum(n for _, n in layout)
        layers = [(np.zeros((size, 4)), np.zeros(4)), (np.zeros((4, 12)), np.zeros(12))]
        card = make_card(
            results=results,
            observation_layout=tuple(layout),
        )
        normalizer = types.SimpleNamespace(mean=np.zeros(size), std=np.ones(size))
        save_policy(folder, make_policy(layers, normalizer, card))

    return export


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Set an empty working directory, with the process's JAX and MuJoCo left as the
    tests have them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "")
    return tmp_path


@pytest.fixture
def policy(here, export):
    export(here / "policy", topspeed={"best_speed": 0.5})
    return here / "policy"


def run(capsys, *arguments):
    """Run the command; return exit status, standard output and standard error."""
    status = command.main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return status, out, err


def assert_refused(capsys, arguments, *words):
    """Require that the command refuses the arguments in a message with the words."""
    error = refused(capsys, command.main, *arguments)
    assert [word for word in words if word not in error] == []


# --- Done -----------------------------------------------------------------------------


def test_eval_leaves_a_table_and_a_report(policy, capsys):
    status, out, err = run(capsys, policy, "--hold", 1.2, "--no-video")
    assert status == 0
    assert err == ""
    assert "Best speed" in out
    assert "command 0.5 m/s" in out.replace("\n", "")
    (folder,) = Path("reports").iterdir()
    assert folder.name.startswith("topspeed-")
    assert str(folder / "index.html") in out.replace("\n", "")
    data = json.loads((folder / "metrics.json").read_text())
    assert data["metrics"]["commanded_speed"] == pytest.approx(0.5)  # from the card
    assert data["metrics"]["outside_envelope"] == 0
    assert "0.5 m/s at 2.4 m/s" in data["conditions"]["schedule"]
    assert "heading" in data["conditions"]["operator"]


def test_all_leaves_a_report_of_each_and_a_page_that_leads_to_them(
    policy, capsys, monkeypatch
):
    def again(*arguments):
        return dataclasses.replace(
            topspeed(*arguments), benchmark="again", verdict="Once more."
        )

    of_topspeed = BENCHMARKS["topspeed"]
    benchmarks = {
        "topspeed": of_topspeed,
        "again": dataclasses.replace(of_topspeed, run=again),
    }
    monkeypatch.setattr("bp2_rl.evaluation.benchmarks.registry.BENCHMARKS", benchmarks)
    # drawing takes longest
    monkeypatch.setattr("bp2_rl.evaluation.report.page._saved", lambda *_, **__: b"")
    flags = ["--benchmark", "all", "--hold", 0.2, "--out", "report", "--no-video"]
    out = ""
    for _ in range(2):  # the second replaces the first
        status, out, err = run(capsys, policy, *flags)
        assert (status, err) == (0, "")
    assert out.count("Once more.") == 2  # below its table, and in the last one
    assert [
        path.parent.name for path in sorted(Path("report").glob("*/index.html"))
    ] == ["again", "topspeed"]
    data = json.loads(Path("report/metrics.json").read_text())
    assert data["benchmark"] == "all"
    assert data["results"]["again"] == data["results"]["topspeed"]
    assert data["results"]["topspeed"]["commanded_speed"] == 0.5


def test_eval_script_runs_by_itself_from_anywhere(policy, here):
    flags = [
        policy,
        "--speed",
        "0.3",
        "--hold",
        "0.5",
        "--out",
        "a/report",
        "--no-video",
    ]
    done = subprocess.run(
        [sys.executable, REPOSITORY / "eval.py", *flags],
        capture_output=True,
        text=True,
        cwd=here,
        # a broken choice of renderer is no reason not to measure
        env=os.environ | {"MUJOCO_GL": "none-such"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "Best speed" in done.stdout
    data = json.loads((here / "a" / "report" / "metrics.json").read_text())
    assert data["metrics"]["commanded_speed"] == pytest.approx(0.3)


# --- Wrong input ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--benchmark", "dash"], ("--benchmark", "topspeed", "'dash'")),
        (
            ["--benchmark", "sprint", "--hold", "3"],
            ("--hold does not apply to --benchmark sprint", "--acceleration"),
        ),
        (
            ["--benchmark", "sprint", "--speed", "3", "--acceleration", "0.06"],
            ("--acceleration 0.06", "30 s"),
        ),
        (
            ["--benchmark", "convergence", "--backend", "drake"],
            ("--backend does not apply to --benchmark convergence",),
        ),
        (
            ["--benchmark", "topspeed", "--robots", "posterior"],
            ("--robots", "posterior"),
        ),
        (["--robots", "3"], ("--robots does not apply to --benchmark topspeed",)),
        (["--benchmark", "robustness", "--robots", "0"], ("--robots", "0")),
        (["--acceleration", "0"], ("--acceleration", "0")),
        (["--operator.limit", "-1"], ("--operator.limit", "-1")),
        (
            ["--backend", "bullet"],
            ("'bullet'",),
        ),
        (["--speed", "-3"], ("--speed", "-3")),
        (["--speed", "0"], ("--speed", "0")),
        (["--speed", "nan"], ("--speed", "nan")),
        (["--speed", "fast"], ("--speed", "fast")),
        (["--hold", "-1"], ("--hold", "-1")),
        (["--hold", "inf"], ("--hold", "inf")),
        (["--hold", "1e-12"], ("--hold must be from 0.1",)),
        (["--spede", "3"], ("--spede", "--speed")),
        (["--speed"], ("--speed",)),
        (["again"], ("again",)),
    ],
)
def test_wrong_flags_are_named(policy, capsys, arguments, words):
    assert_refused(capsys, [policy, *arguments], *words)


def test_where_drake_is_missing_its_installation_is_named(policy, capsys, monkeypatch):
    monkeypatch.delitem(sys.modules, "bp2_rl.simulation.drake", raising=False)
    monkeypatch.setitem(sys.modules, "pydrake", None)
    for name in [name for name in sys.modules if name.startswith("pydrake.")]:
        monkeypatch.delitem(sys.modules, name)
    assert_refused(capsys, [policy, "--backend", "drake"], '-e ".[drake]"')


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["gone"], "no policy at gone"),
        (["gone/deeper"], "no policy at gone/deeper"),
        (["notes.txt"], "notes.txt is a file"),
        (["policy", "--out", "notes.txt/report"], "cannot write to notes.txt/report"),
        (["policy", "--out", "policy"], "holds other files"),
    ],
)
def test_what_is_not_there_or_something_else_is_refused(
    policy, here, capsys, arguments, word
):
    (here / "notes.txt").write_text("hello")
    assert_refused(capsys, arguments, word)


def test_a_truncated_policy(policy, capsys):
    weights = policy / "weights.npz"
    weights.write_bytes(weights.read_bytes()[:-50])
    assert_refused(capsys, [policy], "weights.npz", "checksum")


def test_a_policy_with_another_observation(here, export, capsys):
    export(here / "blind", layout=[entry for entry in LAYOUT if entry[0] != "phase"])
    assert_refused(capsys, ["blind"], "other observations", "'phase'")


# --- Failure --------------------------------------------------------------------------


def test_a_failure_names_its_log_and_shows_no_traceback(
    policy, capsys, monkeypatch, tmp_path
):
    def fail(*_, **__):
        raise RuntimeError("the solver\nexploded")

    monkeypatch.setattr("bp2_rl.evaluation.report.folder.write_report", fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    status, _, err = run(capsys, policy, "--hold", 0.5, "--no-video")
    assert status == 1
    assert err.startswith("failed: RuntimeError: the solver exploded; log: ")
    assert err.count("\n") == 1
    log = Path(err.split("log: ")[1].strip()).read_text()
    assert "Traceback" in log
    assert "the solver\nexploded" in log
