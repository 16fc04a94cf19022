"""Control of processes: imports, compiled programs, XLA's threads, signals, and
workers.

A worker is a fresh process that does not outlive its parent.
"""

import concurrent.futures
import contextlib
import ctypes
import importlib.util
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
import types
from collections.abc import Callable, Generator, Sequence
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import cast

from bp2_rl.base.errors import UserError

STOPPING = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
)
"""Signals that ask a command to end: Ctrl-C, a scheduler's, and a closed terminal's,
which Windows has not."""
IMPORTED_AT = time.time()
"""Time of this process's imports, s since 1970: a source file written later may differ
from the code that runs."""
PARENT = "BP2_PARENT"
"""Environment variable with the id of the process at whose end a command ends, too."""
NPROC_IS_OURS = "NPROC" not in os.environ
"""True if this package may set NPROC, the number of XLA's threads; else the user or a
parent process has set it."""
_DEVICES = "xla_force_host_platform_device_count"
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
# Windows has no SIGKILL; its SIGTERM ends a process as surely
_AT_ONCE = getattr(signal, "SIGKILL", signal.SIGTERM)


# --- What it imports and how it compiles ----------------------------------------------


@contextlib.contextmanager
def left_out(*names: str) -> Generator[None]:
    """Context manager in which these modules cannot be imported, as if not installed;
    modules imported before stay."""
    unwanted = [name for name in names if name not in sys.modules]
    # None is Python's way to say that a module cannot be imported
    sys.modules.update(dict.fromkeys(unwanted, cast(types.ModuleType, None)))
    try:
        yield
    finally:
        for name in unwanted:
            del sys.modules[name]


@contextlib.contextmanager
def without_gl_library() -> Generator[None]:
    """Context manager that hides the GL library named by MUJOCO_GL from MuJoCo's
    import, here or in a process started meanwhile.

    MuJoCo binds it when imported, and fails if it is not there; only films need one, in
    a process of their own.
    """
    library = os.environ.pop("MUJOCO_GL", None)
    try:
        yield
    finally:
        if library is not None:
            os.environ["MUJOCO_GL"] = library


def cache_folder() -> Path:
    """Return the project's folder for files that can be recreated:
    $BP2_CACHE, else the folder bp2_rl of $XDG_CACHE_HOME or ~/.cache.

    Raises:
        RuntimeError: there is no home.
    """
    return Path(
        os.environ.get("BP2_CACHE")
        or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bp2_rl"
    )


def keep_compiled() -> Path | None:
    """Let JAX keep compiled programs on disk; return the folder for traced programs, or
    None if it cannot be written.

    Both lie in the `cache_folder`. Where JAX has been told a folder before, by
    $JAX_COMPILATION_CACHE_DIR for one, JAX keeps its programs there.
    """
    import jax  # when XLA's threads have been set

    # Without a home or a disk that can be written, only the time of the next
    # compilation is lost.
    with contextlib.suppress(OSError, RuntimeError):
        cache = cache_folder()
        (cache / "jax").mkdir(parents=True, exist_ok=True)
        if jax.config.values["jax_compilation_cache_dir"] is None:
            jax.config.update("jax_compilation_cache_dir", str(cache / "jax"))
        return cache / "programs"
    return None


def processors() -> int:
    """Return the number of processors that this process may use."""
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )


def use_one_xla_thread() -> None:
    """Let XLA compute in one thread where JAX has no accelerator, unless NPROC is set.

    On CPUs XLA can wait for ever in its own thread pool: a batched kernel of MJX (256
    robots on two cores do it) asks the pool for help from inside the pool, which one
    thread cannot. XLA reads NPROC when JAX starts its backend. Trainings in the fused
    kernel take all processors (`use_all_processors`).
    """
    if jax_is_on_cpu():
        os.environ.setdefault("NPROC", "1")


def jax_is_on_cpu() -> bool:
    """Return whether JAX can find no accelerator, without importing JAX."""
    drivers = map(importlib.util.find_spec, ("jax_plugins", "libtpu"))
    return os.environ.get("JAX_PLATFORMS") == "cpu" or not any(drivers)


def use_all_processors() -> None:
    """Make each processor a device of JAX; call after `use_one_xla_thread` and before
    JAX starts its backend."""
    if not NPROC_IS_OURS or os.environ.get("NPROC") != "1":
        return
    os.environ["NPROC"] = str(processors())
    if _DEVICES not in os.environ.get("XLA_FLAGS", ""):
        os.environ["XLA_FLAGS"] = (
            f"{os.environ.get('XLA_FLAGS', '')} --{_DEVICES}={processors()}".strip()
        )


