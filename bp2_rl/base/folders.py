"""Replace folders whole or not at all, and lock folders for one process at a time."""

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Generator
from pathlib import Path
from typing import IO

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import open_in_place, require_name, sync

LOCK = ".lock"
"""Name of the file in a folder that `lock_folder` locks; the file is never removed."""


# --- Replaced whole -------------------------------------------------------------------


@contextlib.contextmanager
def new_folder(path: Path) -> Generator[Path]:
    """Context manager that yields a new folder, which replaces `path` when the block
    ends, whole or not at all.

    Killed at any moment, either the old folder or the new one is there under its name,
    or the old one is complete under `.NAME.old`, where `find_folder` finds it and from
    where `restore_folder` brings it back.

    Raises:
        OSError: as `write_bytes`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    restore_folder(path)
    fresh, old = _aside(path, "new"), _aside(path, "old")
    for leftover in (fresh, old):
        _remove(leftover)
    fresh.mkdir()
    try:
        yield fresh
        for file in fresh.iterdir():
            sync(file)
        sync(fresh)
        if os.path.lexists(path):
            path.rename(old)
        fresh.rename(path)
        sync(path.parent)
    except BaseException:
        restore_folder(path)
        shutil.rmtree(fresh, ignore_errors=True)
        raise
    with contextlib.suppress(OSError):
        _remove(old)


def remove_folder(path: Path) -> None:
    """Remove a folder by renaming it first, so that a kill leaves nothing under its
    name."""
    doomed = _aside(Path(path), "gone")
    Path(path).rename(doomed)
    _remove(doomed)


def find_folder(path: Path) -> Path:
    """Return `path`, or the old folder of that name that a killed `new_folder` has set
    aside."""
    path = Path(path)
    return (
        path
        if path.exists() or not _aside(path, "old").is_dir()
        else _aside(path, "old")
    )


def folder_names(parent: Path) -> set[str]:
    """Return the names of the folders in a folder, old ones that a killed `new_folder`
    has set aside included."""
    names = {entry.name for entry in Path(parent).iterdir() if entry.is_dir()}
    asides = {name: match for name in names if (match := _ASIDE.fullmatch(name))}
    return names - asides.keys() | {
        match[1] for match in asides.values() if match[2] == "old"
    }


def restore_folder(path: Path) -> None:
    """Rename an old folder back if a process was killed between the two renames of
    `new_folder`."""
    old = _aside(Path(path), "old")
    if old.is_dir() and not Path(path).exists():
        old.rename(path)


def tidy(parent: Path) -> None:
    """Restore or remove what killed calls of `new_folder` and `remove_folder` have left
    in a folder."""
    for entry in list(Path(parent).iterdir()):
        match = _ASIDE.fullmatch(entry.name)
        if match and entry.is_dir():
            if match[2] == "old":
                restore_folder(entry.with_name(match[1]))
            _remove(entry)


def _remove(path: Path) -> None:
    """Remove a folder, if it is there; of a link to a folder only the link."""
    if path.is_symlink():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)


def _aside(path: Path, kind: str) -> Path:
    return path.with_name(f".{path.name}.{kind}")


_ASIDE = re.compile(r"\.(.+)\.(new|old|gone)")


# --- Somebody's -----------------------------------------------------------------------


@contextlib.contextmanager
def lock_folder(folder: Path, busy: str) -> Generator[int]:
    """Context manager that locks an existing folder against other processes, and yields
    the lock's file descriptor.

    A child that inherits the descriptor (`subprocess.Popen(pass_fds=...)`) holds the
    lock as well, so that it is not free while one of them still works. It ends with the
    last of them, however that ends.

    Args:
        folder: of the work.
        busy: the line for whoever comes second.

    Where the system or the file system knows no such locks, as Windows and some
    clusters, there is none.

    Raises:
        UserError: another process holds it, or the folder cannot be written.
    """
    try:
        file = open_in_place(Path(folder) / LOCK)
    except OSError as error:
        raise UserError(
            f"cannot write to {folder}: {error.strerror or error}"
        ) from error
    with file:
        _lock(file, busy)
        yield file.fileno()


def _lock(file: IO[str], busy: str) -> None:
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UserError(busy) from None
    except OSError as error:
        if error.errno not in (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK):
            raise


def make_folder(folder: Path) -> None:
    """Create a folder for results, and check that it can be written, before anything is
    computed.

    Raises:
        UserError: it cannot be made, or cannot be written.
    """
    require_name(folder)
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            raise UserError(f"cannot write to {folder}: choose another folder")
    except OSError as error:
        reason = (
            "it is a file, not a folder"
            if isinstance(error, FileExistsError)
            else error.strerror or error
        )
        raise UserError(
            f"cannot write to {folder}: {reason}; choose another folder"
        ) from error


@contextlib.contextmanager
def own_folder(folder: Path) -> Generator[None]:
    """Context manager that creates a folder for results, if need be, and locks it
    against other commands.

    Raises:
        UserError: another one does, or the folder cannot be made or written.
    """
    make_folder(folder)
    with lock_folder(
        folder,
        f"another process works in {folder}: wait for it, or choose another --out",
    ):
        yield


def open_report(folder: Path, mark: str, what: str) -> None:
    """Create a report's folder, or accept the folder of an old report, before anything
    is measured.

    Args:
        folder: what --out names.
        mark: the file by which an old report is known, which may be replaced.
        what: the kind of report, for the message.

    Raises:
        UserError: it cannot be made or written, or holds anything but such a report.
    """
    make_folder(folder)
    if any(folder.iterdir()) and not (folder / mark).is_file():
        raise UserError(
            f"--out {folder} holds other files: name a new or empty folder, or that of an old {what}"
        )
