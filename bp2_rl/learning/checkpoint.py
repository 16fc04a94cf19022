"""Save and restore a whole training state, bit for bit, so that a killed run goes on
exactly where it was.

    RUN/checkpoints/<step>/state.npz        every array of the state, named by its path: params/policy/...
    RUN/checkpoints/<step>/metadata.json    format, step, versions, config, types and shapes, a checksum of every file
    RUN/failed/<step>/                      the same, of the state that a train step could not leave

A save is made by `folders.new_folder`: a folder named by a step is complete. Where a
save of the same step was killed, every reader finds the one before it; other leftovers
are passed over, and removed by the next save.

With several processes every one calls `host_copy` and `Saver.save` (they gather what
lies on the others' devices), the first writes, and all read: the run's folder is on a
file system that they share.
"""

import contextlib
import dataclasses
import hashlib
from collections.abc import Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import ArraySpec, BadFileError, read_bytes, read_npz, write_npz
from bp2_rl.base.folders import (
    find_folder,
    folder_names,
    new_folder,
    remove_folder,
    tidy,
)
from bp2_rl.base.serialization import (
    ConfigError,
    load_sealed,
    package_versions,
    save_sealed,
    utc_now,
)
from bp2_rl.learning import cluster

FORMAT_VERSION = 3
CHECKPOINTS, FAILED = "checkpoints", "failed"
KEPT = 3
"""Number of checkpoints of a run that are kept."""
METADATA = "metadata.json"
STATE = "state.npz"
CHECKSUM = "metadata_sha256"
"""Key in the metadata for the checksum of all other entries."""

State = TypeVar("State")


class CheckpointError(UserError):
    """Raised for a checkpoint that cannot be written, or that does not fit the training
    it is to resume."""


@dataclasses.dataclass(frozen=True)
class Metadata:
    """The description of a checkpoint, beside its arrays."""

    format_version: int
    step: int
    created: str  # UTC, ISO 8601
    versions: dict[str, str]
    config: dict[str, Any]  # the run's settings, as JSON
    log: dict[str, Any]  # metrics that the run's log had not yet written, as JSON
    tree: dict[str, str]  # type and shape of every array by its name
    files: dict[str, str]  # the SHA-256 of every other file
    devices: str  # that trained the state


# --- Saving ---------------------------------------------------------------------------
def host_copy(state: State) -> State:
    """Return `state` as NumPy arrays of this process's own, whole, even where parts lie
    on devices of other processes.

    All processes must call it together. The copy shares no memory with `state`, which
    may then be donated.
    """

    def gather(leaf: object) -> object:
        if not isinstance(leaf, jax.Array) or leaf.is_fully_addressable:
            return leaf
        if leaf.is_fully_replicated:
            return leaf.addressable_data(0)
        return multihost_utils.process_allgather(leaf, tiled=True)

    return jax.tree.map(np.array, jax.device_get(jax.tree.map(gather, state)))


