"""A 200 Hz loop around the controller that talks to the rehearsal over UDP, as
`cpp/main.cpp` does. On a robot, put the drives' and the IMU's interface in the place of
the radio.

    python -m onboard.computer FOLDER

It prints its port, or what is wrong with the bundle; when it is ended, a line of JSON
about its ticks.
"""

import collections
import dataclasses
import gc
import json
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .contents import BundleError, Settings
from .controller import DriveTargets, OnboardController
from .link import COMMAND, SENSORS, TARGETS, Radio
from .watchdog import SensorReading

GRACE = 0.001  # s, for which a measurement that is due is waited for
OPERATOR_SILENCE = 0.5  # s, after which the operator counts as silent
RECENT = 720_000  # ticks whose times are kept: an hour's
PATIENCE = 30.0  # s, for which the robot's first measurement is waited for


@dataclasses.dataclass
class Inbox:
    """The newest measurement and command that have been received."""

    measurement: SensorReading | None = None
    command: np.ndarray | None = None
    command_time: float = -np.inf

    def take(self, kind: bytes, values: np.ndarray, time: float) -> None:
        """Store the content of a datagram."""
        if kind == SENSORS:
            q, qd, up, gyro = np.split(values, (12, 24, 27))
            self.measurement = SensorReading(q, qd, up, gyro, time)
        elif kind == COMMAND:
            self.command, self.command_time = values, time

    def tick(self, controller: OnboardController, now: float) -> DriveTargets:
        """Run one tick of the controller with the newest measurement and command."""
        heard = now - self.command_time <= OPERATOR_SILENCE
        return controller.step(self.measurement, self.command if heard else None, now)


def run(
    controller: OnboardController, radio: Radio, over: Callable[[], bool]
) -> Settings:
    """Run the controller for a robot on the radio until it is `over`; return the number
    of ticks of the last hour, their (p50, p99, max) from a measurement to its answer in ms, the fault
    and the limits used."""
    tick = 1.0 / controller.settings["rates"]["policy"]
    inbox, packets = Inbox(), radio.receive()
    ticks: collections.deque[tuple[float, float]] = collections.deque(maxlen=RECENT)
    while not (ticks and over()):
        start, used, now = time.perf_counter(), time.thread_time(), time.monotonic()
        for kind, values in packets:
            inbox.take(kind, values, now)
        targets = inbox.tick(controller, now)
        radio.send(TARGETS, np.concatenate(targets))
        ticks.append((time.perf_counter() - start, time.thread_time() - used))
        # what is there is heard even if this tick took longer than it may
        packets, deadline = radio.receive(), now + tick + GRACE
        while all(kind != SENSORS for kind, _ in packets) and (
            (left := deadline - time.monotonic()) > 0.0
        ):
            packets += radio.receive(left)
    wall, cpu = np.percentile(1e3 * np.array(ticks), (50, 99, 100), axis=0).T
    return {
        "ticks": len(ticks),
        "wall_ms": wall.tolist(),
        "cpu_ms": cpu.tolist(),
        "fault": controller.fault,
        "used": controller.watchdog.used,
    }


def main(folder: Path | str) -> None:
    """Run a bundle's controller for the robot that speaks first, until a signal ends
    it."""
    over, radio = threading.Event(), Radio()
    try:
        controller = OnboardController(folder)
    except BundleError as error:
        print(f"error: {error}")
        sys.exit(2)
    gc.freeze()  # later collections skip all objects that exist now
    print(radio.port, flush=True)
    radio.answer_first(PATIENCE)
    for ends in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ends, lambda *_: over.set())
    print(json.dumps(run(controller, radio, over.is_set)))


if __name__ == "__main__":
    main(sys.argv[1])
