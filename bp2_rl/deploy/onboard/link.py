"""UDP datagrams between the robot and its computer, and a link model with loss and
delay.

A datagram is a letter for its kind and float64s, little-endian. What is torn or comes
from elsewhere is passed over.
"""

import collections
import random
import select
import socket
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

SENSORS, COMMAND, TARGETS = b"S", b"C", b"T"
SIZES = {SENSORS: 30, COMMAND: 3, TARGETS: 24}
"""Number of values in a datagram of each kind."""
HOST = "127.0.0.1"
Item = TypeVar("Item")
Packet = tuple[bytes, np.ndarray]
"""Kind and values of a datagram."""


class Radio:
    """One end of a link over UDP on this machine."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, 0))
        self._socket.setblocking(False)

    @property
    def port(self) -> int:
        """The port at which this end listens."""
        return self._socket.getsockname()[1]

    def connect(self, port: int) -> None:
        """Exchange datagrams with the end that listens at `port`, and with no other."""
        self._socket.connect((HOST, port))

    def answer_first(self, wait: float) -> None:
        """Wait up to `wait` seconds for the first datagram, and exchange datagrams with
        its sender alone.

        Raises:
            BlockingIOError: no datagram has arrived.
        """
        select.select([self._socket], [], [], wait)
        _, sender = self._socket.recvfrom(1, socket.MSG_PEEK)
        self._socket.connect(sender)

    def send(self, kind: bytes, values: Sequence[float] | np.ndarray) -> None:
        """Send a datagram without waiting; the link gives no sign of its arrival."""
        try:
            self._socket.send(kind + np.asarray(values, "<f8").tobytes())
        except OSError:  # a full buffer, or nobody there any more: lost, as on any link
            return

    def receive(self, wait: float = 0.0) -> list[Packet]:
        """Return the packets received since the last call, oldest first; wait up to
        `wait` seconds for the first."""
        select.select([self._socket], [], [], max(wait, 0.0))
        packets: list[Packet] = []
        while True:
            try:
                content = self._socket.recv(2048)
            except (BlockingIOError, ConnectionError):
                return packets
            kind, numbers = content[:1], content[1:]
            if kind in SIZES and len(numbers) == 8 * SIZES[kind]:
                packets.append((kind, np.frombuffer(numbers, "<f8").astype(float)))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class BadLink(Generic[Item]):
    """A link that loses a share of its items and delivers the others in order, `late`
    seconds later."""

    def __init__(self, loss: float, late: float, seed: int):
        self._loss, self._late, self._random = loss, late, random.Random(seed)
        self._waiting: collections.deque[tuple[float, Item]] = collections.deque()
        self.put_in = self.lost = 0

    def put(self, item: Item, now: float) -> None:
        """Send an item into the link at the time `now`, s."""
        self.put_in += 1
        if self._random.random() < self._loss:
            self.lost += 1
        else:
            self._waiting.append((now + self._late, item))

    def take(self, now: float) -> list[Item]:
        """Return the items that have come through the link by the time `now`, s."""
        there: list[Item] = []
        while self._waiting and self._waiting[0][0] <= now + 1e-9:
            there.append(self._waiting.popleft()[1])
        return there
