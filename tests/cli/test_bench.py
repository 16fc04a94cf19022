"""`bp2 bench` as a user meets it, on an environment that compiles at once."""

import json
import re
import sys
from pathlib import Path

import jax
import pytest
from aim import Aim
from refusals import is_told
from rich.console import Console

from bp2_rl.base.serialization import load_config
from bp2_rl.cli import app, train
from bp2_rl.cli import bench as command
from bp2_rl.settings.training import TrainConfig
from bp2_rl.tools import bench as measuring
from bp2_rl.tools.bench import Bench, BenchRequest
from bp2_rl.tools.playground import PlaygroundRate
from bp2_rl.tools.throughput import OUT_OF_MEMORY, Case, PartTiming

SMALL = [
    "--preset",
    "smoke",
    "--ppo.num-envs",
    "16",
    "--ppo.unroll-length",
    "5",
    "--ppo.num-minibatches",
    "2",
    "--ppo.episode-length",
    "20",
    "--ppo.policy-layers",
    "16",
    "--ppo.value-layers",
    "16",
    "--seconds",
    "0.02",
]
"""Those of `aim.TINY`: what other tests compile of it is found in the cache."""


@pytest.fixture(autouse=True)
def aim(monkeypatch):
    monkeypatch.setattr(measuring, "make_env", lambda config, robots: Aim())


def read(*words: str) -> command.BenchArguments:
    flags = app.parse_known(train.EarlyFlags, words, "bp2 bench")
    return command.read_arguments(list(words), flags)


