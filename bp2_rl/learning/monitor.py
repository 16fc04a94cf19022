"""The monitor passes a run's metrics and notes to writers, the console among them; the
log averages them over intervals.

The only place of the learner with side effects besides the checkpoint; nothing here
feeds back into training.
"""

import contextlib
import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Column, Table
from rich.text import Text

from bp2_rl.base.errors import UserError
from bp2_rl.env.metrics import SPEED_BINS
from bp2_rl.learning import guards
from bp2_rl.learning.ppo import NOT_FINITE
from bp2_rl.learning.writers import (
    EventsFile,
    LogFile,
    MetricsFile,
    Record,
    TrackerError,
    Writer,
)
from bp2_rl.robot import conventions
from bp2_rl.settings.ppo import PPOConfig

PLAIN_INTERVAL = 10.0  # s between lines where there is no terminal
WAITING = "waiting for the first step"
RATE = "steps_per_second"  # name of the metric: control steps of all robots


HEADLINES = {
    "reward": "reward {:.3g}",
    "falls": "falls {:.1%}",  # share of the episodes that ended in a fall
    "speed_error": "error {:.2f}",  # m/s
    "curriculum_level": "level {:.2f}",
}
"""Metrics in the progress line."""


class Monitor:
    """Passes a run's metrics and notes to its writers, the console among them; a
    context manager.

    Args:
        run_dir: the run's folder, made if absent; None in a cluster's further
            processes, for which process 0 speaks: nothing is recorded or shown.
        total_steps: where the run will end.
        start_step: where it starts. On resume, metrics logged past it are of work that
            was lost: they are dropped.
        title: stands before the progress bar.
        writers: further ones, beside log.txt, metrics.jsonl, TensorBoard's events and
            the console; closed with the monitor.
        console: where to show it, with the clock for the throughput; standard output by
            default.

    Raises:
        UserError: the run's folder cannot be written.
    """

    def __init__(
        self,
        run_dir: Path | None,
        total_steps: int,
        *,
        start_step: int = 0,
        title: str = "training",
        writers: Sequence[Writer] = (),
        console: Console | None = None,
    ):
        console = console or Console(quiet=run_dir is None)
        self._progress = Progress(console, title, start_step, total_steps)
        self._log = Writer()
        self._writers: list[Writer] = [self._progress]
        if run_dir is None:
            return
        try:
            run_dir.mkdir(parents=True, exist_ok=True)
            self._log = LogFile(run_dir)
            files = MetricsFile(run_dir, start_step), EventsFile(run_dir, start_step)
        except OSError as error:
            raise UserError(
                f"cannot write to run folder {run_dir}: {error.strerror}"
            ) from error
        self._writers = [self._log, *files, *writers, self._progress]

    def __enter__(self) -> "Monitor":
        """Show the progress line."""
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Leave the last state on the console and close the files, also when training
        failed."""
        for writer in reversed(self._writers):  # the progress line first
            # Everything was flushed when it was written; where that failed, so would
            # this.
            with contextlib.suppress(OSError):
                writer.close()

    def release_terminal(self) -> None:
        """Stop the progress line; the cursor is visible again."""
        self._progress.stop()

    def log(
        self, step: int, metrics: Mapping[str, float], *, late: bool = False
    ) -> None:
        """Record the metrics of `step`, by all writers; the console does not show `late`
        ones, of a step that the run has left behind.

        On return they are on disk. Raises `OSError` where that is full or gone.
        """
        values = {name: float(value) for name, value in metrics.items()}
        record = Record(step, round(time.time(), 3), values, late)
        for writer in list(self._writers):
            try:
                writer.write(record)
            except TrackerError as lost:
                self._writers.remove(writer)
                self.note(f"warning: {lost}")

    def show(self, remark: str) -> None:
        """Show a remark below the progress line from now on, in the place of the last
        remark."""
        self._progress.remark = remark

    def note(self, text: str) -> None:
        """Say something once: on the console, and with the time in log.txt."""
        for writer in self._writers:
            writer.note(text)

    def record(self, text: str) -> None:
        """Write a line with the time to log.txt alone; raises `OSError` where the disk
        is full."""
        self._log.note(text)


# --- The averages of an interval -------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Unlogged:
    """Metrics of a logging interval that were not written yet when a checkpoint was
    saved, kept with the checkpoint."""

    count: int = 0  # train steps
    sums: dict[str, float] = dataclasses.field(default_factory=dict)  # of their metrics


class Log:
    """Averages metrics on the device over a logging interval, and writes them one
    interval late.

    So the device never waits for the console, and a line stands for all of its
    interval's steps.

    Args:
        monitor: writes the averages.
        ppo: the learner's settings.
        unlogged: metrics added but not yet written before a resume (`unwritten`); empty
            for a new run.
    """

    def __init__(self, monitor: Monitor, ppo: PPOConfig, unlogged: Unlogged):
        self._monitor, self._ppo = monitor, ppo
        # the signs that the last line showed: each is told once while it lasts
        self._warned: set[str] = set()
        self._interval = Interval(
            {name: np.float32(value) for name, value in unlogged.sums.items()},
            unlogged.count,
        )
        self._pending: tuple[int, Interval] | None = None
        self._since = time.monotonic()  # what is being timed began then
        self.not_finite = False  # a train step was not finite

    def add(self, metrics: dict[str, jax.Array]) -> None:
        """Take in one train step's metrics, which may still be under computation."""
        interval = self._interval
        interval.sums = _add(interval.sums, metrics) if interval.sums else metrics
        interval.count += 1
        interval.timed += 1

    def unwritten(self) -> Unlogged:
        """Return the metrics that were added since the last interval was closed."""
        sums = jax.device_get(self._interval.sums)
        return Unlogged(
            self._interval.count, {name: float(value) for name, value in sums.items()}
        )

    def close(self, done: int) -> None:
        """End the interval with train step `done`, and write the interval before it."""
        self.flush()
        self._pending = (done, self._interval)
        self._interval = Interval()

    def flush(self) -> None:
        """Write the metrics of the interval closed last, and warn of bad signs; write
        nothing from a train step that is not finite on."""
        if self._pending is None or self.not_finite:
            return
        done, interval = self._pending
        self._pending = None
        means = {
            name: float(value) / interval.count
            for name, value in jax.device_get(interval.sums).items()
        }
        self.not_finite = means.pop(NOT_FINITE) > 0
        if self.not_finite:
            return
        per_step = self._ppo.steps_per_train_step
        # To fetch an interval's metrics is to wait for its end, and that of the one
        # before has been waited for.
        now = time.monotonic()
        rate = interval.timed * per_step / (now - self._since)
        self._since = now
        self._monitor.log(done * per_step, summarize(means) | {RATE: rate})
        signs = guards.warnings(means, self._ppo)
        for name in [name for name in signs if name not in self._warned]:
            self._monitor.note(f"warning: {signs[name]}")
        self._warned = set(signs)