class Saver:
    """Saves a run's training states in the background, one at a time; a context manager
    that waits for the last.

    Args:
        run_dir: the run's folder; a deleted folder is not created again.
        config: the run's settings, as JSON, to be stored with every checkpoint.
        folder: CHECKPOINTS, or FAILED for a state that is not to be resumed.
    """

    def __init__(
        self, run_dir: Path, config: Mapping[str, object], folder: str = CHECKPOINTS
    ):
        self._folder = Path(run_dir) / folder
        self._config = config
        self._thread = ThreadPoolExecutor(1, "checkpoint")
        self._pending: Future[None] | None = None

    def save(
        self, step: int, state: object, log: Mapping[str, object] | None = None
    ) -> None:
        """Copy `state` to the host, and start to write it; on return `state` may be
        donated.

        Args:
            step: names the checkpoint; one of the same step is replaced, and KEPT up to
                this one remain.
            state: any pytree of JAX or NumPy arrays.
            log: metrics that the run's log has not yet written, as JSON;
                `read_metadata` returns them.

        Raises:
            CheckpointError: the save before this one could not be written; the
                checkpoints before it are still there.
        """
        self.wait()
        copy = host_copy(state)
        if cluster.is_first():
            extra = {
                "config": self._config,
                "log": log or {},
                "devices": cluster.devices(),
            }
            self._pending = self._thread.submit(_save, self._folder, step, copy, extra)

    def wait(self) -> None:
        """Wait until the last save is on disk; raise `CheckpointError` where it could
        not be written."""
        pending = self._pending
        self._pending = None
        if pending is not None:
            pending.result()

    def __enter__(self) -> "Saver":
        """Return the saver."""
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Wait for the last save; raise its failure, unless another exception was
        raised."""
        self._thread.shutdown()
        if kind is None:
            self.wait()


# --- Restoring ------------------------------------------------------------------------
def saved_steps(run_dir: Path, folder: str = CHECKPOINTS) -> list[int]:
    """Return the steps of a run's complete checkpoints, in no order."""
    parent = Path(run_dir) / folder
    names = folder_names(parent) if parent.is_dir() else ()
    return [
        int(name)
        for name in names
        if name.isdecimal() and (find_folder(parent / name) / METADATA).is_file()
    ]


def latest_step(run_dir: Path, folder: str = CHECKPOINTS) -> int | None:
    """Return the newest complete checkpoint's step; None where a run has none."""
    return max(saved_steps(run_dir, folder), default=None)


def restore_checkpoint(
    run_dir: Path,
    template: State,
    step: int | None = None,
    *,
    part: bool = False,
    folder: str = CHECKPOINTS,
) -> tuple[int, State]:
    """Restore a training state from a run's checkpoint.

    Args:
        run_dir: the run's folder.
        template: a pytree like the one saved, of arrays or `jax.ShapeDtypeStruct`s. A
            leaf comes back on its template's sharding (on another number of devices or
            processes, if need be), or as NumPy where the template has none.
        step: which checkpoint; the newest if None.
        part: read only the template's leaves, of a checkpoint that may hold more.
        folder: CHECKPOINTS or FAILED.

    Returns:
        The checkpoint's step and the state.

    Raises:
        CheckpointError: there is none, or it is damaged, of another format, or of
            another training: then the first leaf that differs is named.
    """
    if step is None:
        step = latest_step(run_dir, folder)
        if step is None:
            raise CheckpointError(
                f"no complete checkpoint in {Path(run_dir) / folder}: name another run"
            )
    metadata = read_metadata(run_dir, step, folder)
    directory = find_folder(Path(run_dir) / folder / str(step))
    leaves_wanted = leaves_by_path(template)
    specs = {
        path: ArraySpec(np.dtype(leaf.dtype), tuple(leaf.shape))
        for path, leaf in leaves_wanted.items()
    }
    with _refusing_damage(directory):
        content = read_bytes(directory / STATE)
        if hashlib.sha256(content).hexdigest() != metadata.files[STATE]:
            raise BadFileError(f"{directory / STATE} is damaged: its checksum differs")
        require_same(
            metadata.tree,
            {path: _describe(leaf) for path, leaf in leaves_wanted.items()},
            directory,
            part=part,
        )
        arrays = read_npz(
            directory / STATE, specs, content=content, largest=len(content)
        )
    leaves = [place(arrays[path], leaf) for path, leaf in leaves_wanted.items()]
    return step, jax.tree.unflatten(jax.tree.structure(template), leaves)


def read_metadata(run_dir: Path, step: int, folder: str = CHECKPOINTS) -> Metadata:
    """Read the description of a checkpoint, without its arrays.

    Raises:
        CheckpointError: no such checkpoint, or it is half-written, damaged, foreign or
            of another format.
    """
    directory = find_folder(Path(run_dir) / folder / str(step))
    path = directory / METADATA
    if not directory.is_dir():
        steps = ", ".join(map(str, sorted(saved_steps(run_dir, folder)))) or "none"
        raise CheckpointError(
            f"no checkpoint of step {step} in {directory.parent}; it has: {steps}"
        )
    if not path.exists():
        raise CheckpointError(
            f"{directory} has no {METADATA}: half-written, or not a checkpoint of bp2_rl"
        )
    with _refusing_damage(directory):
        metadata = load_sealed(Metadata, path, CHECKSUM, FORMAT_VERSION)
    if metadata.step != step or STATE not in metadata.files:
        raise CheckpointError(
            f"{path} is damaged: it does not describe the checkpoint of step {step}"
        )
    return metadata


