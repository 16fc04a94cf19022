import os
import signal
import threading
import time

import pytest

from bp2_rl.base.processes import STOPPING
from bp2_rl.learning.cluster import StopSignals


def handlers():
    descriptor = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(descriptor)
    return descriptor, [signal.getsignal(number) for number in STOPPING]


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals are POSIX's")
@pytest.mark.parametrize(
    ("hangup", "sent", "caught"),
    [
        # only Ctrl-C is impatient
        (signal.SIG_DFL, (signal.SIGTERM, signal.SIGTERM), signal.SIGTERM),
        (signal.SIG_DFL, (signal.SIGHUP, signal.SIGTERM), signal.SIGHUP),
        (signal.SIG_IGN, (signal.SIGHUP, signal.SIGTERM), signal.SIGTERM),
    ],
    ids=["first", "closed terminal", "nohup"],
)
def test_the_first_signal_is_noted_said_and_harmless_and_the_handlers_come_back(
    hangup, sent, caught
):
    first = signal.signal(signal.SIGHUP, hangup)
    try:
        before, said = handlers(), []
        with StopSignals(said.append, lambda: None) as signals:
            assert signals.caught is None
            for number in sent:
                os.kill(os.getpid(), number)
            deadline = time.monotonic() + 10
            while not said and time.monotonic() < deadline:
                time.sleep(0.01)
            assert signals.caught is caught
        assert said == [
            f"{caught.name}: stopping after this train step; Ctrl-C now quits at once"
        ]
        assert handlers() == before
    finally:
        signal.signal(signal.SIGHUP, first)


def test_in_a_thread_of_its_own_a_training_leaves_the_handlers_alone():
    before, seen = handlers(), []

    def train():
        with StopSignals(print, print) as signals:
            seen.extend(
                [signals.caught, [signal.getsignal(number) for number in STOPPING]]
            )

    thread = threading.Thread(target=train)
    thread.start()
    thread.join()
    assert seen == [None, before[1]]
    assert handlers() == before
