"""Writers record a run's metrics and notes: log.txt, metrics.jsonl, TensorBoard, W&B.

`monitor.Monitor` passes every record and note to each writer; the console is one, too.
"""

import contextlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.files import (
    BadFileError,
    flush,
    open_in_place,
    parse_json,
    read_bytes,
    write_bytes,
)
from bp2_rl.base.processes import left_out
from bp2_rl.base.serialization import save_config, to_json, utc_now
from bp2_rl.settings.tracker import TRACKED, Tracked, Tracker, tracked
from bp2_rl.settings.training import TrainConfig

LOG, METRICS = "log.txt", "metrics.jsonl"
LARGEST_METRICS = 256 << 20
"""Bytes of the largest metrics.jsonl that is read: a hundred times our own."""
PROJECT = "bp2_rl"
"""W&B's project, unless WANDB_PROJECT says otherwise."""
STEP = "step"
"""Name of W&B's x-axis. W&B's own step may not go back, as ours does where a policy is
judged late."""


class Record(NamedTuple):
    """The metrics of a run at one control step."""

    step: int
    wall_time: float  # s since 1970
    metrics: Mapping[str, float]
    late: bool = False  # the run may have left the step behind


class TrackerError(Exception):
    """Raised when a writer fails without which the run can continue; the message gives
    the reason."""


class Writer:
    """Base class of writers, which record a run's metrics and notes; methods that a
    subclass does not override do nothing.

    An `OSError` of a method, where the disk is full or gone, stops the run. After a
    `TrackerError` the run continues without the writer. Only process 0 has writers.
    """

    def write(self, record: Record) -> None:
        """Record the metrics of a control step."""

    def note(self, text: str) -> None:
        """Record a line of text."""

    def close(self) -> None:
        """Close the writer: the run has ended, or has been stopped."""


class LogFile(Writer):
    """Writes log.txt: every note with its time, on disk when `note` returns."""

    def __init__(self, run_dir: Path):
        self._file = open_in_place(run_dir / LOG)

    def note(self, text: str) -> None:
        """See `Writer`."""
        self._file.write(f"{utc_now()} {text}\n")
        self._file.flush()

    def close(self) -> None:
        """See `Writer`."""
        self._file.close()


class MetricsFile(Writer):
    """Writes metrics.jsonl: a line for each record, non-finite numbers as null, on disk
    when `write` returns.

    Args:
        run_dir: the run's folder.
        start_step: where the run goes on. Lines past it are of work that was lost: they
            are dropped. Lines that cannot be read stay.
    """

    def __init__(self, run_dir: Path, start_step: int):
        path = run_dir / METRICS
        if path.exists():
            kept = [
                line + b"\n"
                for line in _lines(path)
                if (_record_of(line) or {"step": 0})["step"] <= start_step
            ]
            write_bytes(path, b"".join(kept))
        self._file = open_in_place(path)

    def write(self, record: Record) -> None:
        """See `Writer`."""
        metrics = {
            name: value if math.isfinite(value) else None
            for name, value in record.metrics.items()
        }
        line = {"step": record.step, "wall_time": record.wall_time, **metrics}
        self._file.write(json.dumps(line, allow_nan=False) + "\n")
        flush(self._file)

    def close(self) -> None:
        """See `Writer`."""
        self._file.close()


class EventsFile(Writer):
    """Writes finite metrics as TensorBoard's scalars in a new file; TensorBoard hides
    what earlier files hold past `start_step`.

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
            start = {"session_log": SessionLog(status=SessionLog.START)}
            for content in ({"file_version": "brain.Event:2"}, start):
                self._writer.write_event(Event(step=start_step + 1, **content))

    def write(self, record: Record) -> None:
        """See `Writer`."""
        for name, value in record.metrics.items():
            if math.isfinite(value):
                summary = self._scalar(name, value)
                self._writer.write_event(
                    self._event(
                        step=record.step, wall_time=record.wall_time, summary=summary
                    )
                )
        self._writer.flush()

    def close(self) -> None:
        """See `Writer`."""
        self._writer.close()


class WandbRun(Writer):
    """Sends metrics to Weights & Biases; WANDB_MODE=offline keeps all on disk for
    `wandb sync`.

    A run that is resumed keeps its name there, and metrics that W&B has already are not
    sent twice.
    """

    def __init__(self, run_dir: Path, config: TrainConfig, had: Tracked | None):
        import wandb

        project = had.place if had else os.environ.get("WANDB_PROJECT", PROJECT)
        self._run = wandb.init(
            project=project,
            dir=os.environ.get("WANDB_DIR", str(run_dir)),
            name=run_dir.resolve().name,
            id=had.run_id if had else None,
            resume="allow" if had else None,
            config=to_json(config),
            settings=wandb.Settings(console="off", silent=True),
        )
        self._run.define_metric("*", step_metric=STEP)
        self.tracked = Tracked("wandb", self._run.id, project)
        lines = read_metrics(run_dir) if had else []
        self._sent = {(line["step"], name) for line in lines for name in line}

    def write(self, record: Record) -> None:
        """See `Writer`."""
        news = {
            name: value
            for name, value in record.metrics.items()
            if (record.step, name) not in self._sent
        }
        try:
            if news:
                self._run.log({STEP: record.step, "wall_time": record.wall_time} | news)
        # no failure of a server may stop a training
        except Exception as error:
            raise TrackerError(
                f"wandb has failed; no more metrics of this run are sent to it: {_line(error)}"
            ) from error

    def close(self) -> None:
        """See `Writer`."""
        with contextlib.suppress(Exception):
            self._run.finish()


def open_tracker(
    tracker: Tracker | None, run_dir: Path, config: TrainConfig
) -> list[Writer]:
    """Return a list with a run's tracker as a writer, new or resumed; an empty list
    without a tracker.

    W&B's own files are kept in the run's folder, unless WANDB_DIR says otherwise.

    Raises:
        UserError: the tracker does not answer, or does not know the user.
    """
    if tracker is None:
        return []
    had = tracked(run_dir)
    try:
        writer = WandbRun(run_dir, config, had)
    except Exception as error:
        raise UserError(f"--track {tracker} does not work: {_line(error)}") from error
    if had is None:
        save_config(run_dir / TRACKED, writer.tracked)
    return [writer]


def _line(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {error}")[:300]


# --- Reading metrics.jsonl ------------------------------------------------------------


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


def _record_of(line: bytes) -> dict[str, Any] | None:
    """Return the step and the metrics in a line; None if it cannot be read."""
    try:
        record = parse_json(line, METRICS)
    except BadFileError:
        return None
    return (
        record if isinstance(record, dict) and type(record.get("step")) is int else None
    )
