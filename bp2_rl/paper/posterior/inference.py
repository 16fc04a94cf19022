"""The posterior of BP2's assumed numbers given the paper's results, by Bayes' rule over
simulated robots.

A Gaussian process tells from a robot's place in the ranges what it runs. Robots are
drawn from the ranges, and each is weighted by how well it explains the paper's numbers.
There are few of these numbers, so that draws from the prior suffice: no chain must
converge.
"""

import dataclasses
import warnings
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float, Int

from bp2_rl.base.arrays import Number
from bp2_rl.base.errors import not_installed
from bp2_rl.evaluation.races import TRACK
from bp2_rl.paper.posterior.runs import RobotRun, Shares
from bp2_rl.robot import bp2

try:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import (
        RBF,
        ConstantKernel,
        Kernel,
        WhiteKernel,
    )
    from sklearn.linear_model import LogisticRegression
except ImportError as missing:
    raise not_installed("the posterior", "scikit-learn", "posterior") from missing

RUNS = 6.0  # m/s: a robot whose best second is slower does not run
DARED = 0.8, 1.0
"""Share of the road's best speed that was run outdoors: the paper's speed there may be
what was dared."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """A number of the paper, and how far a right model's number may be from it."""

    unit: str
    printed: float
    error: float  # standard deviation of its logarithm, ASSUMED


EVIDENCE = {
    "belt": Evidence("m/s", bp2.TREADMILL_TOP_SPEED, 0.04),
    # 5 % of the model, and 6 % by which like robots' peaks differ from run to run
    "lesser power": Evidence("W", min(bp2.HIND_PEAK_POWERS), 0.08),
    "road": Evidence("m/s", bp2.OUTDOOR_TOP_SPEED, 0.04),
    "100 m": Evidence("s", bp2.SPRINT_100M_TIME, 0.04),
}
"""The paper's numbers; the greater power is in the range of `corner_power`."""
NAMES = tuple(EVIDENCE)
LEFT_OUT = NAMES[2:]  # by the calibration
ERRORS = np.array([one.error for one in EVIDENCE.values()])
PRINTED = np.log([one.printed for one in EVIDENCE.values()])

Interval = tuple[float, float, float]
"""5 % quantile, median, 95 % quantile."""
Logs = Float[np.ndarray, "N 4"]
"""Logarithms of the numbers in `EVIDENCE`, one row for each robot."""


def logs_of(runs: Iterable[RobotRun]) -> Logs:
    """Return what robots ran; all numbers are NaN for one that fell before it ran."""
    rows = [
        (one.belt, min(one.hip, one.knee), one.road, one.time_100m)
        if one.time_100m > 0.0 and min(one.belt, one.road) > RUNS
        else (np.nan,) * len(NAMES)
        for one in runs
    ]
    return np.log(np.array(rows, float))


class Emulator:
    """Predictions of speeds and powers under one policy, learnt from simulated robots.

    Args:
        shares: of the simulated robots.
        logs: what they ran; NaN: they fell.
        like: an emulator whose kernels are taken instead of fitted.
    """

    def __init__(self, shares: Shares, logs: Logs, like: "Emulator | None" = None):
        ran = ~np.isnan(logs[:, 0])
        self._falls = None
        if not ran.all():
            self._falls = LogisticRegression().fit(shares, ran)
        self._processes: list[GaussianProcessRegressor] = []
        for i, values in enumerate(logs[ran].T):
            process = GaussianProcessRegressor(_kernel(shares), normalize_y=True)
            if like is not None:
                kernel = like._processes[i].kernel_
                process.set_params(kernel=kernel, optimizer=None)
            with warnings.catch_warnings():
                # of a scale at its bound: that assumption changes nothing
                warnings.simplefilter("ignore", ConvergenceWarning)
                self._processes.append(process.fit(shares[ran], values))

    def run_chance(self, shares: Shares) -> Float[np.ndarray, " N"]:
        """Return the chance that robots run without a fall."""
        if self._falls is None:
            return np.ones(len(shares))
        return self._falls.predict_proba(shares)[:, 1]

    def predict(self, shares: Shares) -> tuple[Logs, Logs]:
        """Return what robots run most likely, and the standard deviations of that."""
        columns = [p.predict(shares, return_std=True) for p in self._processes]
        mean, std = zip(*columns, strict=True)
        return np.stack(mean, axis=-1), np.stack(std, axis=-1)


