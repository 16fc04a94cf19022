"""The return map of a periodic motion: from a state to the state a cycle later, and its
multipliers.

Multipliers are the eigenvalues of the map's derivative at a fixed point. Where all are
smaller than 1, small deviations die out; the largest, the radius, says how fast. Two
estimates that share nothing but the map: differences along each coordinate, and a
linear map fitted to many random deviations. A map with corners (contacts that break and
close) has no derivative on a small scale; the fit then says what deviations of its own
size do in the mean.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Complex, Float

Map = Callable[[Float[np.ndarray, "N D"]], Float[np.ndarray, "N D"]]
"""Many states to those a cycle later; NaN for what did not return."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """after - centre = matrix (before - centre) + offset, by least squares."""

    matrix: Float[np.ndarray, "D D"]
    offset: Float[np.ndarray, " D"]
    unexplained: float  # share of the variance of what came after

    @property
    def radius(self) -> float:
        """Return the spectral radius of the map."""
        return radius(self.matrix)


def multipliers(matrix: Float[np.ndarray, "D D"]) -> Complex[np.ndarray, " D"]:
    """Eigenvalues, the largest first."""
    values = np.linalg.eigvals(matrix).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


def radius(matrix: Float[np.ndarray, "D D"]) -> float:
    """Size of the largest multiplier."""
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def differences(
    step: Map, at: Float[np.ndarray, " D"], width: float | Float[np.ndarray, " D"]
) -> np.ndarray:
    """The map's derivative "D D" at a point by central differences, `width` to either
    side of each coordinate.

    Raises:
        ValueError: a state did not return.
    """
    widths = np.broadcast_to(width, at.shape)
    off = np.diag(widths)
    after = step(np.concatenate([at + off, at - off]))
    if not np.all(np.isfinite(after)):
        raise ValueError("a deviation did not return")
    size = len(at)
    return ((after[:size] - after[size:]) / (2.0 * widths[:, None])).T


def plateau(
    step: Map,
    at: Float[np.ndarray, " D"],
    directions: Float[np.ndarray, "M D"],
    widths: Float[np.ndarray, " W"],
) -> Float[np.ndarray, "W M"]:
    """How differences along some directions depend on their width.

    |d(w) - d(w')| / |d(w')| with w' the next greater width; NaN for the greatest, which
    has none. Rounding makes it grow towards small widths, curvature and corners towards
    great ones; between lies the plateau, if there is one.
    """
    shape = len(widths), *directions.shape
    off = widths[:, None, None] * directions
    states = np.concatenate([at + off, at - off]).reshape(-1, directions.shape[1])
    after = step(states).reshape(2, *shape)
    slope = (after[0] - after[1]) / (2.0 * widths[:, None, None])
    size = np.linalg.norm(slope, axis=-1)
    change = np.full(shape[:2], np.nan)
    change[:-1] = np.linalg.norm(slope[:-1] - slope[1:], axis=-1) / size[1:]
    return change


def fit(
    before: Float[np.ndarray, "N D"],
    after: Float[np.ndarray, "N D"],
    centre: Float[np.ndarray, " D"] | None = None,
) -> Fit:
    """The linear map that takes states to those a cycle later with the least squared
    error.

    Raises:
        ValueError: fewer states than it has unknowns.
    """
    size = before.shape[1]
    if len(before) <= size:
        raise ValueError(
            f"{len(before)} states do not determine a map of {size} coordinates"
        )
    centre = np.zeros(size) if centre is None else centre
    known = np.concatenate([before - centre, np.ones((len(before), 1))], axis=1)
    scale = np.sqrt(np.mean(known**2, axis=0))
    scale[scale == 0.0] = 1.0
    wanted = after - centre
    solution = np.linalg.lstsq(known / scale, wanted, rcond=None)[0] / scale[:, None]
    rest = wanted - known @ solution
    varies = np.var(wanted, axis=0)
    seen = varies > 0.0
    unexplained = (
        float(np.mean(np.mean(rest**2, axis=0)[seen] / varies[seen]))
        if np.any(seen)
        else 0.0
    )
    return Fit(solution[:-1].T, solution[-1], unexplained)


def bootstrap(
    before: Float[np.ndarray, "N D"],
    after: Float[np.ndarray, "N D"],
    draws: int,
    seed: int = 0,
) -> Float[np.ndarray, " draws"]:
    """Radii of maps fitted to the states that the fitted map would give with its
    residuals dealt out anew.

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
    """The basic bootstrap's interval: what draws are above the estimate they are drawn
    from, truth is below it.

    So a bias is taken out: of a radius it is upwards, as noise moves eigenvalues apart.
    """
    low, high = np.quantile(drawn, (0.5 - confidence / 2.0, 0.5 + confidence / 2.0))
    return max(2.0 * estimate - float(high), 0.0), max(2.0 * estimate - float(low), 0.0)
