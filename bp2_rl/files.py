"""Files that are whole or not there, folders that belong to one, and strangers' files that are looked at before use.

Everything that the package keeps is written by these functions, and everything that it reads back goes through
`read_json` and `read_npz`: whatever such a file holds, it ends in the value wanted or in one line that says what is
wrong with it.
"""

import contextlib
import fcntl
import io
import json
import math
import os
import shutil
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bp2_rl.errors import UserError

LARGEST_TEXT = 64 << 20
"""Bytes of the largest JSON file that is read: all of ours are far smaller."""
LARGEST_ARRAYS = 1 << 30
"""Bytes that the arrays of one .npz file may have unless the reader says otherwise."""


class BadFileError(UserError):
    """A file that is not there, cannot be read, or does not hold what it should; the line begins with its path."""


# --- Writing -------------------------------------------------------------------------------------------------


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: under another name, to disk, then renamed into place.

    Raises:
        OSError: the disk is full, or the folder not ours; what was there before still is.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def write_text(path: Path, text: str) -> None:
    """The same for text, in UTF-8."""
    write_bytes(path, text.encode())


def write_npz(path: Path, arrays: Mapping[str, Any], *, compressed: bool = False) -> None:
    """The same for named arrays, by `np.savez` or `np.savez_compressed`."""
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    write_bytes(path, buffer.getvalue())


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of `path` when the block ends, whole or not at all.

    Killed at any moment, either the old folder or the new one is there under its name, or the old one is complete
    under `.NAME.old`, from where `restore_folder` brings it back.

    Raises:
        OSError: as `write_bytes`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    restore_folder(path)
    fresh, old = _aside(path, "new"), _aside(path, "old")
    for leftover in (fresh, old):
        if leftover.exists():
            shutil.rmtree(leftover)
    fresh.mkdir()
    try:
        yield fresh
        for file in fresh.iterdir():
            sync(file)
        sync(fresh)
        if path.exists():
            path.rename(old)
        fresh.rename(path)
        sync(path.parent)
    except BaseException:
        restore_folder(path)
        shutil.rmtree(fresh, ignore_errors=True)
        raise
    shutil.rmtree(old, ignore_errors=True)


def restore_folder(path: Path) -> None:
    """Undo what a process left that was killed between the two renames of `new_folder`."""
    old = _aside(Path(path), "old")
    if old.is_dir() and not Path(path).exists():
        old.rename(path)


def sync(path: Path) -> None:
    """Until a file's content, or a folder's names, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _aside(path: Path, kind: str) -> Path:
    return path.with_name(f".{path.name}.{kind}")


# --- Reading -------------------------------------------------------------------------------------------------


def read_bytes(path: Path, largest: int | None = None) -> bytes:
    """A file's content.

    Raises:
        BadFileError: it is not there, cannot be read, or is larger than `largest` bytes.
    """
    path = Path(path)
    try:
        if largest is not None and path.stat().st_size > largest:
            raise BadFileError(f"{path} has {path.stat().st_size:,} bytes, {largest:,} at most are read")
        return path.read_bytes()
    except OSError as error:
        raise BadFileError(f"{path} cannot be read: {error.strerror or error}") from error


def read_json(path: Path) -> Any:
    """The JSON value in a file.

    Raises:
        BadFileError: as `read_bytes`, or it is not JSON, or nested too deeply.
    """
    try:
        return json.loads(read_bytes(path, LARGEST_TEXT).decode())
    except RecursionError as error:
        raise BadFileError(f"{path} is no JSON file of ours: it is nested too deeply") from error
    except UserError:
        raise
    except ValueError as error:  # JSON, UTF-8 and endless integers alike
        raise BadFileError(f"{path} is damaged or not JSON: {error}") from error


class ArraySpec(NamedTuple):
    """What an array of an .npz file must be: NumPy's dtype (or a kind of them, `np.floating`) and a shape.

    A name in the shape is a size that must be the same wherever it stands; None is any size.
    """

    dtype: Any
    shape: tuple[int | str | None, ...]


def read_npz(
    path: Path, wanted: Mapping[str, ArraySpec], *, content: bytes | None = None, largest: int = LARGEST_ARRAYS
) -> dict[str, np.ndarray]:
    """The arrays `wanted` of an .npz file, and nothing else of it: pickles and further arrays are never unpacked.

    Names, types, shapes and sizes are compared with the headers before an array is read, so that a small file cannot
    fill the memory.

    Args:
        path: of the file, for its content and for the message.
        wanted: what must be there, by name.
        content: the file's bytes, where they have been read already.
        largest: bytes that the arrays may have together, unpacked.

    Raises:
        BadFileError: the file is missing, damaged, or holds anything else under these names.
    """
    content = read_bytes(path) if content is None else content
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name.removesuffix(".npy"): name for name in archive.namelist()}
            sizes: dict[str, int] = {}
            total = 0
            for name, spec in wanted.items():
                if name not in members:
                    raise BadFileError(f"{path} lacks the array {name}")
                with archive.open(members[name]) as member:
                    shape, _, dtype = _read_header(member)
                if not _fits(dtype, shape, spec, sizes):
                    raise BadFileError(
                        f"{path} holds {name} as {dtype}{list(shape)}, expected {_describe(spec, sizes)}"
                    )
                total += dtype.itemsize * math.prod(shape)
            if total > largest:
                raise BadFileError(f"{path} holds {total:,} bytes of arrays, {largest:,} at most are read")
            arrays = {}
            for name in wanted:
                with archive.open(members[name]) as member:
                    arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
                    if member.read(1):
                        raise BadFileError(f"{path} is damaged: {name} is longer than it says")
            return arrays
    except UserError:
        raise
    except _DAMAGE as error:
        raise BadFileError(f"{path} is damaged or no .npz file ({type(error).__name__}: {error})") from error


def npz_header(path: Path) -> dict[str, tuple[np.dtype, tuple[int, ...]]]:
    """Type and shape of every array in an .npz file, none of them read; raises as `read_npz`."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path))) as archive:
            found = {}
            for name in archive.namelist():
                with archive.open(name) as member:
                    shape, _, dtype = _read_header(member)
                found[name.removesuffix(".npy")] = (dtype, shape)
            return found
    except UserError:
        raise
    except _DAMAGE as error:
        raise BadFileError(f"{path} is damaged or no .npz file ({type(error).__name__}: {error})") from error


