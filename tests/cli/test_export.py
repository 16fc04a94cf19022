"""`bp2 export` as a user meets it: what it writes, and how it refuses."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from synthetic import make_card

from bp2_rl.cli import eval as eval_command
from bp2_rl.cli import export as command
from bp2_rl.env.observations import LAYOUT
from bp2_rl.evaluation.benchmarks.conditions import speed_to_command
from bp2_rl.learning.policy import Policy, load_policy, save_policy

SIZE = sum(size for _, size in LAYOUT)


def standing_policy(seed: int = 0) -> Policy:
    """Return a policy that keeps to the standing pose, whose random hidden weights have
    no effect."""
    kernel = np.random.default_rng(seed).normal(size=(SIZE, 4)).astype(np.float32)
    card = make_card(seed=seed, results={"curriculum_level": 0.5, "top_speed": 99.0})
    zeros = np.zeros((4, 12), np.float32), np.zeros(12, np.float32)
    return Policy(
        card=card,
        mean=np.zeros(SIZE, np.float32),
        std=np.ones(SIZE, np.float32),
        layers=((kernel, np.zeros(4, np.float32)), zeros),
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A folder with a run that has exported a policy, and eval.py's report of it."""
    folder = tmp_path_factory.mktemp("measured")
    save_policy(folder / "run" / "policies" / "64", standing_policy())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUJOCO_GL", "")
        # s: it stands anyway
        patch.setattr("bp2_rl.evaluation.benchmarks.run.TIME_LIMIT", 1.5)
        # drawing takes longest
        patch.setattr("bp2_rl.evaluation.report.page._saved", lambda *_, **__: b"")
        for flags in (
            ["--hold", "1.2", "--out", str(folder / "report")],
            ["--benchmark", "sprint", "--out", str(folder / "race")],
        ):
            assert (
                eval_command.main(
                    [str(folder / "run"), "--speed", "0.3", "--no-video", *flags]
                )
                == 0
            )
    return folder


@pytest.fixture(autouse=True)
def here(measured, tmp_path, monkeypatch):
    """A working directory with a run and a report of it, to be spoilt."""
    shutil.copytree(measured, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "")  # the command takes it away
    return tmp_path


# --- Done -----------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["run", "run/policies/64"])
def test_the_copy_is_the_runs_policy(capsys, source):
    assert command.main([source, "--to", "kept/policy"]) == 0
    assert capsys.readouterr().out == f"exported {source} to kept/policy\n"
    for name in ("card.json", "weights.npz"):
        written = Path("run/policies/64", name).read_bytes()
        assert Path("kept/policy", name).read_bytes() == written


def test_the_card_says_what_the_report_says():
    assert command.main(["run", "--to", "kept", "--report", "report"]) == 0
    results = load_policy("kept").card.results
    said = results["topspeed"]
    report = json.loads(Path("report/metrics.json").read_text())
    found = report["metrics"]
    assert results["curriculum_level"] == 0.5  # what the training wrote stays
    assert said["schedule"] == report["conditions"]["schedule"]
    known = {"commanded_speed": 0.3, "fell_at": None, "outside_envelope": 0}
    assert known.items() <= said.items()
    for name in set(said) & set(found):
        # The card rounds to four digits. A robot that stands has no cost of transport:
        # None is None.
        assert said[name] == (
            None if found[name] is None else pytest.approx(found[name], rel=1e-3)
        ), name
    assert {"best_speed", "hold_time", "peak_spring_travel"} <= set(said) & set(found)
    assert said["peak_motor_power"] == pytest.approx(
        max(m["peak_power"] for m in found["motors"]), rel=1e-3
    )
    flat = (str, int, float, type(None))
    assert all(isinstance(value, flat) for value in said.values())


