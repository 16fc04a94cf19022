"""Write files whole or not at all, and check files of unknown origin before they are
used.

Everything that the package keeps is written by these functions, and everything that it
reads back goes through `read_json` and `read_npz`: whatever such a file holds, it ends
in the value wanted or in one line that says what is wrong with it. Folders are in
`folders.py`.
"""

import contextlib
import errno
import io
import json
import math
import os
import re
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from bp2_rl.base.errors import UserError, require_kind

LARGEST_FILE = 4 << 30
LARGEST_TEXT = 64 << 20
"""Size limits, bytes, of a file (`LARGEST_FILE`) and of a JSON file that are read: ours
are far smaller."""
LARGEST_ARRAYS = 1 << 30
"""Size limit, bytes, of the unpacked arrays of an .npz file, unless its reader sets
another."""
DEEPEST = 50
"""Deepest nesting of lists and objects in a JSON value that is read."""


class BadFileError(UserError):
    """Raised for a file that is missing, unreadable, or of wrong content; the message
    begins with the file's path."""


# --- Writing --------------------------------------------------------------------------


@contextlib.contextmanager
def new_file(path: Path | str) -> Generator[IO[bytes]]:
    """Context manager that yields a temporary file, which replaces `path` when the
    block ends, whole and on disk, or not at all.

    Raises:
        OSError: the disk is full, or the folder not ours; what was there before still
            is.
    """
    path = Path(path)
    temporary = _temporary(path, os.getpid())  # another process may write the same file
    try:
        with _open(temporary, "wb") as file:
            yield file
            flush(file)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes to a file, whole or not at all; raises as `new_file`."""
    with new_file(path) as file:
        file.write(content)


def write_text(path: Path, text: str) -> None:
    """Write text in UTF-8, whole or not at all."""
    write_bytes(path, text.encode())


def write_npz(
    path: Path | str, arrays: Mapping[str, Any], *, compressed: bool = False
) -> None:
    """Write named arrays with `np.savez` or `np.savez_compressed`, whole or not at
    all."""
    with new_file(path) as file:
        (np.savez_compressed if compressed else np.savez)(file, **arrays)


def open_in_place(path: Path) -> IO[str]:
    """Open or create a regular file to append UTF-8 text; refuse links, folders,
    devices and pipes.

    Raises:
        BadFileError: it is a link, a folder, a device or a pipe.
        OSError: it cannot be written.
    """
    return _open(path, "a", encoding="utf-8")


def _open(path: Path | str, mode: str, **options: Any) -> IO[Any]:
    """Open a regular file without waiting for a pipe's other end; refuse to write
    through a link."""
    special = _WITHOUT_WAITING if mode == "rb" else _WITHOUT_WAITING | _WITHOUT_LINKS

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | special, 0o666)

    try:
        file = open(path, mode, opener=opener, **options)  # noqa: SIM115
    except OSError as error:
        if what := _NO_FILE.get(error.errno or 0):
            raise BadFileError(f"{path} is {what}") from error
        raise
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise BadFileError(f"{path} is a device or a pipe, not a file")
    return file


_NO_FILE = {
    errno.ELOOP: "a link to elsewhere: remove it",
    errno.EISDIR: "a folder, not a file",
}
_WITHOUT_WAITING, _WITHOUT_LINKS = (
    getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOFOLLOW")
)  # Windows has neither


def _temporary(path: Path, process: int) -> Path:
    return path.with_name(f".{path.name}.{process}.tmp")


def flush(file: IO[Any] | io.IOBase) -> None:
    """Flush an open file, and wait until its content is on disk."""
    file.flush()
    os.fsync(file.fileno())


def sync(path: Path) -> None:
    """Wait until a file's content, or a folder's list of names, is on disk; on Windows
    do nothing."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def require_name(path: Path | str) -> None:
    """Raise `UserError` if no file or folder can have this name, whether it exists or
    not."""
    require_kind(
        "the name of a file or folder",
        path,
        (str, os.PathLike),
        "a text or a Path, such as 'runs/first'",
    )
    try:
        str(path).encode()
        for name in (
            (Path(path), _temporary(Path(path), 10**7)) if Path(path).name else (path,)
        ):
            with contextlib.suppress(
                FileNotFoundError, NotADirectoryError, PermissionError
            ):
                os.stat(name)
    except (OSError, ValueError) as error:  # too long; a NUL; bytes that are not UTF-8
        name = ascii(str(path))
        name = name if len(name) <= 60 else f"{name[:57]}..."
        what = (
            error.strerror
            if isinstance(error, OSError)
            else "it holds a NUL or bytes that are not UTF-8"
        )
        raise UserError(f"no file or folder can be called {name}: {what}") from error


# --- Reading --------------------------------------------------------------------------