@pytest.mark.parametrize("preset", ["smoke", "cpu"])
def test_it_measures_what_train_runs(preset):
    bench = read("--preset", preset)
    training = train.read_arguments(["--preset", preset])
    assert (bench.impl, bench.env, bench.ppo) == (
        training.impl,
        training.env,
        training.ppo,
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One run with nearly everything: (folder, what it printed)."""
    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "make_env", lambda config, robots: Aim())
        patch.setattr(command, "FIRST_STEP", STARTS)
        argv = [
            *SMALL,
            "--peer",
            "brax",
            "--startup",
            "--out",
            str(folder / "out"),
        ]
        console = Console(record=True, width=80)
        patch.setattr(measuring, "Console", lambda: console)
        assert command.main(argv) == 0
    return folder, console.export_text()


STARTS = """
import json, os, pathlib, sys, time
assert sys.argv[1:3] == ["--preset", "smoke"]
cache = pathlib.Path(os.environ["BP2_CACHE"]) / "compiled"
known = cache.exists()
cache.touch()
now = time.time()
print("chatter")
step = now + (2 if known else 60)
print(json.dumps({"imported": now, "traced": now, "compiled": now + 1, "first_step": step, "first_policy": step}))
"""
"""A start that takes a minute, but for what is in the cache."""


def test_the_report_holds_every_number(whole):
    report = load_config(Bench, whole[0] / "out" / "bench.json")
    (case,) = report.cases
    assert [m.part for m in case.measurements] == [
        "environment",
        "resets",
        "policy",
        "sgd",
        "training",
    ]
    assert case.error is None
    assert sum(case.shares.values()) == pytest.approx(1.0)
    for m in case.measurements:
        assert m.control_steps_per_second == pytest.approx(16 * 5 / m.seconds)
        assert (m.robots, m.devices, m.compilations) == (16, jax.device_count(), 0)
    assert report.config.ppo.num_envs == 16
    assert report.versions["jax"] == jax.__version__
    assert (report.platform, report.device_count) == ("cpu", jax.device_count())
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", report.created)


def test_the_peer_runs_beside_the_learner(whole):
    report = load_config(Bench, whole[0] / "out" / "bench.json")
    assert report.peer is not None
    assert [m.part for m in report.peer.measurements] == ["acting", "brax"]
    assert {(m.robots, m.devices) for m in report.peer.measurements} == {(16, 1)}
    ours, theirs = (m.control_steps_per_second for m in report.peer.measurements)
    assert f"acts {ours / theirs:.2f} times as fast as stock Brax" in whole[1]


@pytest.mark.parametrize(
    ("argv", "measured"),
    [
        # of these the first is compared
        (["--robots", "16", "32", "--parts", "training"], [16, 32]),
        # training is measured, though not asked for
        (["--robots", "16", "--parts", "resets"], [16, 16]),
        (["--parts", "resets"], [16, 16]),
    ],
)
def test_playground_is_compared_with_a_training_of_as_many_robots_on_one_device(
    argv, measured, tmp_path, monkeypatch, capsys
):
    asked, rows = [], []

    def theirs(settings, seconds):
        asked.append((settings["num_envs"], seconds))
        return PlaygroundRate("jax", settings["num_envs"], 0.02, 12_800, 50.0)

    def ours(request, size, parts, console):
        rows.append(size[0])
        robots, devices = size
        rate = 10.0 * robots
        timed = PartTiming(
            parts[0],
            robots,
            devices,
            rate,
            rate,
            1.0,
            1.0,
            0.0,
            3,
            0,
            1.0,
            1.0,
            False,
            None,
        )
        return Case(robots, devices, (timed,))

    monkeypatch.setattr(
        measuring, "playground_settings", lambda robots: {"num_envs": robots or 16}
    )
    monkeypatch.setattr(measuring, "measure_playground", theirs)
    monkeypatch.setattr(measuring, "_measure", ours)
    assert (
        command.main([*SMALL, "--peer", "playground", *argv, "--out", str(tmp_path)])
        == 0
    )
    assert asked == [(16, 0.02)]
    assert rows == measured
    report = load_config(Bench, tmp_path / "bench.json")
    assert report.peer is not None
    assert (report.peer.robots, report.peer.devices, report.peer.rate("training")) == (
        16,
        1,
        160.0,
    )
    assert (
        "50 control steps/s of 20 ms; ours, 16 robots, make 3.20 times as many, of 5 ms"
        in capsys.readouterr().out
    )


def test_without_playground_a_bench_is_one_line_and_status_2(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "mujoco_playground.config.locomotion_params", None)
    assert command.main([*SMALL, "--peer", "playground", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: --peer playground needs the package playground")
    assert error.count("\n") == 1


def test_the_second_start_finds_what_the_first_compiled(whole):
    report = load_config(Bench, whole[0] / "out" / "bench.json")
    assert report.cold_start is not None
    assert report.warm_start is not None
    # from before the process began: Python takes its time
    assert 0 < report.cold_start.imported < 5
    assert report.cold_start.first_step == pytest.approx(
        report.cold_start.imported + 60
    )
    assert report.warm_start.first_step == pytest.approx(report.warm_start.imported + 2)


def test_rows_come_as_they_are_measured_and_the_table_last(whole):
    text = whole[1]
    for part in ("environment", "resets", "policy", "sgd", "training"):
        assert re.search(rf"^{part}, 16 robots", text, re.MULTILINE)
    assert text.index("training, 16 robots") < text.index("control/s")


def test_a_size_that_does_not_fit_leaves_the_others(tmp_path, capsys):
    argv = [*SMALL, "--robots", "15", "16", "--parts", "resets", "--out", str(tmp_path)]
    assert command.main(argv) == 0
    failed, measured = json.loads((tmp_path / "bench.json").read_text())["cases"]
    assert "num_minibatches" in failed["error"]
    assert measured["error"] is None
    assert measured["measurements"][0]["robots"] == 16
    assert (
        "15 robots on 1 device: ppo.num_envs (15) must be a multiple"
        in capsys.readouterr().out
    )


def test_each_number_of_robots_is_measured_on_each_number_of_devices(monkeypatch):
    monkeypatch.setattr(jax, "device_count", lambda: 6)
    arguments = read("--preset", "gpu", "--robots", "64", "128", "64")
    assert command.choose_sizes(arguments) == ((64, 6), (128, 6))
    arguments = read("--preset", "gpu", "--devices", "1", "2")
    assert command.choose_sizes(arguments) == ((8192, 1), (8192, 2))


def test_sizes_above_one_that_ran_out_of_memory_are_not_tried(monkeypatch):
    tried = []

    def measure(request, size, parts, console):
        tried.append(size)
        error = (
            OUT_OF_MEMORY
            if size[0] / size[1] > 32
            else "an odd number"
            if size[0] % 2
            else None
        )
        return Case(*size, error=error)

    monkeypatch.setattr(measuring, "_measure", measure)
    sizes = ((15, 1), (16, 1), (64, 1), (128, 1), (64, 2), (48, 1))
    request = BenchRequest(
        TrainConfig(), sizes, ("training",), 1.0, None, None, (), Path()
    )
    cases = list(measuring.measure_sizes(request, Console()))
    assert tried == [(15, 1), (16, 1), (64, 1), (64, 2), (48, 1)]
    assert cases[3].error == "not tried: 64 robots were out of memory"


def test_a_start_that_fails_says_why(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "FIRST_STEP", "raise RuntimeError('no driver')")
    assert command.main([*SMALL, "--startup", "--out", str(tmp_path)]) == 2
    assert (
        capsys.readouterr().err
        == "error: --startup: the cold start failed: RuntimeError: no driver\n"
    )


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--robots", "0"], ["--robots"]),
        (["--robots", "many"], ["--robots"]),
        (["--devices", "64"], ["--devices 64", "JAX sees"]),
        (["--devices", "-1"], ["--devices"]),
        (["--seconds", "0"], ["--seconds"]),
        (["--seconds", "nan"], ["--seconds"]),
        (["--parts", "brains"], ["--parts", "physics"]),
        (["--parts", "brax"], ["--parts"]),
        (["--peer", "isaac"], ["--peer", "brax"]),
        (["--preset", "huge"], ["--preset", "smoke"]),
        (["--ppo.num-minibatches", "3"], ["num_minibatches"]),
        (["--speed"], ["--speed"]),
    ],
)
def test_wrong_flags_are_told_and_status_2(argv, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command.main(["--preset", "smoke", *argv]) == 2
    error = capsys.readouterr().err
    assert is_told(error)
    for word in words:
        assert word in error
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_other_things_in_it_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").touch()
    assert command.main([*SMALL, "--out", str(tmp_path)]) == 2
    assert "other files" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert command.main([*SMALL, "--out", str(tmp_path / "file" / "below")]) == 2
    assert "cannot write to" in capsys.readouterr().err


def test_nothing_measured_is_a_mistake(tmp_path, capsys):
    assert command.main([*SMALL, "--robots", "15", "--out", str(tmp_path)]) == 2
    assert "nothing could be measured" in capsys.readouterr().err
