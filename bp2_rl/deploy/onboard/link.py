"""Datagrams between the robot and its computer, and a link that loses some and holds
others back.

A datagram is `BP2`, a letter for its kind, its number (uint32), and float64s,
little-endian. Only the newest of a kind
counts: what comes twice, out of order, or from elsewhere is passed over.
"""

import collections
import dataclasses
import random
import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import numpy as np

SENSORS, COMMAND, TARGETS = b"S", b"C", b"T"
SIZES = {SENSORS: 30, COMMAND: 3, TARGETS: 24}
"""Numbers in a datagram of each kind."""
HEADER = struct.Struct("<3scI")
HOST = "127.0.0.1"
Item = TypeVar("Item")


@dataclasses.dataclass(frozen=True)
class Packet:
    """The content of a datagram that has been received."""

    kind: bytes
    values: np.ndarray
    time: float  # s, by `time.monotonic`, when it was read


class Radio:
    """One end of a link over UDP on this machine."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, 0))
        self._socket.setblocking(False)
        self._peer = (HOST, 0)
        self._sent = dict.fromkeys(SIZES, 0)
        self._newest = dict.fromkeys(SIZES, 0)

    @property
    def port(self) -> int:
        """The port at which this end listens."""
        return self._socket.getsockname()[1]

    def connect(self, port: int) -> None:
        """Exchange datagrams with the end that listens at `port`, and with no other."""
        self._peer = (HOST, port)

    def send(self, kind: bytes, values: Sequence[float] | np.ndarray) -> None:
        """Send a datagram without waiting; the link gives no sign of its arrival."""
        self._sent[kind] += 1
        content = (
            HEADER.pack(b"BP2", kind, self._sent[kind])
            + np.asarray(values, "<f8").tobytes()
        )
        try:
            self._socket.sendto(content, self._peer)
        except OSError:  # a full buffer, or nobody there any more: lost, as on any link
            return

    def receive(self) -> list[Packet]:
        """Return the packets that have come since the last call, oldest first."""
        packets = []
        while True:
            try:
                content, sender = self._socket.recvfrom(2048)
            except (BlockingIOError, ConnectionError):
                return packets
            if sender == self._peer and (packet := self._read(content)):
                packets.append(packet)

    def wait(self, seconds: float) -> list[Packet]:
        """Return the packets that have come, and wait at most `seconds` for the first
        one."""
        select.select([self._socket], [], [], max(seconds, 0.0))
        return self.receive()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _read(self, content: bytes) -> Packet | None:
        if len(content) < HEADER.size:
            return None
        magic, kind, number = HEADER.unpack_from(content)
        if (
            magic != b"BP2"
            or kind not in SIZES
            or len(content) != HEADER.size + 8 * SIZES[kind]
        ):
            return None
        if number <= self._newest[kind]:
            return None
        self._newest[kind] = number
        return Packet(
            kind,
            np.frombuffer(content, "<f8", offset=HEADER.size).astype(float),
            time.monotonic(),
        )


class BadLink(Generic[Item]):
    """Loses a share of what is put in, and gives the rest back `late` seconds later, in
    order."""

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
        there: list[Any] = []
        while self._waiting and self._waiting[0][0] <= now + 1e-9:
            there.append(self._waiting.popleft()[1])
        return there