@dataclasses.dataclass
class Interval:
    """Metrics of the train steps that become one line of the log."""

    # of their metrics
    sums: Mapping[str, jax.Array | np.float32] = dataclasses.field(default_factory=dict)
    count: int = 0
    timed: int = 0  # those of them that this process did


@jax.jit
def _add(
    a: Mapping[str, jax.Array | np.float32], b: Mapping[str, jax.Array]
) -> dict[str, jax.Array]:
    return jax.tree.map(jnp.add, a, b)


def summarize(metrics: dict[str, float]) -> dict[str, float]:
    """Turn means over robots and steps into metrics that mean something by themselves,
    such as the share of falls.

    Falls become falls a robot a second, falls of all ended episodes become `falls`;
    errors by bin are divided by the bin's share of commands (and left out where nobody
    was commanded so).
    """
    out = {
        name: value for name, value in metrics.items() if not name.startswith("error/")
    }
    ended = metrics["falls"] + metrics["time_outs"]
    out["falls"] = metrics["falls"] / ended if ended > 0 else 0.0
    out["reward_rms"] = out.pop("reward_square") ** 0.5
    out["falls_per_second"] = metrics["falls"] / conventions.CONTROL_STEP
    for lower in SPEED_BINS:
        share = metrics[f"share/{lower:g}"]
        if share > 0:
            out[f"speed_error/{lower:g}"] = metrics[f"error/{lower:g}"] / share
    return out


