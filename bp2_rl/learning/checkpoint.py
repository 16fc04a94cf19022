"""Save and restore a whole training state, bit for bit, so that a killed run goes on exactly where it was.

    RUN/checkpoints/<step>/metadata.json    format, step, versions, the tree's leaves, a checksum of every file
    RUN/checkpoints/<step>/state/           the arrays, as Orbax writes them
    RUN/checkpoints/.new-<step>/            a save in progress, or what a killed one left

A save is written under the last name, flushed to disk, and renamed into place: a folder named by a step is
complete. Leftovers are passed over by every reader and removed by the next save.
"""

import dataclasses
import datetime
import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from bp2_rl.config import package_versions
from bp2_rl.errors import UserError

FORMAT_VERSION = 1
FOLDER = "checkpoints"
METADATA = "metadata.json"
STATE = "state"

State = TypeVar("State")


class CheckpointError(UserError):
    """A checkpoint that cannot be written, or that does not fit the training it is to resume."""


def save_checkpoint(
    run_dir: Path, step: int, state: Any, keep: int = 3, *, extra: Mapping[str, Any] | None = None
) -> Path:
    """Save `state` as the run's checkpoint of `step`; afterwards it is on disk, whole.

    Args:
        run_dir: the run's folder; made if absent.
        step: names the checkpoint; one of the same step is replaced.
        state: any pytree of JAX or NumPy arrays, PRNG keys (raw or typed) and Python scalars.
        keep: how many checkpoints up to this one remain; older ones are removed.
        extra: JSON values to store beside it (the training config, say); `read_metadata` gives them back.

    Raises:
        CheckpointError: it could not be written; the checkpoints that were there still are.
    """
    if step < 0 or keep < 1:
        raise CheckpointError(f"a checkpoint needs step >= 0 and keep >= 1, got step {step} and keep {keep}")
    folder = Path(run_dir) / FOLDER
    temporary = folder / f".new-{step}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(folder)
        _write(temporary, step, state, extra or {})
        _commit(temporary, folder / str(step))
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        kept = latest_step(run_dir)
        raise CheckpointError(
            f"cannot save checkpoint {step} in {folder}: {error.strerror or error}; "
            + (f"the last good one is {kept}" if kept is not None else "there is none yet")
        ) from error
    for old in sorted(s for s in _steps(folder) if s <= step)[:-keep]:
        _remove(folder / str(old))
    return folder / str(step)


def latest_step(run_dir: Path) -> int | None:
    """The newest complete checkpoint's step; None where a run has none."""
    return max(_steps(Path(run_dir) / FOLDER), default=None)


def restore_checkpoint(run_dir: Path, template: State, step: int | None = None) -> tuple[int, State]:
    """Read back what `save_checkpoint` wrote.

    Args:
        run_dir: the run's folder.
        template: a pytree like the one saved, of arrays or `jax.ShapeDtypeStruct`s. Each leaf is restored on its
            template's sharding (so on another number of devices, if need be), as NumPy where that is NumPy.
        step: which checkpoint; the newest if None.

    Returns:
        The checkpoint's step and the state. Python scalars come back as such, or as arrays where the template
        has an array.

    Raises:
        CheckpointError: there is none, or it is damaged, newer than this program, or of another training: then
            the first leaf that differs is named.
    """
    if step is None:
        step = latest_step(run_dir)
        if step is None:
            raise CheckpointError(f"no complete checkpoint in {Path(run_dir) / FOLDER}")
    directory = Path(run_dir) / FOLDER / str(step)
    metadata = read_metadata(run_dir, step)
    _verify_files(directory, metadata["files"])
    saved = {path: _Leaf.parse(text) for path, text in metadata["tree"].items()}
    wanted = _flatten(template)
    _compare_trees(saved, {path: _describe(leaf) for path, leaf in wanted.items()}, directory)

    targets = {path: _target(leaf, saved[path]) for path, leaf in wanted.items() if saved[path].value is None}
    with ocp.StandardCheckpointer() as checkpointer:
        arrays = checkpointer.restore((directory / STATE).absolute(), targets) if targets else {}
    leaves = [_revive(leaf, saved[path], arrays.get(path)) for path, leaf in wanted.items()]
    return step, jax.tree.unflatten(jax.tree.structure(template), leaves)


