import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bp2_rl.base import processes
from bp2_rl.base.serialization import save_config
from bp2_rl.cli import app, bench, study, train
from bp2_rl.settings import presets
from bp2_rl.settings.training import ClusterConfig


def early_flags(words: list[str]) -> train.EarlyFlags:
    return app.parse_known(train.EarlyFlags, words, "bp2 train")


@pytest.mark.parametrize(
    ("words", "ours", "threads"),
    [
        ([], True, "3"),  # without an accelerator the kernel simulates
        (["--preset", "cpu"], True, "3"),
        (["--preset", "cpu"], False, "1"),  # the user has said how many
        (["--preset", "smoke", "--impl", "kernel"], True, "3"),
        (["--preset", "cpu", "--impl", "jax"], True, "1"),
        (["--preset", "smoke"], True, "1"),
        (["--resume", "nowhere"], True, "1"),
    ],
)
def test_xla_has_all_processors_where_mjx_does_not_simulate(
    words, ours, threads, monkeypatch
):
    """With MJX its thread pool may wait for ever."""
    monkeypatch.setenv("NPROC", "1")
    monkeypatch.setattr(processes, "NPROC_IS_OURS", ours)
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.setattr(processes, "processors", lambda: 3)
    train.use_processors(early_flags(words))
    assert os.environ["NPROC"] == threads


@pytest.mark.parametrize(
    ("code", "unused"),
    [
        (
            "from bp2_rl.cli.train import EarlyFlags, unused_left_out\n"
            "with unused_left_out(EarlyFlags(preset='gpu')): from bp2_rl.cli import runtime\n"
            "from bp2_rl.evaluation import judged_training\n"
            "assert 'tensorboardX' not in sys.modules\n"
            "from bp2_rl.learning.monitor import Monitor; Monitor(Path(sys.argv[1]), 1)",
            {"warp", "matplotlib", "casadi", "torch", "networkx"},
        ),
        (
            "import bp2_rl.evaluation.judge",
            {"warp", "matplotlib", "tensorboardX", "brax", "trimesh", "mujoco.mjx"},
        ),
    ],
)
def test_a_training_and_its_judge_import_what_they_use(code, unused, tmp_path):
    """Each of these takes a second or more of a start, where it is installed: here all
    are."""
    for name in ("warp", "torch", "networkx"):
        (tmp_path / f"{name}.py").touch()
    program = f"import sys; from pathlib import Path\n{code}\nprint(*sys.modules)"
    env = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(
            [str(tmp_path), os.environ.get("PYTHONPATH", "")]
        ),
    }
    ended = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)],
        env=env,
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = ended.stdout.split()
    assert "mujoco" in loaded
    assert not unused & set(loaded)


@pytest.mark.parametrize(
    ("words", "left_out"),
    [([], True), (["--impl", "jax"], True), (["--impl=warp"], False)],
)
def test_warp_is_left_out_only_where_it_does_not_simulate(words, left_out, monkeypatch):
    monkeypatch.delitem(sys.modules, "warp", raising=False)
    with train.unused_left_out(early_flags(words)):
        assert ("warp" in sys.modules) == left_out
    assert "warp" not in sys.modules


def test_with_the_kernel_each_processor_is_a_device_unless_the_user_says_otherwise(
    monkeypatch,
):
    monkeypatch.setattr(processes, "NPROC_IS_OURS", True)
    monkeypatch.setattr(processes, "processors", lambda: 3)
    for words, before, after in (
        (["--preset", "cpu"], "", "--xla_force_host_platform_device_count=3"),
        (
            ["--preset", "cpu"],
            "--a=1",
            "--a=1 --xla_force_host_platform_device_count=3",
        ),
        (["--preset", "cpu", "--impl", "warp"], "", ""),
        (["--impl", "kernel"], *2 * ("--xla_force_host_platform_device_count=1",)),
    ):
        monkeypatch.setenv("NPROC", "1")
        monkeypatch.setenv("XLA_FLAGS", before)
        train.use_processors(early_flags(words))
        assert os.environ["XLA_FLAGS"] == after


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (train, ["--out", "run"]),
        (study, ["--out", "study"]),
        (bench, ["--out", "bench"]),
    ],
)
def test_the_preset_for_an_accelerator_is_refused_without_one(
    command, words, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("bp2_rl.cli.runtime.find_backend", lambda: "cpu")
    monkeypatch.setattr("bp2_rl.cli.train.use_all_processors", lambda: None)
    monkeypatch.setattr("bp2_rl.tools.study.running.visible_gpus", lambda: ())
    assert command.main(["--preset", "gpu", *words]) == 2
    line = "error: JAX sees no accelerator, and on processors --preset gpu takes days: use --preset cpu\n"
    assert capsys.readouterr().err == line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words", [["--preset", "cpu", "--impl", "warp"], ["--resume", "run"]]
)
def test_warp_cannot_repeat_its_bits(words, capsys, monkeypatch):
    run = dataclasses.replace(presets.preset("imitation", "smoke"), impl="warp")
    monkeypatch.setattr(train, "load_run_config", lambda _: run)
    assert train.main(["--deterministic", *words]) == 2
    assert "never exactly repeatable" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "known"),
    [
        (train.EarlyFlags(preset="gpu"), True),
        (train.EarlyFlags(), False),
        (train.EarlyFlags(preset="gpu", parent=Path("run")), False),
        (train.EarlyFlags("relaxed", preset="gpu"), False),
        (train.EarlyFlags("relaxed", resume=Path("run")), True),
        (
            train.EarlyFlags(preset="gpu", cluster=ClusterConfig("auto")),
            False,
        ),
    ],
)
def test_defaults_that_hang_on_the_machine_or_a_parent_are_read_after_jax(
    flags, known, monkeypatch
):
    """Where an accelerator's package is installed, JAX alone can tell whether it is
    there."""
    monkeypatch.setattr(train, "jax_is_on_cpu", lambda: False)
    assert flags.known_without_jax is known


@pytest.mark.parametrize("preset", ["gpu", "cpu"])
def test_the_relaxed_stage_is_the_presets_but_for_what_was_set_for_the_imitation_stage(
    preset, tmp_path
):
    """So what the preset asks of robots that run already is asked of them."""
    parent = presets.preset("imitation", preset, robot="ideal")
    commands = dataclasses.replace(parent.env.commands, max_lateral=0.3)
    hardware = parent.env.hardware.changed(friction=0.9)
    mine = dataclasses.replace(parent.env, commands=commands, hardware=hardware)
    parent = dataclasses.replace(parent, env=mine, impl="jax")
    save_config(tmp_path / "config.json", parent)
    words = ["--stage", "relaxed", "--preset", preset, "--from", str(tmp_path)]
    relaxed = presets.preset("relaxed", preset, robot="ideal").env
    asked = dataclasses.replace(relaxed.commands, max_lateral=0.3)
    arguments = train.read_arguments(words)
    child = arguments.env
    assert (
        arguments.impl
        == app.parse_known(train.EarlyFlags, words, "train").physics
        == "jax"
    )
    # The robot goes on; the stage's rewards are its own.
    assert child == dataclasses.replace(relaxed, commands=asked, hardware=hardware)
    assert child != dataclasses.replace(mine, reward=relaxed.reward)
    moved = train.read_arguments([*words, "--robot", "built"]).env
    assert moved.hardware == presets.preset("relaxed", preset).env.hardware