def read_bytes(path: Path | str, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a regular file of at most `largest` bytes.

    Raises:
        BadFileError: it is not there, cannot be read, is no regular file, or is larger
            than `largest` bytes.
    """
    try:
        with _open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > largest:
                raise BadFileError(
                    f"{path} has {size:,} bytes, {largest:,} at most are read"
                )
            return file.read(size)
    except BadFileError:
        raise
    except (OSError, ValueError) as error:  # a ValueError: no file can have this name
        raise BadFileError(
            f"{path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error


def read_json(path: Path) -> Any:
    """Return the JSON value that a file holds.

    Raises:
        BadFileError: as `read_bytes` and `parse_json`.
    """
    return parse_json(read_bytes(path, LARGEST_TEXT), str(path))


def parse_json(content: bytes | str, source: str) -> Any:
    """Parse the content of a JSON file, and return its value; messages name the
    `source`.

    Raises:
        BadFileError: it is not JSON in UTF-8, or nested too deeply; `source` stands
            before the line.
    """
    try:
        value = json.loads(content if isinstance(content, str) else content.decode())
        check_values(value)
    except RecursionError as error:
        raise BadFileError(
            f"{source} is not a JSON file of bp2_rl: it is nested too deeply"
        ) from error
    except ValueError as error:  # JSON, UTF-8 and endless integers alike
        raise BadFileError(f"{source} is damaged or not JSON: {error}") from error
    return value


def check_values(value: Any) -> None:
    """Raise RecursionError or ValueError if a JSON or TOML value is nested too deeply
    or holds text that cannot be shown.

    It may be nested too deeply, and a text may hold half a character or what steers a
    terminal.
    """
    level = [value]
    for _ in range(DEEPEST):
        for text in (entry for entry in level if isinstance(entry, str)):
            text.encode()
            if found := _STEERING.search(text):
                raise ValueError(f"a text holds the control character {found[0]!a}")
        inner = [
            (list(entry) + list(entry.values()) if isinstance(entry, dict) else entry)
            for entry in level
            if isinstance(entry, dict | list)
        ]
        level = [entry for entries in inner for entry in entries]
        if not level:
            return
    raise RecursionError


_STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Pattern of control characters except tab and line feed, and of marks that change the
direction of writing."""


class ArraySpec(NamedTuple):
    """The type and the shape that an array of an .npz file must have.

    The type is NumPy's dtype, or a kind of dtypes such as `np.floating`.

    A name in the shape is a size that must be the same wherever it stands; None is any
    size.
    """

    dtype: Any
    shape: tuple[int | str | None, ...]


def read_npz(
    path: Path | str,
    wanted: Mapping[str, ArraySpec],
    *,
    content: bytes | None = None,
    largest: int = LARGEST_ARRAYS,
) -> dict[str, np.ndarray]:
    """Return the arrays `wanted` of an .npz file, and unpack nothing else of the file.

    Names, types, shapes and sizes are compared with the headers before an array is
    read, so that a small file cannot fill the memory.

    Args:
        path: of the file, for its content and for the message.
        wanted: what must be there, by name.
        content: the file's bytes, where they have been read already.
        largest: bytes that the arrays may have together, unpacked.

    Raises:
        BadFileError: the file is missing, damaged, or holds anything else under these
            names.
    """
    content = read_bytes(path) if content is None else content
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {
                entry.filename.removesuffix(".npy"): entry.filename
                for entry in archive.infolist()
                # as NumPy does
                if entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
            }
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
                raise BadFileError(
                    f"{path} holds {total:,} bytes of arrays, {largest:,} at most are read"
                )
            arrays = {}
            for name in wanted:
                with archive.open(members[name]) as member:
                    arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
                    if member.read(1):
                        raise BadFileError(
                            f"{path} is damaged: {name} is longer than it says"
                        )
            return arrays
    except UserError:
        raise
    except _DAMAGE as error:
        raise BadFileError(
            f"{path} is damaged or no .npz file ({type(error).__name__}: {error})"
        ) from error


# What zipfile, zlib and NumPy raise for bytes that are not theirs; found by flipping
# bits of every file we write.
_DAMAGE = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    MemoryError,
    RecursionError,
    NotImplementedError,
    RuntimeError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def _read_header(member: Any) -> tuple[tuple[int, ...], bool, np.dtype]:
    # later ones may have headers of gigabytes
    if (version := np.lib.format.read_magic(member)) != (1, 0):
        raise ValueError(f"array format {version}")
    return np.lib.format.read_array_header_1_0(member)


def _fits(
    dtype: np.dtype, shape: tuple[int, ...], spec: ArraySpec, sizes: dict[str, int]
) -> bool:
    """Return whether an array has the type and the shape of `spec`.

    The sizes that `spec` names are set by their first appearance.
    """
    kind = isinstance(spec.dtype, type) and issubclass(spec.dtype, np.generic)
    right_type = np.issubdtype(dtype, spec.dtype) if kind else dtype == spec.dtype
    if not right_type or dtype.hasobject or len(shape) != len(spec.shape):
        return False
    for size, expected in zip(shape, spec.shape, strict=True):
        limit = (
            sizes.setdefault(expected, size) if isinstance(expected, str) else expected
        )
        if limit is not None and size != limit:
            return False
    return True


def _describe(spec: ArraySpec, sizes: Mapping[str, int]) -> str:
    name = spec.dtype.__name__ if isinstance(spec.dtype, type) else str(spec.dtype)
    shape = [
        sizes.get(size, size)
        if isinstance(size, str)
        else "any"
        if size is None
        else size
        for size in spec.shape
    ]
    return f"{name}[{', '.join(map(str, shape))}]"
