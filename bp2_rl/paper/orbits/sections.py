"""Measures of a Poincare section's points, and of events that come once a cycle.

The paper's centroid drift D_c* has no printed definition. Here it is

    D_c* = |mean of the last third - mean of the first third| / R,    R^2 = mean |x - mean|^2

As it divides by the points' own scatter, it does not tell a quiet motion from a noisy
one; and n independent points have

    sqrt(E D_c*^2) = sqrt(6 / n)

however small their scatter, as each third's mean has a variance of 3 R^2 / n: .24 for
100 cycles, .071 for 1190. That is its floor: less says nothing, and more that the
points wander.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

CHI_SQUARE_95 = 7.814727903251179
"""Squared Mahalanobis distance below which 95 % of Gaussian points in three dimensions
lie."""
LEAST_POINTS = 6
"""Least number of points of a section whose drift is measured."""
LEAST_EVENTS = 3
"""Least number of events whose jitter is measured."""


@dataclasses.dataclass(frozen=True)
class Drift:
    """How far a section's centre moved from its first third to its last."""

    points: int
    moved: float  # in the points' unit
    scatter: float  # root mean square distance from the mean
    over_scatter: float  # D_c*
    floor: float  # what as many independent points have, root mean square


def centroid_drift(points: Float[np.ndarray, "N D"]) -> Drift:
    """Measure the drift of a section's points, in the order of time.

    Raises:
        ValueError: fewer than `LEAST_POINTS`.
    """
    count = len(points)
    if count < LEAST_POINTS:
        raise ValueError(
            f"a section of {count} points has no drift: it takes {LEAST_POINTS}"
        )
    third = count // 3
    moved = float(
        np.linalg.norm(
            np.mean(points[-third:], axis=0) - np.mean(points[:third], axis=0)
        )
    )
    scatter = float(
        np.sqrt(np.mean(np.sum((points - np.mean(points, axis=0)) ** 2, axis=1)))
    )
    over = moved / scatter if scatter > 0.0 else 0.0
    return Drift(count, moved, scatter, over, math.sqrt(2.0 / third))


@dataclasses.dataclass(frozen=True)
class Inliers:
    """The share of a section's points within the 95 % bound of a Gaussian."""

    share: float  # with a squared Mahalanobis distance below `CHI_SQUARE_95`
    # of the share for as many independent Gaussian points, one standard deviation
    error: float


def inliers(points: Float[np.ndarray, "N 3"], rounds: int = 20) -> Inliers:
    """Measure the share of points near a robust mean, which outliers do not move.

    Mean and covariance are those of the points that are inliers themselves, found by
    repetition from the median and all points' covariance on; a covariance of the inner
    95 % is too small by the factor P(chi^2_5 < c) / .95 (Croux and Haesbroeck 1999),
    which is given back to it.
    """
    squared = mahalanobis(points, np.median(points, axis=0), np.cov(points.T))
    inside = squared <= CHI_SQUARE_95
    for _ in range(rounds):
        within = points[inside]
        if len(within) <= points.shape[1]:
            break
        squared = mahalanobis(
            points, np.mean(within, axis=0), np.cov(within.T) / TRIMMED
        )
        again = squared <= CHI_SQUARE_95
        if np.array_equal(again, inside):
            break
        inside = again
    share = float(np.mean(inside))
    return Inliers(share, math.sqrt(0.95 * 0.05 / len(points)))


# the chi-square distribution of five degrees of freedom there, in closed form
TRIMMED = (
    math.erf(math.sqrt(CHI_SQUARE_95 / 2.0))
    - math.sqrt(2.0 * CHI_SQUARE_95 / math.pi)
    * math.exp(-CHI_SQUARE_95 / 2.0)
    * (1.0 + CHI_SQUARE_95 / 3.0)
) / 0.95
"""Covariance of a three-dimensional Gaussian within its 95 % bound, over the whole
Gaussian's."""


def mahalanobis(
    points: Float[np.ndarray, "N D"],
    mean: Float[np.ndarray, " D"],
    covariance: Float[np.ndarray, "D D"],
) -> Float[np.ndarray, " N"]:
    """Return squared Mahalanobis distances; directions without motion do not count."""
    off = points - mean
    return np.sum(off @ np.linalg.pinv(covariance, hermitian=True) * off, axis=1)


def whole_cycles(clock: Float[np.ndarray, " N"]) -> Float[np.ndarray, " M"]:
    """Return the instants, in samples, at which a clock passes whole cycles."""
    numbers = np.arange(math.ceil(clock[0]), math.floor(clock[-1]) + 1)
    rising = np.maximum.accumulate(clock)
    return np.interp(numbers, rising, np.arange(len(clock)))


def sample(
    signal: Float[np.ndarray, "N ..."], at: Float[np.ndarray, " M"]
) -> Float[np.ndarray, "M ..."]:
    """Interpolate a signal at places between its samples, counted in samples."""
    left = np.clip(np.floor(at).astype(int), 0, len(signal) - 2)
    share = (at - left).reshape(-1, *(1,) * (signal.ndim - 1))
    return (1.0 - share) * signal[left] + share * signal[left + 1]


@dataclasses.dataclass(frozen=True)
class Jitter:
    """Regularity of an event that happens once a cycle: its phase, jitter and
    frequency."""

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
    """Measure phase and jitter of events against a clock, and the spread of their
    frequency.

    Args:
        times: of the events, s.
        phases: of the clock then, cycles; only their fraction counts.
        period: the clock's, s.
        sampling: s; an instant known to one sample is off by sampling / sqrt(12), a
            difference of two by sqrt(2) of that. That is the floor, root mean square
            over periods that end anywhere within a sample.

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