@pytest.mark.parametrize("at_once", [True, False])
def test_the_card_says_what_several_reports_say(at_once):
    first, second = ["--report", "report"], ["--report", "race"]
    if at_once:
        assert command.main(["run", "--to", "kept", *first, *second]) == 0
    else:
        assert command.main(["run", "--to", "kept", *first]) == 0
        assert command.main(["kept", "--to", "kept", *second]) == 0
    policy = load_policy("kept")
    results = policy.card.results
    assert set(results) == {"curriculum_level", "top_speed", "topspeed", "sprint"}
    assert results["topspeed"]["commanded_speed"] == 0.3
    assert results["sprint"]["sprint_acceleration"] == 3.0
    assert results["sprint"]["time_100m"] is None  # it stands
    assert speed_to_command(policy) == 0.3  # by default it is measured as it was


# --- Wrong input ----------------------------------------------------------------------


def test_the_copys_launches_and_stops_can_be_eased(capsys):
    law = {
        "braking": 4.0,
        "stopping_time": 0.9,
        "launching": 6.0,
        "launching_speed": 18.0,
    }
    flags = [f"--{name.replace('_', '-')}={value}" for name, value in law.items()]
    assert command.main(["run", "--to", "kept", "--report", "report"]) == 0
    assert command.main(["kept", "--to", "copy", *flags]) == 0
    assert "python eval.py copy --benchmark all" in capsys.readouterr().out
    assert load_policy(Path("kept")).card.results
    assert load_policy(Path("copy")).card.results == {}
    ours, copy = load_policy(Path("run")).card, load_policy(Path("copy")).card
    control = dataclasses.replace(ours.env.control, **law)
    assert copy.env == dataclasses.replace(ours.env, control=control)
    assert copy.weights_sha256 == ours.weights_sha256


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "RUN_OR_POLICY"),
        (["run"], "--to"),
        (["run", "--to", "kept", "--speed", "3"], "--speed"),
        (["run", "--to", "kept", "--braking", "0"], "control.braking"),
        (["run", "--to", "kept", "--stopping-time", "-1"], "control.stopping_time"),
        (["gone", "--to", "kept"], "no policy at gone"),
        (["report", "--to", "kept"], "no policy in report"),
        (["run/policies/64/card.json", "--to", "kept"], "is a file"),
        (
            ["run", "--to", "kept", "--report", "gone"],
            "no report in gone: expected metrics.json",
        ),
        (["run", "--to", "kept", "--report", "run"], "no report in run"),
        (["run", "--to", "report"], "holds files that are no policy's"),
        (
            ["run", "--to", "kept", "--report", "report", "--braking", "4"],
            "--report was measured without --braking",
        ),
        (["run", "--to", "run"], "holds files that are no policy's"),
        (["run", "--to", "report/speed.png"], "cannot write policy report/speed.png"),
        (
            ["run", "--to", "report/speed.png/kept"],
            "cannot write policy report/speed.png/kept",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_a_mistake_is_told(capsys, arguments, words):
    assert words in refused(capsys, command.main, *arguments)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "damaged or not JSON"),
        ("[1, 2]", "takes an object"),
        ('{"loss": 3}', "loss: unknown key"),
        (
            '{"benchmark": "topspeed", "conditions": {}, "metrics": {"best_speed": 1.0}}',
            "results: missing",
        ),
    ],
)
def test_a_report_of_another_shape_is_refused(capsys, content, words):
    Path("report/metrics.json").write_text(content)
    message = refused(capsys, command.main, "run", "--to", "kept", "--report", "report")
    assert words in message
    assert "report/metrics.json" in message


def test_a_report_of_another_policy_or_of_none_is_refused(capsys):
    save_policy(Path("other"), standing_policy(seed=1))
    message = refused(
        capsys, command.main, "other", "--to", "kept", "--report", "report"
    )
    assert "report report is of another policy" in message
    for name in ("run", "other"):
        assert load_policy(name).card.weights_sha256[:12] in message
    path = Path("report/metrics.json")
    report = json.loads(path.read_text())
    del report["conditions"]["weights_sha256"]
    path.write_text(json.dumps(report))
    message = refused(capsys, command.main, "run", "--to", "kept", "--report", "report")
    assert "weights are unknown" in message


def test_a_damaged_policy_is_not_passed_on(capsys):
    weights = Path("run/policies/64/weights.npz")
    weights.write_bytes(weights.read_bytes()[:-50])
    assert "weights.npz is truncated" in refused(
        capsys, command.main, "run", "--to", "kept"
    )
