"""Programs kept on disk: the same bits, and never those of other code, settings or devices."""

import dataclasses
import inspect
import os
import pickle
import subprocess
import sys
import textwrap
from pathlib import Path

import jax
import numpy as np
import pytest
from aim import TINY, Aim
from jax.experimental.compilation_cache import compilation_cache

from bp2_rl.bench.measure import Compilations
from bp2_rl.learning import programs as kept
from bp2_rl.learning.ppo import PPO
from bp2_rl.learning.programs import ProgramStore
from bp2_rl.settings.training import TrainConfig


@pytest.fixture
def anywhere(monkeypatch):
    """On a CPU, too, where nothing comes from JAX's own cache."""
    monkeypatch.setattr(kept, "_can_keep", lambda learner, config: True)
    old = jax.config.values["jax_enable_compilation_cache"]
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    yield
    jax.config.update("jax_enable_compilation_cache", old)
    compilation_cache.reset_cache()


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module that was loaded when the programs were made."""
    path = tmp_path / "bp2_rl_test_module.py"
    path.write_text("ANSWER = 42\n")
    os.utime(path, (1e9, 1e9))
    monkeypatch.syspath_prepend(tmp_path)
    __import__(path.stem)
    yield path
    del sys.modules[path.stem]


CONFIG = TrainConfig()


def keep(folder: Path) -> tuple[ProgramStore, PPO]:
    store, learner = ProgramStore(folder), PPO(Aim(), TINY)
    store.keep(learner, CONFIG, learner.compile())
    return store, learner


def bits(learner: PPO) -> list[np.ndarray]:
    state = learner.init(3)
    for _ in range(2):
        state, metrics = learner.train_step(state)
    return jax.tree.leaves(jax.device_get((state, metrics)))


def test_kept_programs_train_to_the_same_bits_and_compile_nothing(tmp_path, anywhere):
    store, learner = keep(tmp_path)
    other = PPO(Aim(), TINY)
    with Compilations() as compiled:
        assert store.lend(other, CONFIG)
        shape = other.shape
        ours = bits(other)
    assert compiled.count == 0
    assert jax.tree.leaves(shape) == jax.tree.leaves(learner.shape)
    for a, b in zip(ours, bits(learner), strict=True):
        np.testing.assert_array_equal(a, b)


def test_another_process_uses_them(tmp_path):
    """What a command does: there the code, the classes of the state and the devices are loaded anew."""
    program = textwrap.dedent(f"""
        import sys
        sys.path[:0] = {[str(Path(__file__).parent), str(Path(inspect.getfile(Aim)).parent)]!r}
        from test_programs import CONFIG, TINY, Aim, PPO, ProgramStore, bits, kept
        kept._can_keep = lambda learner, config: True
        store, learner = ProgramStore(kept.Path({str(tmp_path)!r})), PPO(Aim(), TINY)
        lent = store.lend(learner, CONFIG)
        if not lent:
            store.keep(learner, CONFIG, learner.compile())
        print(lent, hash(b"".join(leaf.tobytes() for leaf in bits(learner))))
    """)
    env = os.environ | {"PYTHONHASHSEED": "0", "JAX_ENABLE_COMPILATION_CACHE": "0"}
    first, second = (
        subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    )
    assert (first.split()[0], second.split()[0]) == ("False", "True")
    assert first.split()[1] == second.split()[1]


def test_other_settings_and_options_have_programs_of_their_own(tmp_path, anywhere):
    store, learner = keep(tmp_path)
    same = dataclasses.replace(CONFIG, stage="relaxed", run=dataclasses.replace(CONFIG.run, seed=7))
    assert store.lend(learner, same)
    fewer = dataclasses.replace(CONFIG.ppo, num_epochs=CONFIG.ppo.num_epochs + 1)
    assert not store.lend(learner, dataclasses.replace(CONFIG, ppo=fewer))
    with jax.default_matmul_precision("highest"):
        assert store.lend(learner, CONFIG)  # a thread's own, inside a program: not the process's
    old = jax.config.values["jax_default_matmul_precision"]
    jax.config.update("jax_default_matmul_precision", "highest")
    try:
        assert not store.lend(learner, CONFIG)
    finally:
        jax.config.update("jax_default_matmul_precision", old)


@pytest.mark.parametrize("change", ["later", "longer", "gone"])
def test_programs_of_code_that_has_changed_are_not_used(tmp_path, anywhere, module, change):
    store, _ = keep(tmp_path / "store")
    assert store.lend(PPO(Aim(), TINY), CONFIG)
    if change == "later":
        os.utime(module, (1e9, 1e9 + 1))
    elif change == "longer":
        module.write_text("ANSWER = 6 * 7\n")
        os.utime(module, (1e9, 1e9))
    else:
        module.unlink()
    assert not store.lend(PPO(Aim(), TINY), CONFIG)


def test_programs_of_code_that_was_edited_meanwhile_are_not_kept(tmp_path, anywhere, module):
    os.utime(module)
    keep(tmp_path / "store")
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize("content", [b"", b"no pickle", pickle.dumps({"files": {}}), pickle.dumps([])])
def test_a_damaged_file_is_as_none_and_is_written_anew(tmp_path, anywhere, content):
    store, learner = keep(tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(content)
    assert not store.lend(PPO(Aim(), TINY), CONFIG)
    store.keep(learner, CONFIG, learner.compile())
    assert store.lend(PPO(Aim(), TINY), CONFIG)


def test_a_folder_that_cannot_be_written_costs_nothing_but_time(tmp_path, anywhere):
    (tmp_path / "file").write_text("")
    store, learner = keep(tmp_path / "file")
    assert not store.lend(learner, CONFIG)


def test_on_processors_nothing_is_kept(tmp_path):
    keep(tmp_path / "store")
    assert not (tmp_path / "store").exists()
