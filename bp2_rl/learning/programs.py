"""A disk cache of traced programs, with which a training starts without tracing.

JAX's own cache on disk spares the compiler. Its key is the traced program, and tracing
takes longer than all the rest of a start. Here the key is what a program is made from:
settings, robot, library, sources, versions, devices and JAX's options. What is kept is
StableHLO, of which JAX's cache has the compiled program.
"""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import mujoco
import numpy as np
from jax import export

from bp2_rl.base.assets import PACKAGE
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import ArraySpec, read_npz, write_npz
from bp2_rl.base.processes import IMPORTED_AT
from bp2_rl.base.serialization import config_hash, package_versions
from bp2_rl.learning.ppo import PPO, Programs, TrainState
from bp2_rl.robot.kernel.fusion_barriers import find_runtime
from bp2_rl.settings.training import TrainConfig

FLOORS = ("base", "robot", "settings", "reference", "env", "learning")
"""The packages that a training computes with: no other source changes a program."""
WANTED = {
    "init": ArraySpec(np.uint8, (None,)),
    "train_step": ArraySpec(np.uint8, (None,)),
}
KEPT = 8
"""Number of files kept in the folder; the oldest are removed."""
PALLAS = [
    export.DisabledSafetyCheck.custom_call(name)
    for name in ("__gpu$xla.gpu.triton", "triton_kernel_call_ffi")
]
"""Calls of Pallas' kernels on a GPU. JAX does not promise that another version of it
knows them; the key has its version."""


def use_kept(
    learner: PPO, config: TrainConfig, robot: mujoco.MjModel, folder: Path
) -> None:
    """Let a run's learner compute with the traced programs in `folder`; where they are
    not there, trace and keep them.

    Only in one process, and of accelerators only on a single one: more of them were not
    tried. Not with MJX-Warp, whose programs call into their own process. A damaged file
    is traced again. The folder is trusted, like that of JAX's own
    cache: its programs are run.

    `config` has the run's settings, `robot` is its model, for which the settings may
    only name a file. Where the folder cannot be written, nothing is kept.
    """
    several = learner.mesh.size > 1 and learner.mesh.devices.flat[0].platform != "cpu"
    if several or jax.process_count() > 1 or config.impl == "warp":
        return
    if config.impl == "kernel":
        find_runtime()
    key, newest = _key(learner, config, robot)
    path = folder / f"{key}.programs"
    kept = _read(path)
    if kept is None:
        kept = _trace(learner)
        # otherwise a source file may have been edited after its import
        if newest < IMPORTED_AT:
            _write(path, kept)
    learner.programs = _load(learner, kept)


def _key(learner: PPO, config: TrainConfig, robot: mujoco.MjModel) -> tuple[str, float]:
    """Return a hash of all that the programs are made from, and when the newest source
    was written, s since 1970."""
    model = np.empty(mujoco.mj_sizeModel(robot), np.uint8)
    mujoco.mj_saveModel(robot, None, model)
    made_from = (
        config_hash(config.env),
        config_hash(config.ppo),
        config.impl,
        config.env.library.sha256 if config.env.reference == "collocation" else "",
        hashlib.sha256(model.tobytes()).hexdigest(),
        [device.device_kind for device in learner.mesh.devices.flat],
        sorted(package_versions().items()),
        sorted(
            (name, repr(value))
            for name, value in jax.config.values.items()
            if "cache" not in name
        ),
    )
    whole = hashlib.sha256(repr(made_from).encode())
    sources = [
        source for floor in FLOORS for source in sorted((PACKAGE / floor).rglob("*.py"))
    ]
    for source in sources:
        whole.update(hashlib.sha256(source.read_bytes()).digest())
    return whole.hexdigest(), max(source.stat().st_mtime for source in sources)


def _trace(learner: PPO) -> dict[str, np.ndarray]:
    """Return both traced programs as bytes, by their names.

    They are functions of the leaves of the state: JAX could not write the state's type.
    """
    leaves, tree = jax.tree.flatten(learner.shape)
    shardings = [leaf.sharding for leaf in leaves]
    first, then = learner.programs.init, learner.programs.train_step

    def init(key: jax.Array) -> list[jax.Array]:
        return jax.tree.leaves(first.__wrapped__(key))

    def train_step(
        leaves: list[jax.Array],
    ) -> tuple[list[jax.Array], dict[str, jax.Array]]:
        state, metrics = then.__wrapped__(tree.unflatten(leaves))
        return jax.tree.leaves(state), metrics

    def traced(
        program: Callable[..., object], out_shardings: object, argument: object
    ) -> np.ndarray:
        jitted = jax.jit(program, out_shardings=out_shardings)
        exported = export.export(jitted, disabled_checks=PALLAS)(argument)
        return np.frombuffer(bytes(exported.serialize()), np.uint8)

    return {
        "init": traced(init, shardings, learner.first_key(0)),
        "train_step": traced(train_step, (shardings, learner.everywhere), leaves),
    }


def _load(learner: PPO, kept: Mapping[str, np.ndarray]) -> Programs:
    """Return the kept programs as functions of the train state."""
    tree = jax.tree.structure(learner.shape)
    first, then = (
        export.deserialize(bytearray(kept[name].tobytes())).call for name in WANTED
    )

    def init(key: jax.Array) -> TrainState:
        return tree.unflatten(first(key))

    def train_step(state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
        leaves, metrics = then(jax.tree.leaves(state))
        return tree.unflatten(leaves), metrics

    return learner.jitted(init, train_step)


def _read(path: Path) -> dict[str, np.ndarray] | None:
    """Return the programs in a file; None where it is not there or damaged."""
    try:
        return read_npz(path, WANTED)
    except UserError:
        return None


def _write(path: Path, kept: Mapping[str, np.ndarray]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_npz(path, kept)
        files = sorted(
            path.parent.glob("*.programs"), key=lambda file: file.stat().st_mtime
        )
        for file in files[:-KEPT]:
            file.unlink()
    except OSError:  # it only costs the tracing next time
        return