# What zipfile, zlib and NumPy raise for bytes that are not theirs; found by flipping bits of every file we write.
_DAMAGE = (
    OSError, ValueError, EOFError, KeyError, TypeError, AttributeError, OverflowError, MemoryError, RecursionError,
    NotImplementedError, RuntimeError, SyntaxError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def _read_header(member: Any) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(member)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"array format {version}")
    return read(member)


def _fits(dtype: np.dtype, shape: tuple[int, ...], spec: ArraySpec, sizes: dict[str, int]) -> bool:
    """Whether an array is as wanted; the sizes that `spec` names are set by their first appearance."""
    kind = isinstance(spec.dtype, type) and issubclass(spec.dtype, np.generic)
    right_type = np.issubdtype(dtype, spec.dtype) if kind else dtype == spec.dtype
    if not right_type or dtype.hasobject or len(shape) != len(spec.shape):
        return False
    for size, expected in zip(shape, spec.shape, strict=True):
        limit = sizes.setdefault(expected, size) if isinstance(expected, str) else expected
        if limit is not None and size != limit:
            return False
    return True


def _describe(spec: ArraySpec, sizes: Mapping[str, int]) -> str:
    name = spec.dtype.__name__ if isinstance(spec.dtype, type) else str(spec.dtype)
    shape = [sizes.get(size, size) if isinstance(size, str) else "any" if size is None else size for size in spec.shape]
    return f"{name}[{', '.join(map(str, shape))}]"


# --- Folders that are somebody's -----------------------------------------------------------------------------


@contextlib.contextmanager
def lock_folder(folder: Path, busy: str) -> Iterator[int]:
    """Keep other processes from working in an existing folder meanwhile; gives the lock's file descriptor.

    A child that inherits the descriptor (`subprocess.Popen(pass_fds=...)`) holds the lock as well, so that it is not
    free while one of them still works. It ends with the last of them, however that ends.

    Args:
        folder: of the work.
        busy: the line for whoever comes second.

    Raises:
        UserError: another process holds it.
        OSError: the folder cannot be written.
    """
    with (Path(folder) / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(busy) from None
        yield file.fileno()


def make_folder(folder: Path) -> None:
    """Make a folder for results, before anything is computed for it.

    Raises:
        UserError: it cannot be made, or cannot be written.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise UserError(f"cannot write to {folder}: choose another folder")
    except OSError as error:
        raise UserError(f"cannot write to {folder}: {error.strerror or error}; choose another folder") from error
    except ValueError as error:  # a NUL in the name
        raise UserError(f"no folder can be called {str(folder)!r}: {error}") from error