# --- The console ----------------------------------------------------------------------


class Progress(Writer):
    """Shows on a console how far a run is, and its notes.

    A terminal's lines are kept up to date; elsewhere a line is printed about every ten
    seconds.
    """

    def __init__(self, console: Console, title: str, start_step: int, total_steps: int):
        self._console, self._title = console, title
        self._step, self._total = start_step, total_steps
        self._began = console.get_time()
        self._how_far = self._how_well = ""
        self.remark = ""
        self._printed = ("", "")  # line and remark, where there is no terminal
        self._next_line = -math.inf  # time of the next line there
        self._live = Live(get_renderable=self._draw, console=console)

    def start(self) -> None:
        """Show that the run begins."""
        if self._console.is_terminal and not self._console.quiet:
            self._live.start(refresh=True)
        else:
            self.note(f"{self._title}: {WAITING}")

    def stop(self) -> None:
        """Stop the progress line; the cursor is visible again."""
        self._live.stop()

    def close(self) -> None:
        """Leave the last state on the console."""
        if self._live.is_started:
            self.stop()
        else:
            self._print()

    def write(self, record: Record) -> None:
        """Show the metrics of a step that the run has reached."""
        if record.late:
            return
        now = self._console.get_time()
        self._step = record.step
        parts = [f"{min(self._step / max(self._total, 1), 1.0):4.0%}"]
        parts.append(f"{count(self._step)}/{count(self._total)}")
        if rate := record.metrics.get(RATE):
            parts.append(f"{count(rate)}/s")
        if self._step >= self._total:
            parts.append(f"in {duration(now - self._began)}")
        elif rate:
            parts.append(f"{duration((self._total - self._step) / rate)} left")
        self._how_far = " ".join(parts)
        self._how_well = " ".join(
            words.format(record.metrics[name])
            for name, words in HEADLINES.items()
            if name in record.metrics
        )
        if not self._live.is_started and now >= self._next_line:
            self._print()
            self._next_line = now + PLAIN_INTERVAL

    def note(self, text: str) -> None:
        """Print a line as it is."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _draw(self) -> Group:
        """Return a terminal's lines: how far the run is, how well it does, and the
        remark."""
        bar = ProgressBar(total=max(self._total, 1), completed=self._step)
        first = Table.grid("", Column(ratio=1), "", padding=(0, 1), expand=True)
        first.add_row(self._title, bar, self._how_far)
        waited = duration(self._console.get_time() - self._began)
        lines = (self._how_well or f"{WAITING} ({waited})", self.remark)
        return Group(first, Text("\n".join(lines).rstrip(), style="dim"))

    def _print(self) -> None:
        """Print how far the run is and the remark, each where it is new."""
        lines = (f"{self._how_far} {self._how_well}".rstrip(), self.remark)
        for line, before in zip(lines, self._printed, strict=True):
            if line != before:
                self.note(line)
        self._printed = lines


def count(number: float) -> str:
    """Return a number as text of at most five characters: 950, 12.3k, 4.00M, 1.21G."""
    for limit, unit in ((1e3, ""), (1e6, "k"), (1e9, "M"), (1e12, "G")):
        # A number that would round up to 1000 of a unit is 1.00 of the next.
        scaled = number / (limit / 1e3)
        if scaled < 999.5:
            return (
                f"{scaled:.0f}{unit}"
                if not unit or scaled >= 99.95
                else f"{scaled:.{2 if scaled < 9.995 else 1}f}{unit}"
            )
    return f"{number:.1e}"


def duration(seconds: float) -> str:
    """Return a time span in seconds as text: 0:42, 3:07, 2:15:00, 3d 4h."""
    minutes, second = divmod(max(round(seconds), 0), 60)
    hours, minute = divmod(minutes, 60)
    if hours >= 48:
        return f"{hours // 24}d {hours % 24}h"
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
