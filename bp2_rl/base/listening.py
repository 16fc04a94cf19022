"""Signals that are heard at once."""

import contextlib
import signal
import socket
import threading
from collections.abc import Callable, Generator

STOPPING = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
)
"""Signals that ask a command to end: Ctrl-C, a scheduler's, and a closed terminal's,
which Windows has not."""


@contextlib.contextmanager
def listening(hear: Callable[[signal.Signals], None]) -> Generator[None]:
    """Call `hear` with each signal that a handler in Python waits for, at once and from
    a thread of its own.

    Python runs its handlers between two lines of Python, and so not while XLA compiles.
    To be used in the main thread.
    """
    ear, mouth = socket.socketpair()
    mouth.setblocking(False)

    def attend() -> None:
        while heard := ear.recv(1):
            hear(signal.Signals(heard[0]))

    listener = threading.Thread(target=attend, name="signals", daemon=True)
    listener.start()
    before = signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        mouth.close()
        listener.join()
        ear.close()
