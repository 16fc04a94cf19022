"""Compiled programs kept on disk, with which a training begins without tracing them anew.

JAX's own cache on disk spares the compiler, but not the tracing: its key is the traced program, which takes longer than
all the rest of a start. Here the key is what the programs are made from: settings, devices, versions and JAX's options;
and no file of a module that was loaded when they were made may have changed since.
"""

import dataclasses
import hashlib
import os
import pickle
import sys
from pathlib import Path
from typing import Any

import jax
from jax.experimental import serialize_executable
from jax.extend.backend import get_backend

from bp2_rl import IMPORTED_AT
from bp2_rl.assets import asset_path
from bp2_rl.config import config_hash, package_versions
from bp2_rl.files import write_bytes
from bp2_rl.learning.ppo import PPO, Programs
from bp2_rl.settings.training import RunConfig, TrainConfig

FORMAT = 1  # of the files


class ProgramStore:
    """A folder of programs, a file for each training's settings; a damaged or outdated one is as none.

    Like those of JAX's cache, its files are programs: whoever can write to it can have the user run anything.
    """

    def __init__(self, folder: Path):
        self._folder = folder

    def lend(self, learner: PPO, config: TrainConfig) -> bool:
        """Let the learner of a training use what is kept for it; whether there is anything."""
        programs = _load(self._path(learner, config), learner) if _can_keep(learner, config) else None
        if programs is not None:
            learner.use(programs)
        return programs is not None

    def keep(self, learner: PPO, config: TrainConfig, programs: Programs) -> None:
        """Keep what the learner has compiled, where that is possible."""
        if _can_keep(learner, config):
            _save(self._path(learner, config), programs)

    def _path(self, learner: PPO, config: TrainConfig) -> Path:
        return self._folder / f"{_key(learner, config)}.pkl"


def _can_keep(learner: PPO, config: TrainConfig) -> bool:
    """Not on a CPU: what JAX has from its own cache cannot be written again there. Nor physics that calls back into
    this process, nor the part of a program that a cluster's process has."""
    on_cpu = learner.mesh.devices.flat[0].platform == "cpu"
    return not on_cpu and config.impl in ("jax", "kernel") and jax.process_count() == 1


def _key(learner: PPO, config: TrainConfig) -> str:
    """What the programs are made from, but for the files."""
    options = {name: value for name, value in jax.config.values.items() if not name.startswith("jax_compilation_cache")}
    variables = {name: value for name, value in os.environ.items() if name.startswith(("JAX_", "XLA_", "NVIDIA_TF32"))}
    made_from = (
        FORMAT,
        config_hash(dataclasses.replace(config, stage="imitation", run=RunConfig(), parent=None)),
        [(device.id, device.device_kind) for device in learner.mesh.devices.flat],
        get_backend().platform_version,
        sys.version,
        sorted(package_versions().items()),
        sorted((name, repr(value)) for name, value in options.items()),
        sorted(variables.items()),
    )
    return hashlib.sha256(repr(made_from).encode()).hexdigest()[:32]


def _load(path: Path, learner: PPO) -> Programs | None:
    """The programs in a file, if they are there and nothing has changed since."""
    try:
        kept = pickle.loads(path.read_bytes())
        if kept["files"] != _stamps(kept["files"]):
            return None
        devices = list(learner.mesh.devices.flat)
        init, train_step = (
            serialize_executable.deserialize_and_load(*program, execution_devices=devices)
            for program in (kept["init"], kept["train_step"])
        )
        return Programs(kept["shape"], init, train_step)
    except Exception:  # a file may be damaged in any way, and what it holds can be made anew
        return None


def _save(path: Path, programs: Programs) -> None:
    """Keep the programs, where the disk and JAX allow it: they only save time."""
    files = _stamps([*_module_files(), *map(str, asset_path(".").rglob("*"))])
    if any(stamp is not None and stamp[0] > IMPORTED_AT for stamp in files.values()):
        return  # it was edited meanwhile: perhaps the programs are of what it was before
    try:
        kept = {
            "files": files,
            "shape": jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), programs.shape),
            "init": serialize_executable.serialize(programs.init),
            "train_step": serialize_executable.serialize(programs.train_step),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, pickle.dumps(kept))
    except Exception:
        return


def _module_files() -> list[str]:
    return [file for module in list(sys.modules.values()) if (file := getattr(module, "__file__", None))]


def _stamps(files: Any) -> dict[str, Any]:
    """When each file was last written (ns), and its size in bytes; of one that is not there nothing."""
    stamps = {}
    for file in files:
        try:
            found = os.stat(file)
            stamps[file] = (found.st_mtime_ns, found.st_size)
        except OSError:
            stamps[file] = None
    return stamps
