"""`bp2 bench` as a user meets it, on an environment that compiles at once."""

import json
import re

import jax
import pytest
from aim import Aim
from rich.console import Console

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import load_config
from bp2_rl.cli import app, train
from bp2_rl.cli import bench as command
from bp2_rl.settings.training import TrainConfig
from bp2_rl.tools import bench as measuring
from bp2_rl.tools.bench import Bench
from bp2_rl.tools.throughput import TooManyRobotsError, share_out

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
    """Run the bench once with nearly every option; return its folder and what it
    printed."""
    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "make_env", lambda config, robots: Aim())
        argv = [*SMALL, "--out", str(folder / "out")]
        console = Console(record=True, width=80)
        patch.setattr(measuring, "Console", lambda: console)
        assert command.main(argv) == 0
    return folder, console.export_text()


MEASURED = "environment", "resets", "policy", "sgd", "training"


def test_the_report_holds_every_number(whole):
    report = load_config(Bench, whole[0] / "out" / "bench.json")
    assert tuple(m.part for m in report.timings) == MEASURED
    assert report.errors == ()
    assert sum(share_out(report.timings).values()) == pytest.approx(1.0)
    for m in report.timings:
        assert m.control_steps_per_second == pytest.approx(16 * 5 / m.seconds)
        assert (m.robots, m.devices, m.compilations) == (16, jax.device_count(), 0)
    assert report.config.ppo.num_envs == 16
    assert report.versions["jax"] == jax.__version__
    assert (report.platform, report.device_count) == ("cpu", jax.device_count())
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", report.created)
    # rows come as they are measured, and the table last
    rows = re.findall(r"^(\w+), 16 robots|(control/s)", whole[1], re.MULTILINE)
    assert [row or head for row, head in rows] == [
        *MEASURED,
        "control/s",
    ]


def test_a_size_that_does_not_fit_leaves_the_others(tmp_path, capsys):
    argv = [*SMALL, "--robots", "15", "16", "--parts", "resets", "--out", str(tmp_path)]
    assert command.main(argv) == 0
    report = json.loads((tmp_path / "bench.json").read_text())
    assert "num_minibatches" in report["errors"][0]
    assert [row["robots"] for row in report["timings"]] == [16]
    assert (
        "15 robots on 1 device: ppo.num_envs (15) must be a multiple"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("flags", "sizes"),
    [
        (["--robots", "64", "128", "64"], ((64, 6), (128, 6))),
        (["--devices", "1", "2"], ((8192, 1), (8192, 2))),
    ],
)
def test_each_number_of_robots_is_measured_on_each_number_of_devices(
    flags, sizes, monkeypatch
):
    monkeypatch.setattr(jax, "device_count", lambda: 6)
    assert command.choose_sizes(read("--preset", "gpu", *flags)) == sizes


def test_sizes_above_one_that_ran_out_of_memory_are_not_tried(
    tmp_path, monkeypatch, capsys
):
    tried = []

    def measure(config, robots, devices, parts, seconds):
        tried.append((robots, devices))
        raise errors.get((robots, devices), UserError("an odd number"))

    errors = {(64, 1): TooManyRobotsError("out of memory")}
    monkeypatch.setattr(measuring, "measure", measure)
    sizes = ((15, 1), (16, 1), (64, 1), (128, 1), (64, 2), (48, 1))
    with pytest.raises(UserError, match="nothing could be measured: 15 robots on 1"):
        measuring.run_bench(TrainConfig(), sizes, ("training",), 1.0, tmp_path)
    assert tried == [(15, 1), (16, 1), (64, 1), (64, 2), (48, 1)]
    assert "64 robots on 1 device: out of memory" in capsys.readouterr().out


def test_a_folder_with_other_things_in_it_and_what_measures_nothing_are_refused(
    tmp_path, capsys
):
    (tmp_path / "thesis.tex").touch()
    for out, sizes, word in (
        (tmp_path, [], "other files"),
        (tmp_path / "thesis.tex" / "below", [], "cannot write to"),
        (tmp_path / "new", ["--robots", "15"], "nothing could be measured"),
    ):
        assert command.main([*SMALL, *sizes, "--out", str(out)]) == 2
        assert word in capsys.readouterr().err