def read_metadata(run_dir: Path, step: int) -> dict[str, Any]:
    """What is known of a checkpoint without reading its arrays: format_version, step, versions, extra, tree, files.

    Raises:
        CheckpointError: no such checkpoint, or it is half-written, damaged, foreign or newer than this program.
    """
    directory = Path(run_dir) / FOLDER / str(step)
    path = directory / METADATA
    if not directory.is_dir():
        there = ", ".join(map(str, sorted(_steps(directory.parent)))) or "none"
        raise CheckpointError(f"no checkpoint of step {step} in {directory.parent}; it has: {there}")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise CheckpointError(f"{directory} has no {METADATA}: half-written, or not a checkpoint of bp2_rl") from error
    except OSError as error:
        raise CheckpointError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise CheckpointError(f"{path} is truncated or damaged: {error}") from error
    version = data.get("format_version") if isinstance(data, dict) else None
    if type(version) is not int:
        raise CheckpointError(f"{path} is not of bp2_rl: it has no format_version")
    if version > FORMAT_VERSION:
        theirs = data.get("versions", {}).get("bp2_rl", "a newer version")
        raise CheckpointError(
            f"{directory} has checkpoint format {version}, of bp2_rl {theirs}; "
            f"this one reads up to {FORMAT_VERSION}: update bp2_rl"
        )
    if data.get("step") != step or not isinstance(data.get("tree"), dict) or not isinstance(data.get("files"), dict):
        raise CheckpointError(f"{path} is damaged: it does not describe the checkpoint of step {step}")
    return data


# --- The tree -------------------------------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True)
class _Leaf:
    """What the metadata says of one leaf: `float32[8192,47]`, `key<fry>[4]` or `python float 0.5`."""

    dtype: str  # of NumPy's names; "key<fry>" of a typed PRNG key; "python float" of a Python scalar
    shape: list[int]
    value: str | None = None  # of a Python scalar, as repr writes it: exact

    def __str__(self) -> str:
        return f"{self.dtype}[{','.join(map(str, self.shape))}]" if self.value is None else f"{self.dtype} {self.value}"

    @classmethod
    def parse(cls, text: str) -> "_Leaf":
        """The leaf that `str` wrote."""
        if text.startswith("python "):
            dtype, _, value = text.rpartition(" ")
            return cls(dtype, [], value)
        dtype, _, shape = text.removesuffix("]").rpartition("[")
        return cls(dtype, [int(size) for size in shape.split(",") if size])

    def fits(self, other: "_Leaf") -> bool:
        """Equal; or both scalars, one of them Python's, and of the same kind."""
        if {self.dtype, other.dtype} & _PYTHON.keys():
            return self.shape == other.shape == [] and _kind(self.dtype) == _kind(other.dtype)
        return (self.dtype, self.shape) == (other.dtype, other.shape)


_PYTHON = {"python bool": bool, "python int": int, "python float": float}


def _kind(dtype: str) -> str:
    """b, i or f; whatever else stays itself."""
    if dtype in _PYTHON:
        return dtype.removeprefix("python ")[0]
    if dtype.startswith("key<"):
        return dtype
    kind = "f" if jnp.issubdtype(jnp.dtype(dtype), jnp.floating) else np.dtype(dtype).kind
    return "i" if kind == "u" else kind


def _flatten(tree: Any) -> dict[str, Any]:
    """Leaves by their path, in the tree's order."""
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def _is_typed_key(leaf: Any) -> bool:
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _describe(leaf: Any) -> _Leaf:
    if isinstance(leaf, bool | int | float) and not isinstance(leaf, np.generic):
        return _Leaf(f"python {type(leaf).__name__}", [], repr(leaf))
    if not hasattr(leaf, "dtype") or not hasattr(leaf, "shape"):
        raise TypeError(f"a checkpoint holds arrays and Python scalars, not {type(leaf)}")
    name = str(leaf.dtype) if _is_typed_key(leaf) else np.dtype(leaf.dtype).name
    return _Leaf(name, list(leaf.shape))


def _compare_trees(saved: Mapping[str, _Leaf], wanted: Mapping[str, _Leaf], directory: Path) -> None:
    """Raise unless every leaf is there and fits; name the first that does not."""
    for path in [*wanted, *saved]:
        there, here = saved.get(path), wanted.get(path)
        if there is None or here is None or not there.fits(here):
            raise CheckpointError(
                f"{directory} is of another training: {path} is {there or 'absent'} there and {here or 'absent'} here; "
                f"resume with the settings of the run's own config.json"
            )


