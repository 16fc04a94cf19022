"""Traced programs kept on disk: the same bits as without, and never those of other
settings, robots or sources."""

import dataclasses
import inspect
import os
import subprocess
import sys
import types
from pathlib import Path

import jax
import numpy as np
import pytest
from aim import TINY, Aim, assert_equal

from bp2_rl.learning import programs
from bp2_rl.learning.ppo import PPO
from bp2_rl.learning.programs import use_kept
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import load_model
from bp2_rl.settings.training import RunConfig, TrainConfig
from bp2_rl.tools.throughput import COMPILED, compilations

CONFIG = TrainConfig(ppo=TINY, impl="kernel")


MODEL = load_model(CONFIG.env.hardware)


def learn(learner: PPO):
    state = learner.init(3)
    for _ in range(2):
        state, metrics = learner.train_step(state)
    return state, metrics


def use(folder, config=CONFIG, model=MODEL) -> PPO:
    learner = PPO(Aim(), config.ppo)
    use_kept(learner, config, model, folder)
    return learner


@pytest.fixture
def traced(monkeypatch):
    """Record when a program is traced; return the list of records."""
    names, trace = [], programs._trace
    monkeypatch.setattr(
        programs, "_trace", lambda learner: names.append("traced") or trace(learner)
    )
    return names


def test_the_second_start_traces_nothing_and_trains_to_the_same_bits(tmp_path, traced):
    first = learn(use(tmp_path))
    second = use(tmp_path)
    assert traced == ["traced"]
    assert_equal(learn(second), first)
    assert_equal(learn(PPO(Aim(), TINY)), first)
    assert second.shape == PPO(Aim(), TINY).shape


@pytest.mark.parametrize("kept", [True, False])
def test_programs_are_compiled_once_beside_the_first_state(tmp_path, kept):
    use(tmp_path)
    learner = use(tmp_path) if kept else PPO(Aim(), TINY)
    with learner.compiling():
        state = learner.init(0)
    with compilations() as late:
        for _ in range(3):
            state, _ = learner.train_step(state)
    assert late[COMPILED] == 0


def test_a_process_that_traces_nothing_trains_to_the_same_bits(tmp_path):
    """What a second command does: classes of the state, devices and JAX's options are
    made anew."""
    program = f"""
import hashlib, pathlib, sys
sys.path[:0] = {[str(Path(__file__).parent), str(Path(inspect.getfile(Aim)).parent)]!r}
from test_programs import jax, learn, programs, use
trace = programs._trace
programs._trace = lambda learner: print("traced") or trace(learner)
leaves = jax.tree.leaves(jax.device_get(learn(use(pathlib.Path({str(tmp_path)!r})))))
print(hashlib.sha256(b"".join(leaf.tobytes() for leaf in leaves)).hexdigest())
"""
    first, second = (
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    )
    assert first == ["traced", *second]


@pytest.mark.parametrize(
    ("change", "programs_made"),
    [
        ({"ppo": dataclasses.replace(TINY, num_epochs=3)}, 2),
        ({"env": dataclasses.replace(CONFIG.env, hardware=BUILT)}, 2),
        ({"impl": "jax"}, 2),
        ({"stage": "relaxed", "run": RunConfig(seed=7, steps=10)}, 1),
    ],
)
def test_settings_that_change_a_program_have_one_of_their_own(
    tmp_path, traced, change, programs_made
):
    use(tmp_path)
    use(tmp_path, dataclasses.replace(CONFIG, **change))
    assert len(traced) == programs_made


def test_another_model_of_the_same_settings_has_programs_of_its_own(tmp_path, traced):
    """A robot file names a model's file, which may be edited."""
    use(tmp_path)
    heavier = load_model(CONFIG.env.hardware)
    heavier.body_mass[1] += 0.001
    use(tmp_path, model=heavier)
    assert len(traced) == 2


def test_options_of_jax_are_a_part_of_the_key(tmp_path, traced):
    use(tmp_path)
    old = jax.config.values["jax_default_matmul_precision"]
    jax.config.update("jax_default_matmul_precision", "highest")
    try:
        use(tmp_path)
    finally:
        jax.config.update("jax_default_matmul_precision", old)
    assert len(traced) == 2


@pytest.mark.parametrize("gate", ["warp", "two GPUs", "two processes"])
def test_what_was_not_tried_is_traced_by_every_run(tmp_path, traced, monkeypatch, gate):
    config, learner = CONFIG, PPO(Aim(), TINY)
    if gate == "warp":
        config = dataclasses.replace(CONFIG, impl="warp")
    elif gate == "two processes":
        monkeypatch.setattr(jax, "process_count", lambda: 2)
    else:
        gpus = np.array([types.SimpleNamespace(platform="gpu")] * 2)
        monkeypatch.setattr(
            learner, "mesh", types.SimpleNamespace(size=2, devices=gpus)
        )
    own = learner.programs
    use_kept(learner, config, MODEL, tmp_path)
    assert learner.programs is own
    assert traced == list(tmp_path.iterdir()) == []


def test_old_files_go(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "KEPT", 2)
    for age, name in enumerate(("newest", "newer", "old", "oldest")):
        file = tmp_path / f"{name}.programs"
        programs._write(file, {})
        os.utime(file, (1e9 - age, 1e9 - age))
    (tmp_path / "notes.txt").write_text("of somebody else's")
    use(tmp_path)
    names = {file.name for file in tmp_path.iterdir()}
    assert "newest.programs" in names
    assert {"oldest.programs", "old.programs", "newer.programs"} & names == set()
    assert len(names) == 3
    assert "notes.txt" in names


def test_edited_sources_are_traced_anew(tmp_path, traced, monkeypatch):
    package = tmp_path / "package"
    (package / "env").mkdir(parents=True)
    monkeypatch.setattr(programs, "PACKAGE", package)
    source = package / "env" / "rewards.py"
    for text in ("a = 1", "a = 2"):
        source.write_text(text)
        os.utime(source, (0, 0))  # where an edit keeps even the time
        use(tmp_path / "kept")
        use(tmp_path / "kept")
    assert len(traced) == 2
    (package / "paper").mkdir()
    (package / "paper" / "figure.py").write_text("no training computes with it")
    use(tmp_path / "kept")
    assert len(traced) == 2


def test_programs_of_sources_edited_since_they_were_imported_are_not_kept(
    tmp_path, traced, monkeypatch
):
    monkeypatch.setattr(programs, "IMPORTED_AT", 0.0)
    use(tmp_path / "kept")
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("content", [b"", b"no programs", None])
def test_a_damaged_file_is_written_anew(tmp_path, traced, content):
    use(tmp_path)
    [file] = tmp_path.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)
    use(tmp_path)
    use(tmp_path)
    assert len(traced) == 2


def test_a_folder_that_cannot_be_written_costs_only_time(tmp_path, traced):
    (tmp_path / "file").write_text("")
    learn(use(tmp_path / "file"))
    assert traced == ["traced"]
