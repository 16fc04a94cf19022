"""Where a run's metrics are written: metrics.jsonl and TensorBoard's events, one more
with a tracker (`trackers`)."""

import itertools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from bp2_rl.base.files import (
    BadFileError,
    flush,
    open_in_place,
    parse_json,
    read_bytes,
    write_bytes,
)
from bp2_rl.base.processes import left_out

METRICS = "metrics.jsonl"
LARGEST_METRICS = 256 << 20
"""Bytes of the largest metrics.jsonl that is read: a hundred times our own."""


class TrackerError(Exception):
    """A writer that a run can do without has failed; the line says how."""


@runtime_checkable
class LogWriter(Protocol):
    """Takes a run's metrics down; process 0 alone has any."""

    def write(self, step: int, wall_time: float, metrics: Mapping[str, float]) -> None:
        """Record metrics of control step `step`, which may be one before the last, at
        `wall_time`, s since 1970.

        Raises:
            OSError: the disk is full or gone: the run stops.
            TrackerError: the run goes on without this writer.
        """

    def close(self) -> None:
        """Close the writer: the run has ended, or has been stopped."""


class MetricsFile:
    """metrics.jsonl: a line a call, non-finite numbers as null, on disk when `write`
    returns.

    Args:
        run_dir: the run's folder.
        start_step: where the run goes on. Lines past it are of work that was lost: they
            are dropped.

    `damaged` is the file to which lines that cannot be read were moved, if there were
    any.
    """

    def __init__(self, run_dir: Path, start_step: int):
        self.damaged = _truncate(run_dir / METRICS, start_step)
        self._file = open_in_place(run_dir / METRICS)

    def write(self, step: int, wall_time: float, metrics: Mapping[str, float]) -> None:
        """See `LogWriter`."""
        record = {
            name: value if math.isfinite(value) else None
            for name, value in metrics.items()
        }
        line = {"step": step, "wall_time": wall_time, **record}
        self._file.write(json.dumps(line, allow_nan=False) + "\n")
        flush(self._file)

    def close(self) -> None:
        """See `LogWriter`."""
        self._file.close()


class EventsFile:
    """TensorBoard's finite scalars, in a new file; TensorBoard hides what earlier ones
    hold past `start_step`.

    Not by `SummaryWriter`: it writes in a thread that a full disk ends with a
    traceback, and then waits for it.
    """

    def __init__(self, run_dir: Path, start_step: int):
        # whose import takes seconds; tensorboardX's graphs import it once more
        with left_out("torch"):
            from tensorboardX.event_file_writer import EventsWriter
            from tensorboardX.proto.event_pb2 import Event, SessionLog  # pyright: ignore[reportAttributeAccessIssue]
            from tensorboardX.summary import scalar

        self._event, self._scalar = Event, scalar
        self._writer = EventsWriter(str(run_dir / "events"), f".{start_step}")
        if start_step:
            self._writer.write_event(
                Event(step=start_step + 1, file_version="brain.Event:2")
            )
            self._writer.write_event(
                Event(
                    step=start_step + 1, session_log=SessionLog(status=SessionLog.START)
                )
            )

    def write(self, step: int, wall_time: float, metrics: Mapping[str, float]) -> None:
        """See `LogWriter`."""
        for summary in [
            self._scalar(name, value)
            for name, value in metrics.items()
            if math.isfinite(value)
        ]:
            self._writer.write_event(
                self._event(step=step, wall_time=wall_time, summary=summary)
            )
        self._writer.flush()

    def close(self) -> None:
        """See `LogWriter`."""
        self._writer.close()


def read_metrics(run_dir: Path) -> list[dict[str, Any]]:
    """Return the lines of metrics.jsonl that can be read; none where it is not there.

    Raises:
        BadFileError: it is no file of ours.
    """
    return [
        record
        for line in _lines(run_dir / METRICS)
        if (record := _record_of(line)) is not None
    ]


def _lines(path: Path) -> list[bytes]:
    """Return the whole lines of a metrics file; what a kill has left of a last one has
    no line break."""
    return read_bytes(path, LARGEST_METRICS).split(b"\n")[:-1] if path.exists() else []


def _truncate(path: Path, last_step: int) -> Path | None:
    """Keep the lines of a metrics file that are of steps up to `last_step`; the file of
    those that cannot be read."""
    if not path.exists():
        return None
    kept, damaged = [], []
    for line in _lines(path):
        record = _record_of(line)
        if record is None:
            damaged.append(line)
        elif record["step"] <= last_step:
            kept.append(line)
    aside = None
    if damaged:
        names = (
            path.with_name(f"{path.stem}.damaged-{n}{path.suffix}")
            for n in itertools.count(1)
        )
        aside = next(name for name in names if not name.exists())
        write_bytes(aside, b"".join(line + b"\n" for line in damaged))
    write_bytes(path, b"".join(line + b"\n" for line in kept))
    return aside


def _record_of(line: bytes) -> dict[str, Any] | None:
    """Return the step and the metrics in a line; None if it cannot be read."""
    try:
        record = parse_json(line, METRICS)
    except BadFileError:
        return None
    return (
        record if isinstance(record, dict) and type(record.get("step")) is int else None
    )