def _target(leaf: Any, saved: _Leaf) -> Any:
    """What Orbax is asked to restore for a leaf: as NumPy, or on which sharding."""
    if isinstance(leaf, np.ndarray | np.generic):
        return np.empty(saved.shape, jnp.dtype(saved.dtype))
    sharding = getattr(leaf, "sharding", None) or jax.sharding.SingleDeviceSharding(jax.devices()[0])
    if _is_typed_key(leaf):
        data = jax.eval_shape(jax.random.key_data, jax.ShapeDtypeStruct(leaf.shape, leaf.dtype))
        if isinstance(leaf, jax.Array):
            sharding = jax.random.key_data(leaf).sharding
        return jax.ShapeDtypeStruct(data.shape, data.dtype, sharding=sharding)
    return jax.ShapeDtypeStruct(tuple(saved.shape), jnp.dtype(saved.dtype), sharding=sharding)


def _revive(leaf: Any, saved: _Leaf, array: Any) -> Any:
    """The leaf in the form that the template has."""
    if saved.value is not None:
        scalar = saved.value == "True" if saved.dtype == "python bool" else _PYTHON[saved.dtype](saved.value)
        if not hasattr(leaf, "dtype"):
            return scalar
        if isinstance(leaf, np.ndarray | np.generic):
            return np.asarray(scalar, leaf.dtype)
        return jax.device_put(jnp.asarray(scalar, leaf.dtype), getattr(leaf, "sharding", None))
    if _is_typed_key(leaf):
        return jax.random.wrap_key_data(array, impl=jax.random.key_impl(jnp.empty((), leaf.dtype)))
    return array


# --- The files ------------------------------------------------------------------------------------------------
def _steps(folder: Path) -> list[int]:
    """Steps of the complete checkpoints."""
    if not folder.is_dir():
        return []
    return [int(entry.name) for entry in folder.iterdir() if entry.name.isdecimal() and (entry / METADATA).is_file()]


def _write(directory: Path, step: int, state: Any, extra: Mapping[str, Any]) -> None:
    """Write the state, and last of all the metadata that vouches for it."""
    leaves = _flatten(state)
    tree = {path: _describe(leaf) for path, leaf in leaves.items()}
    arrays = {
        path: jax.random.key_data(leaf) if _is_typed_key(leaf) else np.asarray(leaf) if _is_numpy(leaf) else leaf
        for path, leaf in leaves.items()
        if tree[path].value is None
    }
    directory.mkdir()
    if arrays:
        with ocp.StandardCheckpointer() as checkpointer:
            checkpointer.save((directory / STATE).absolute(), arrays)
    files = {}
    for path in sorted(directory.rglob("*")):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            files[path.relative_to(directory).as_posix()] = {"bytes": path.stat().st_size, "sha256": digest}
    metadata = {
        "format_version": FORMAT_VERSION,
        "step": step,
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": package_versions(),
        "extra": dict(extra),
        "tree": {path: str(leaf) for path, leaf in tree.items()},
        "files": files,
    }
    with (directory / METADATA).open("w", encoding="utf-8") as file:
        json.dump(metadata, file, indent=1)
        file.flush()
        os.fsync(file.fileno())


def _commit(temporary: Path, final: Path) -> None:
    """Rename a complete save into place; one of the same step steps aside for it."""
    old = final.with_name(f".old-{final.name}")
    if final.exists():
        final.rename(old)
    temporary.rename(final)
    shutil.rmtree(old, ignore_errors=True)
    descriptor = os.open(final.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove(checkpoint: Path) -> None:
    """Remove a checkpoint so that, killed half-way, it is no longer taken for one."""
    doomed = checkpoint.with_name(f".old-{checkpoint.name}")
    shutil.rmtree(doomed, ignore_errors=True)
    checkpoint.rename(doomed)
    shutil.rmtree(doomed)


def _remove_leftovers(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.name.startswith((".new-", ".old-")):
            shutil.rmtree(entry)


def _verify_files(directory: Path, files: Mapping[str, Mapping[str, Any]]) -> None:
    """Raise unless every file is there, as long as it was, and has its checksum."""
    for name, expected in files.items():
        path = directory / name
        if not path.is_file():
            raise CheckpointError(f"{directory} is damaged: {name} is missing; {_advice(directory)}")
        size = path.stat().st_size
        if size != expected["bytes"]:
            raise CheckpointError(
                f"{directory} is damaged: {name} has {size} bytes of {expected['bytes']}; {_advice(directory)}"
            )
        with path.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() != expected["sha256"]:
                raise CheckpointError(f"{directory} is damaged: {name} fails its checksum; {_advice(directory)}")


def _advice(directory: Path) -> str:
    others = [step for step in _steps(directory.parent) if str(step) != directory.name]
    return f"remove that folder to go on from step {max(others)}" if others else "there is no other to go on from"


def _is_numpy(leaf: Any) -> bool:
    return isinstance(leaf, np.ndarray | np.generic)
