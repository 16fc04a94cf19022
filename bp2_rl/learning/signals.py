"""Ctrl-C, the cluster's SIGTERM and a closed terminal's SIGHUP, as a question that the
training loop asks."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable

from bp2_rl.base.processes import STOPPING, listening
from bp2_rl.learning import cluster


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
        """Take over the handlers."""
        if threading.current_thread() is threading.main_thread():
            self._open.enter_context(listening(self._hear))
            for number in STOPPING:
                if (
                    number not in (signal.SIGINT, signal.SIGTERM)
                    and signal.getsignal(number) == signal.SIG_IGN
                ):
                    continue
                self._open.callback(
                    signal.signal, number, signal.signal(number, lambda *_: None)
                )
        return self

    def __exit__(self, *_: object) -> None:
        """Give back the handlers."""
        self._open.close()

    def received(self) -> signal.Signals | None:
        """Return the signal that this or another process of the cluster has caught; all
        must call at the same step."""
        number = cluster.largest(self.caught or 0)
        if number:
            self.caught = signal.Signals(number)
        return self.caught if number else None

    def _hear(self, number: signal.Signals) -> None:
        if self.caught is None and number in STOPPING:
            self.caught = number
            with contextlib.suppress(OSError):  # a full disk must not deafen us
                self._say(
                    f"{number.name}: stopping after this train step; Ctrl-C now quits at once"
                )
        elif number is signal.SIGINT:
            self._leave()
            os._exit(128 + number)
