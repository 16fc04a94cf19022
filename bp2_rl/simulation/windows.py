"""Parts of a run: its fastest stretch, its hold, and the part that stands for steady
running."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.simulation.trajectory import Trajectory


class BestWindow(NamedTuple):
    """The fastest stretch of a run."""

    start: float  # s
    speed: float  # m/s, its mean


def window_means(
    values: Float[np.ndarray, " N"], samples: int
) -> Float[np.ndarray, " M"]:
    """Means over every window of so many samples, by its first sample."""
    sums = np.concatenate(([0.0], np.cumsum(values, dtype=np.float64)))
    return (sums[samples:] - sums[:-samples]) / samples


def best_window(run: Trajectory, length: float) -> BestWindow | None:
    """The window of `length` seconds with the highest mean forward speed; None where
    the run is shorter."""
    samples = round(length / run.dt)
    if len(run) < samples:
        return None
    means = window_means(run.ground_velocity[:, 0], samples)
    start = int(np.argmax(means))
    return BestWindow(start=float(run.time[start]), speed=float(means[start]))


def hold_phase(run: Trajectory) -> Trajectory | None:
    """The part under the schedule's last command, if it was run for at least a
    second."""
    held = len(run) * run.dt - run.steady_from
    return (
        run.between(run.steady_from, math.inf) if held >= 1.0 - 0.5 * run.dt else None
    )


def steady_window(run: Trajectory) -> Trajectory:
    """The part that stands for steady running: the hold phase, or else the best second,
    or else all."""
    hold, best = hold_phase(run), best_window(run, 1.0)
    if hold is not None:
        return hold
    return run.between(best.start, best.start + 1.0) if best is not None else run