def _kernel(shares: Shares) -> Kernel:
    """Return a smooth function of the places, each with a scale of its own, and noise:
    what a stride more or less changes."""
    scales: Number = np.full(shares.shape[1], 3.0)
    smooth = ConstantKernel(10.0, (1e-2, 1e4)) * RBF(scales, (0.3, 100.0))
    return smooth + WhiteKernel(0.01, (1e-5, 1.0))


@dataclasses.dataclass(frozen=True)
class Draws:
    """Robots drawn from the prior, each under one policy, and what they run."""

    shares: Shares
    policy: Int[np.ndarray, " N"]  # its place in the order of the emulators
    expected: Logs  # mean of what the robot runs, as dared
    std: Logs
    logs: Logs  # drawn, at the robot's best
    dared: Float[np.ndarray, " N"]  # share of the best speed run outdoors
    chance: Float[np.ndarray, " N"]  # that it runs

    @property
    def shown(self) -> Logs:
        """The numbers that the paper would have measured without an error."""
        return as_dared(self.logs, self.dared)


def as_dared(logs: Logs, dared: Float[np.ndarray, " N"]) -> Logs:
    """Return what robots run if they dare a share of their best speed outdoors.

    The 100 m take longer as a launch and a constant speed do.
    """
    best = np.exp(logs[:, 2])
    slower = sprint_time(dared * best) / sprint_time(best)
    same = np.zeros_like(best)
    return logs + np.stack([same, same, np.log(dared), np.log(slower)], axis=-1)


def sprint_time(speed: Number) -> Number:
    """Return the time over 100 m, s, of the paper's launch and then a constant speed,
    m/s."""
    return TRACK / speed + 0.5 * speed / bp2.LAUNCH_ACCELERATION


def draw(
    emulators: Sequence[Emulator], count: int, assumptions: int, seed: int = 0
) -> Draws:
    """Draw robots from the prior, all policies being equally likely."""
    rng = np.random.default_rng(seed)
    shares = rng.uniform(size=(count, assumptions))
    policy = np.arange(count) % len(emulators)
    mean, std = np.empty((2, count, len(NAMES)))
    chance = np.empty(count)
    for i, emulator in enumerate(emulators):
        its = policy == i
        mean[its], std[its] = emulator.predict(shares[its])
        chance[its] = emulator.run_chance(shares[its])
    logs = mean + std * rng.standard_normal(mean.shape)
    dared = rng.uniform(*DARED, count)
    return Draws(shares, policy, as_dared(mean, dared), std, logs, dared, chance)


def weights(
    draws: Draws, measured: Float[np.ndarray, "4"], names: Sequence[str] = NAMES
) -> Float[np.ndarray, " N"]:
    """Return each draw's weight, all together 1, given some of the numbers; the prior's
    without any.

    Args:
        draws: from the prior.
        measured: logarithms of all numbers.
        names: of the numbers that count.
    """
    found = draws.chance * likelihood(draws.expected, measured, names, draws.std)
    return found / found.sum()


def likelihood(
    expected: Logs,
    measured: Float[np.ndarray, "4"],
    names: Sequence[str] = NAMES,
    std: Logs | float = 0.0,
) -> Float[np.ndarray, " N"]:
    """Return the likelihood of measured numbers, 1 where all are as expected.

    Args:
        expected: logarithms of the numbers that should be measured.
        measured: logarithms of the numbers that are.
        names: of the numbers that count.
        std: of what is expected, beside the errors of the paper's numbers.
    """
    spread = np.sqrt(ERRORS**2 + np.square(std))
    each = ERRORS / spread * np.exp(-0.5 * ((measured - expected) / spread) ** 2)
    return np.prod(each[:, np.isin(NAMES, names)], axis=-1)


def effective(weights: Float[np.ndarray, " N"]) -> float:
    """Return how many equally weighted draws know as much (Kish)."""
    return float(np.sum(weights) ** 2 / np.sum(weights**2))


def quantiles(
    values: Float[np.ndarray, " N"], weights: Float[np.ndarray, " N"]
) -> Interval:
    """Return median and 90 % interval of weighted values."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    low, middle, high = np.interp(
        (0.05, 0.5, 0.95), below / weights.sum(), values[order]
    )
    return float(low), float(middle), float(high)
