"""The return map of a periodic motion, from a state to the state a cycle later.

Multipliers are the eigenvalues of the map's derivative at a fixed point. Where all are
smaller than 1, small deviations die out; the largest, the radius, says how fast. A map
with corners (contacts that break and close) has no derivative on a small scale; a
linear map fitted to many deviations says what those of their size do in the mean.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class Fit:
    """The linear map after = matrix before + offset, by least squares."""

    matrix: Float[np.ndarray, "D D"]
    offset: Float[np.ndarray, " D"]
    unexplained: float  # share of the variance of what came after

    @property
    def radius(self) -> float:
        """Return the spectral radius of the map."""
        return radius(self.matrix)


def radius(matrix: Float[np.ndarray, "D D"]) -> float:
    """Return the spectral radius of a map's matrix: its largest multiplier in
    magnitude."""
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def fit(before: Float[np.ndarray, "N D"], after: Float[np.ndarray, "N D"]) -> Fit:
    """Fit the linear map from states to those a cycle later by least squares.

    Raises:
        ValueError: fewer states than the map has unknowns.
    """
    size = before.shape[1]
    if len(before) <= size:
        raise ValueError(
            f"{len(before)} states do not determine a map of {size} coordinates"
        )
    known = np.concatenate([before, np.ones((len(before), 1))], axis=1)
    scale = np.sqrt(np.mean(known**2, axis=0))
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(known / scale, after, rcond=None)[0] / scale[:, None]
    varies = np.var(after, axis=0)
    rest = np.mean((after - known @ solution) ** 2, axis=0)
    shares = rest[varies > 0.0] / varies[varies > 0.0]
    unexplained = float(np.mean(shares)) if len(shares) else 0.0
    return Fit(solution[:-1].T, solution[-1], unexplained)


def bootstrap(
    before: Float[np.ndarray, "N D"],
    after: Float[np.ndarray, "N D"],
    draws: int,
    seed: int = 0,
) -> Float[np.ndarray, " draws"]:
    """Return bootstrap samples of the map's spectral radius: fits to resampled
    residuals.

    States before stay: drawn with replacement, hardly more different ones than
    coordinates would remain. Residuals are enlarged by sqrt(N / (N - D - 1)), as a fit
    takes up some of them.
    """
    rng, (count, size) = np.random.default_rng(seed), before.shape
    found = fit(before, after)
    expected = before @ found.matrix.T + found.offset
    residual = (after - expected) * math.sqrt(count / (count - size - 1.0))
    known = np.concatenate([before, np.ones((count, 1))], axis=1)
    solve = np.linalg.pinv(known)
    drawn = (expected + residual[rng.integers(count, size=count)] for _ in range(draws))
    return np.array([radius((solve @ states)[:size].T) for states in drawn])


def interval(
    estimate: float, drawn: Float[np.ndarray, " N"], confidence: float = 0.95
) -> tuple[float, float]:
    """Return the basic bootstrap's confidence interval of an estimate.

    Truth lies below the estimate as far as draws lie above it.

    So a bias is taken out: of a radius it is upwards, as noise moves eigenvalues apart.
    """
    low, high = np.quantile(drawn, (0.5 - confidence / 2.0, 0.5 + confidence / 2.0))
    return max(2.0 * estimate - float(high), 0.0), max(2.0 * estimate - float(low), 0.0)