def command_environment() -> dict[str, str]:
    """Return the environment of a subprocess that ends with this process
    (`end_with_caller`) and sets its own number of XLA threads."""
    environment = os.environ | {PARENT: str(os.getpid())}
    if NPROC_IS_OURS:
        environment.pop("NPROC", None)
    return environment


# --- Signals --------------------------------------------------------------------------


@contextlib.contextmanager
def handling(
    numbers: Sequence[signal.Signals],
    answer: Callable[[int, object], None],
    hear: Callable[[signal.Signals], None],
) -> Generator[None]:
    """Take over signals; on exit their handlers are what they were.

    Python runs its handlers between two lines of Python, and so not while XLA compiles.
    In another thread than the main one, where Python allows no handlers, nothing
    changes.

    Args:
        numbers: the signals.
        answer: their handler, in the main thread: it may raise, or only ask.
        hear: called with each of them, at once and from a thread of its own.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ear, mouth = socket.socketpair()
    mouth.setblocking(False)

    def attend() -> None:
        while heard := ear.recv(1):
            if heard[0] in numbers:
                hear(signal.Signals(heard[0]))

    listener = threading.Thread(target=attend, name="signals", daemon=True)
    listener.start()
    descriptor = signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
    handlers = {number: signal.signal(number, answer) for number in numbers}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(descriptor)
        mouth.close()
        listener.join()
        ear.close()


# --- Workers --------------------------------------------------------------------------


@contextlib.contextmanager
def spawned(
    count: int, initializer: Callable[[], None] | None = None, *, abandon: bool = False
) -> Generator[concurrent.futures.ProcessPoolExecutor]:
    """Context manager that yields a pool of `count` spawned processes; each first calls
    `initializer`. Forked ones could hang beside JAX's threads.

    The processes do not run the caller's script again, as spawned ones do: what they
    are given is of this package.

    They are killed when this process ends, however that ends, and leave `STOPPING`
    signals to it. Linux counts the end of the thread that submitted the first tasks for
    that: submit from one that outlives the pool. After an exception, and with `abandon`
    always, they are killed when the block ends, whatever they are at; else that is
    waited for.

    Raises:
        UserError: fewer than one.
    """
    if count < 1:
        raise UserError(f"workers must be at least 1, got {count}")
    others = multiprocessing.active_children()
    # Python's tracker of semaphores, which begins here, is not to hear of a closed
    # terminal
    with _signals_blocked():
        pool = concurrent.futures.ProcessPoolExecutor(
            count,
            mp_context=_SpawnContext(),
            initializer=_begin,
            initargs=(os.getpid(), initializer),
        )
    try:
        yield pool
    except BaseException:
        # first: the pool fails on cancelled tasks of killed processes
        pool.shutdown(wait=False, cancel_futures=True)
        abandon = True
        raise
    finally:
        if abandon:
            for worker in multiprocessing.active_children():
                if worker not in others:
                    worker.kill()
    pool.shutdown()


class _SpawnProcess(SpawnProcess):
    """A spawned process that does not import the caller's main module."""

    def start(self) -> None:
        """Start the process without the caller's main module, without a GL library, and
        with `STOPPING` signals blocked."""
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            with _signals_blocked(), without_gl_library():
                super().start()
        finally:
            sys.modules["__main__"] = main


@contextlib.contextmanager
def _signals_blocked() -> Generator[None]:
    """Context manager that blocks `STOPPING` signals in this process and in processes
    started meanwhile."""
    mask = (
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        if hasattr(signal, "pthread_sigmask")
        else None
    )
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class _SpawnContext(SpawnContext):
    Process = _SpawnProcess


def end_with_parent(parent: int, by: signal.Signals) -> None:
    """Arrange that this process gets the signal `by` when its parent ends, even if
    Python never gets to run.

    Args:
        parent: its process id; where that has ended already, the signal comes now.
        by: SIGKILL to end at once, SIGTERM to end in good order.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(by), 0, 0, 0)
        if os.getppid() != parent:
            os.kill(os.getpid(), by)
    else:
        threading.Thread(
            target=_watch, args=(parent, by), name="parent", daemon=True
        ).start()


def end_with_caller() -> None:
    """Let this command get SIGTERM when the process ends that the environment variable
    `PARENT` names; without it do nothing."""
    parent = os.environ.pop(PARENT, "")
    if parent.isdecimal():
        end_with_parent(int(parent), signal.SIGTERM)


def _begin(parent: int, initializer: Callable[[], None] | None) -> None:
    end_with_parent(parent, _AT_ONCE)
    # A terminal sends these signals to all processes; the parent alone answers them.
    for number in STOPPING:
        signal.signal(number, signal.SIG_IGN)
    if initializer is not None:
        initializer()


def _watch(parent: int, by: signal.Signals) -> None:
    """Poll for the parent's end every second, then signal this process; used where
    Linux's prctl is missing."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os.kill(os.getpid(), by)