# --- The tree -------------------------------------------------------------------------
def leaves_by_path(tree: object) -> dict[str, Any]:
    """Return a tree's leaves under the names they have in a checkpoint,
    `params/policy/bias`, in its order."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): leaf
        for path, leaf in leaves
    }


def _describe(leaf: Any) -> str:
    """Return the type and shape of an array as text: `float32[8192,47]`."""
    return f"{np.dtype(leaf.dtype).name}[{','.join(map(str, leaf.shape))}]"


def require_same(
    saved: Mapping[str, object],
    wanted: Mapping[str, object],
    directory: Path,
    *,
    part: bool = False,
    where: str = "here",
) -> None:
    """Raise `CheckpointError` unless a checkpoint holds the wanted entries, or more
    with `part`; name the first difference."""
    for name in wanted if part else [*wanted, *saved]:
        in_file, expected = saved.get(name, "absent"), wanted.get(name, "absent")
        if in_file != expected:
            raise CheckpointError(
                f"{directory} is of another training: {name} is {in_file} there and {expected} {where}"
            )


def place(array: np.ndarray, leaf: object) -> Any:
    """Put `array` on the devices of `leaf`, each process its own shards; return it
    unchanged where `leaf` has no sharding."""
    sharding = getattr(leaf, "sharding", None)
    return (
        array
        if sharding is None
        else jax.make_array_from_callback(array.shape, sharding, lambda at: array[at])
    )


# --- The files ------------------------------------------------------------------------
def _save(folder: Path, step: int, state: object, extra: Mapping[str, Any]) -> None:
    """Write a checkpoint, whole or not at all, and remove the oldest."""
    try:
        folder.mkdir(exist_ok=True)
        tidy(folder)
        with new_folder(folder / str(step)) as fresh:
            _write(fresh, step, state, extra)
        for old in sorted(
            s for s in saved_steps(folder.parent, folder.name) if s <= step
        )[:-KEPT]:
            remove_folder(folder / str(old))
    except OSError as error:
        kept = max(saved_steps(folder.parent, folder.name), default=None)
        raise CheckpointError(
            f"cannot save checkpoint {step} in {folder}: {error.strerror or error}; "
            + ("there is none yet" if kept is None else f"the last good one is {kept}")
        ) from error


def _write(directory: Path, step: int, state: object, extra: Mapping[str, Any]) -> None:
    """Write a checkpoint's arrays, and last of all the metadata that vouches for
    them."""
    leaves = leaves_by_path(state)
    path = directory / STATE
    write_npz(path, leaves)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    metadata = Metadata(
        format_version=FORMAT_VERSION,
        step=step,
        created=utc_now(),
        versions=package_versions(),
        tree={path: _describe(leaf) for path, leaf in leaves.items()},
        files={STATE: digest},
        **extra,
    )
    save_sealed(directory / METADATA, metadata, CHECKSUM)


@contextlib.contextmanager
def _refusing_damage(directory: Path) -> Generator[None]:
    """Context manager that turns errors in a checkpoint's files into a
    `CheckpointError`; for damage it says from where the run can go on."""
    try:
        yield
    except BadFileError as error:
        steps = saved_steps(directory.parents[1], directory.parent.name)
        other_steps = [step for step in steps if str(step) != directory.name]
        advice = (
            f"remove that folder to go on from step {max(other_steps)}"
            if other_steps
            else "there is no other to go on from"
        )
        raise CheckpointError(f"{error}; {advice}") from error
    except ConfigError as error:
        raise CheckpointError(str(error)) from error
