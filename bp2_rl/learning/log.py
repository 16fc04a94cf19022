"""The log of a training: metrics averaged over intervals, and what they show in
words."""

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.env.metrics import SPEED_BINS
from bp2_rl.learning import guards
from bp2_rl.learning.monitor import Monitor
from bp2_rl.learning.ppo import NOT_FINITE
from bp2_rl.robot import conventions
from bp2_rl.settings.ppo import PPOConfig


@dataclasses.dataclass(frozen=True)
class Unlogged:
    """The part of a logging interval that a checkpoint falls into, kept with it."""

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
        self._pending, self._interval = (done, self._interval), Interval()

    def flush(self) -> None:
        """Write what has been closed, and warn of what it shows; nothing from a train
        step that is not finite on."""
        if self._pending is None or self.not_finite:
            return
        (done, interval), self._pending = self._pending, None
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
        rate, self._since = interval.timed * per_step / (now - self._since), now
        self._monitor.log(
            done * per_step, summarize(means) | {"steps_per_second": rate}
        )
        signs = guards.warnings(means, self._ppo)
        for name in [name for name in signs if name not in self._warned]:
            self._monitor.note(f"warning: {signs[name]}")
        self._warned = set(signs)


@dataclasses.dataclass
class Interval:
    """Train steps that become one line of the log."""

    sums: dict[str, Any] = dataclasses.field(default_factory=dict)  # of their metrics
    count: int = 0
    timed: int = 0  # those of them that this process did


@jax.jit
def _add(a: dict[str, jax.Array], b: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return jax.tree.map(jnp.add, a, b)


def summarize(metrics: dict[str, float]) -> dict[str, float]:
    """From means over robots and steps to numbers that mean something by themselves.

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
