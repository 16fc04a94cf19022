"""Connect the processes of a training on several machines, and let them agree on
decisions such as when to stop.

Every process runs the same program on its own devices, and JAX makes one mesh of them
all. So all must take the same decisions at the same step: what a process has from its
clock, its signals or its disk goes through the functions below first. All must call
these together; with one process they cost nothing.
"""

import contextlib
import hashlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator

import jax
import numpy as np
from jax.experimental import multihost_utils

from bp2_rl.base.errors import UserError
from bp2_rl.base.processes import STOPPING, handling
from bp2_rl.settings.training import ClusterConfig

EXIT_DELAY = 10.0
"""Seconds that a failed process waits for the others to fail too, before it ends
without notice to them."""


def join(config: ClusterConfig) -> None:
    """Connect to the other processes of the training; call before JAX starts a backend.

    If the others do not connect in time, the process ends here, with one line and
    status 2: JAX would abort.

    Raises:
        UserError: no cluster manager has started this process, or the coordinator's
            address is taken or wrong.
    """
    if config.coordinator is None:
        return
    # Its handler would swallow SIGTERM, which is ours to obey.
    jax.config.update("jax_enable_preemption_service", False)
    where = None if config.coordinator == "auto" else config.coordinator
    alone = (
        f"error: not all processes have met at {where or 'the coordinator'} within {config.patience:g} s: start each, "
        "and let them reach that port\n"
    )
    deadline = _leave_after(config.patience, 2, alone)
    try:
        jax.distributed.initialize(
            where,
            config.processes,
            config.process,
            initialization_timeout=int(config.patience) + 60,
        )
    except (RuntimeError, ValueError) as error:
        why = (
            f"this process was not started by Slurm or Open MPI ({error})"
            if where is None
            else f"{where}: {error}"
        )
        raise UserError(f"cannot join the cluster: {why}") from error
    finally:
        deadline.cancel()


def devices() -> str:
    """Return the number and the kind of the devices of all processes."""
    return f"{jax.device_count()} x {jax.devices()[0].device_kind}"


def is_first() -> bool:
    """Return whether this is process 0, the only one that writes files and prints."""
    return jax.process_index() == 0


def require_same(text: str, what: str) -> None:
    """Raise `UserError`, on all processes, unless the text is the same on all; `what`
    names it in the plural."""
    digest = np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8)
    first = multihost_utils.broadcast_one_to_all(digest)
    if largest(not np.array_equal(digest, first)):
        raise UserError(
            f"the processes of the cluster differ in their {what}: give all the same flags and files"
        )


def largest(number: int) -> int:
    """Return the largest of the processes' numbers, on all processes."""
    return (
        number
        if jax.process_count() == 1
        else int(multihost_utils.process_allgather(np.int32(number)).max())
    )


@contextlib.contextmanager
def together() -> Generator[None]:
    """Context manager whose block all processes get through, or none does. The block
    itself must not call the other processes.

    Raises:
        UserError: another process could not; its own line says why.
    """
    try:
        yield
    except Exception:
        largest(1)
        raise
    if largest(0):
        raise UserError("another process of the cluster failed: see its line")


class StopSignals:
    """While open, SIGINT, SIGTERM and SIGHUP only ask training to stop; a SIGINT after
    any quits at once.

    The signals are received while JAX compiles, too, when Python's own handlers must
    wait. A SIGHUP that is ignored, as after `nohup`, stays so. In another thread than
    the main one, where Python allows no handlers, nothing changes. A context manager;
    on exit the handlers are what they were.

    Args:
        say: called with one line at the first signal, from a thread of its own.
        leave: called before quitting at once.
    """

    def __init__(self, say: Callable[[str], None], leave: Callable[[], None]):
        self.caught: signal.Signals | None = None
        self._say, self._leave = say, leave
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "StopSignals":
        """Install handlers for the signals."""
        obeyed = [
            number
            for number in STOPPING
            if number in (signal.SIGINT, signal.SIGTERM)
            or signal.getsignal(number) != signal.SIG_IGN
        ]
        self._open.enter_context(handling(obeyed, lambda *_: None, self._hear))
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the handlers that were there before."""
        self._open.close()

    def received(self) -> signal.Signals | None:
        """Return the signal that this or another process of the cluster has caught; all
        must call at the same step."""
        number = largest(self.caught or 0)
        if number:
            self.caught = signal.Signals(number)
        return self.caught if number else None

    def _hear(self, number: signal.Signals) -> None:
        if self.caught is None:
            self.caught = number
            with contextlib.suppress(
                OSError
            ):  # a full disk must not keep the signal from being handled
                self._say(
                    f"{number.name}: stopping after this train step; Ctrl-C now quits at once"
                )
        elif number is signal.SIGINT:
            self._leave()
            os._exit(128 + number)


def leave(status: int) -> int:
    """Return the exit status of this process; a failed process does not wait long for
    the others, which may be at work.

    They then lose it: on CPUs at once, on GPUs when JAX misses its heartbeat (100 s).
    """
    if status and jax.distributed.is_initialized():
        _leave_after(EXIT_DELAY, status)
    return status


def _leave_after(seconds: float, status: int, line: str = "") -> threading.Timer:
    """Start a timer that ends the process without JAX's farewell to the others."""

    def leave_now() -> None:
        sys.stdout.flush()
        sys.stderr.write(line)
        sys.stderr.flush()
        os._exit(status)

    timer = threading.Timer(seconds, leave_now)
    timer.daemon = True
    timer.start()
    return timer
