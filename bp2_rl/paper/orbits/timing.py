"""When events of a cycle come: their jitter against the clock, and how little a
frequency's variability says."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

LEAST_EVENTS = 3


@dataclasses.dataclass(frozen=True)
class Jitter:
    """How regularly an event comes that happens once a cycle."""

    events: int
    phase: float  # cycles, mean place in the clock's cycle, 0 to 1
    jitter: float  # s, standard deviation about it
    # CV_f: standard deviation over mean of the frequency from one event to the next
    variability: float
    # what sampling alone makes of that, where events are known to a sample
    floor: float


def jitter(
    times: Float[np.ndarray, " N"],
    phases: Float[np.ndarray, " N"],
    period: float,
    sampling: float,
) -> Jitter:
    """How events keep time.

    Args:
        times: of the events, s.
        phases: of the clock then, cycles; only their fraction counts.
        period: the clock's, s.
        sampling: s; an instant known to one sample is off by sampling / sqrt(12), a
            difference of two by sqrt(2) of
            that: the floor, root mean square over periods that end anywhere within a
                sample.

    Raises:
        ValueError: fewer than `LEAST_EVENTS`.
    """
    if len(times) < LEAST_EVENTS:
        raise ValueError(f"{len(times)} events have no jitter: it takes {LEAST_EVENTS}")
    mean = float(np.angle(np.mean(np.exp(2j * np.pi * phases)))) / (2.0 * np.pi)
    off = (phases - mean + 0.5) % 1.0 - 0.5
    frequency = 1.0 / np.diff(times)
    return Jitter(
        events=len(times),
        phase=mean % 1.0,
        jitter=float(np.std(off)) * period,
        variability=float(np.std(frequency) / np.mean(frequency)),
        floor=sampling / math.sqrt(6.0) / period,
    )
