"""The posterior of what had to be assumed, and a check of its intervals with robots whose
numbers are known."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.evaluation.benchmarks.fleet import show_interval
from bp2_rl.evaluation.plausible import Values, read_assumptions, resample
from bp2_rl.paper.posterior.inference import (
    DARED,
    ERRORS,
    EVIDENCE,
    LEFT_OUT,
    NAMES,
    PRINTED,
    Draws,
    Emulator,
    Interval,
    as_dared,
    draw,
    effective,
    likelihood,
    logs_of,
    quantiles,
    weights,
)
from bp2_rl.paper.posterior.runs import RobotRun, Shares, fill_ranges

RUNS = "plausible/runs.csv"
POLICIES = "built", "gentle"
"""Policies that ship and were trained for the built robot: without and with a price on
hard landings."""
DRAWS = 40_000
LEAST = 32  # robots: fewer than there are assumptions tell nothing
FOLDS, TRUTHS = 5, 200
SEEN = tuple(name for name in NAMES if name not in LEFT_OUT)
SHOWN_PART = 0.25  # of a combination: smaller parts are left out of its description


show_four = partial(show_interval, form=".4g")


@dataclasses.dataclass(frozen=True)
class NumberNumbers:
    """A number of the paper, and what plausible robots run."""

    name: str = metric("Number", form="s")
    unit: str = metric("Unit", form="s")
    printed: float = metric("Paper", form="g")
    prior: Interval = metric("Assumed", form=show_four)
    # from the numbers in `SEEN` alone, the model's error included
    predicted: Interval = metric("By belt and power", form=show_four)
    posterior: Interval = metric("By all four", form=show_four)
    best: Interval = metric("By all four, all dared", form=show_four)
    # of pseudo-truths whose number lies in its interval; None: the number was seen
    coverage: float | None = metric("Coverage", form=".1%", default=None)
    # of the predicted interval over the prior's, median over pseudo-truths
    width: float | None = metric("Width over prior's", form=".0%", default=None)


@dataclasses.dataclass(frozen=True)
class AssumptionNumbers:
    """The range of an assumption, and its posterior within the range."""

    name: str = metric("Assumed", form="s")
    low: float = metric("From", form="g")
    high: float = metric("To", form="g")
    posterior: Interval = metric("Median (90 %)", form=show_four)
    # posterior over prior standard deviation, of the place in the range
    left: float = metric("Left", form=".0%")


@dataclasses.dataclass(frozen=True)
class PosteriorNumbers:
    """All numbers of the posterior."""

    numbers: tuple[NumberNumbers, ...]
    assumptions: tuple[AssumptionNumbers, ...]
    # of the best determined combinations of places: parts by assumption, and what is left
    combinations: tuple[tuple[dict[str, float], float], ...]
    policies: dict[str, float]  # posterior chance that BP2's controller is as this one
    emulator_error: dict[str, float]  # relative, of robots it has not seen
    effective: float  # sample size


@dataclasses.dataclass(frozen=True)
class Fitted:
    """Emulators of all policies, with the runs that they were fitted to."""

    shares: Shares
    logs: dict[str, Float[np.ndarray, "N 4"]]  # by policy
    emulators: tuple[Emulator, ...]


def fit(runs: Sequence[RobotRun], shares: Shares) -> Fitted:
    """Fit an emulator for each policy to the runs of robots at these places."""
    logs = {
        policy: logs_of(run for run in runs if run.policy == policy)
        for policy in POLICIES
    }
    return Fitted(shares, logs, tuple(Emulator(shares, its) for its in logs.values()))


def study_posterior(runs: Sequence[RobotRun], count: int = DRAWS) -> PosteriorNumbers:
    """Compute the posterior from simulated runs, and calibrate it; `count` robots are
    drawn from the prior."""
    assumptions = read_assumptions()
    robots = len(runs) // len(POLICIES)
    found = {policy: [run.policy for run in runs].count(policy) for policy in POLICIES}
    if robots < LEAST or set(found.values()) != {robots}:
        raise UserError(
            f"the posterior needs {LEAST} robots or more, each under {' and '.join(POLICIES)}; got runs of {found}"
        )
    shares = fill_ranges(robots, len(assumptions))
    fitted = fit(runs, shares)
    draws = draw(fitted.emulators, count, len(assumptions))
    prior, seen, full = (weights(draws, PRINTED, names) for names in ((), SEEN, NAMES))
    shown, noisy = draws.shown, measured(draws)
    checks = calibrate(fitted, count)
    numbers = tuple(
        NumberNumbers(
            name,
            one.unit,
            one.printed,
            prior=_spread(shown[:, i], prior),
            predicted=_spread(noisy[:, i], seen),
            posterior=_spread(shown[:, i], full),
            best=_spread(draws.logs[:, i], full),
            **(checks.of(name) if name in LEFT_OUT else {}),
        )
        for i, (name, one) in enumerate(EVIDENCE.items())
    )
    return PosteriorNumbers(
        numbers,
        tuple(
            AssumptionNumbers(
                name,
                *one.range,
                quantiles(one.at(draws.shares[:, i]), full),
                float(np.sqrt(12.0 * np.cov(draws.shares[:, i], aweights=full))),
            )
            for i, (name, one) in enumerate(assumptions.items())
        ),
        combinations=leading(draws, full, tuple(assumptions)),
        policies={
            name: float(full[draws.policy == i].sum())
            for i, name in enumerate(POLICIES)
        },
        emulator_error=dict(zip(NAMES, map(float, checks.error), strict=True)),
        effective=effective(full),
    )


def _spread(logs: Float[np.ndarray, " N"], by: Float[np.ndarray, " N"]) -> Interval:
    return quantiles(np.exp(logs), by)


def measured(draws: Draws, seed: int = 1) -> Float[np.ndarray, "N 4"]:
    """Return what the paper would have measured of the draws, the model's error
    included."""
    noise = np.random.default_rng(seed).standard_normal(draws.logs.shape)
    return draws.shown + ERRORS * noise


def leading(
    draws: Draws, by: Float[np.ndarray, " N"], names: Sequence[str], count: int = 3
) -> tuple[tuple[dict[str, float], float], ...]:
    """Return the best determined combinations of places, each with its posterior
    standard deviation over the prior's."""
    spread, vectors = np.linalg.eigh(12.0 * np.cov(draws.shares.T, aweights=by))
    found = []
    for left, vector in zip(spread[:count], vectors.T, strict=False):
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        order = np.argsort(-np.abs(vector))
        parts = {
            names[i]: float(vector[i]) for i in order if abs(vector[i]) >= SHOWN_PART
        }
        found.append((parts, float(np.sqrt(left))))
    return tuple(found)


# --- Calibration ----------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Checks:
    """How the intervals of numbers that were left out fare with simulated robots as
    truths."""

    inside: dict[str, list[bool]]
    widths: dict[str, list[float]]  # over the prior's
    error: Float[np.ndarray, "4"]  # RMS, of the emulators' logarithms

    def of(self, name: str) -> dict[str, float]:
        """Return the coverage and the median width of a number's intervals."""
        return {
            "coverage": float(np.mean(self.inside[name])),
            "width": float(np.median(self.widths[name])),
        }


def calibrate(
    fitted: Fitted, count: int, truths: int = TRUTHS, seed: int = 2
) -> Checks:
    """Predict the left-out numbers of simulated robots from their other numbers.

    Each truth is a simulated run, with an error of the model drawn on top. The emulators
    that predict the truth's numbers have not seen the truth's robot.
    """
    rng = np.random.default_rng(seed)
    robots = len(fitted.shares)
    ran = [
        (policy, robot)
        for policy, logs in fitted.logs.items()
        for robot in range(robots)
        if not np.isnan(logs[robot, 0])
    ]
    chosen = [ran[i] for i in rng.permutation(len(ran))[:truths]]
    inside: dict[str, list[bool]] = {name: [] for name in LEFT_OUT}
    widths: dict[str, list[float]] = {name: [] for name in LEFT_OUT}
    errors = []
    for fold in range(FOLDS):
        seen = np.arange(robots) % FOLDS != fold
        emulators = [
            Emulator(fitted.shares[seen], logs[seen], like)
            for logs, like in zip(fitted.logs.values(), fitted.emulators, strict=True)
        ]
        for emulator, logs in zip(emulators, fitted.logs.values(), strict=True):
            errors.append(emulator.predict(fitted.shares[~seen])[0] - logs[~seen])
        draws = draw(emulators, count, fitted.shares.shape[1], seed=fold)
        numbers = dict(zip(NAMES, measured(draws).T, strict=True))
        prior = weights(draws, PRINTED, ())
        priors = {name: quantiles(numbers[name], prior) for name in LEFT_OUT}
        for policy, robot in chosen:
            if robot % FOLDS != fold:
                continue
            logs = fitted.logs[policy][robot][None]
            truth = as_dared(logs, rng.uniform(*DARED, 1))[0]
            truth = truth + ERRORS * rng.standard_normal(len(NAMES))
            by = weights(draws, truth, SEEN)
            for name in LEFT_OUT:
                low, _, high = quantiles(numbers[name], by)
                least, _, most = priors[name]
                inside[name].append(bool(low <= truth[NAMES.index(name)] <= high))
                widths[name].append((high - low) / (most - least))
    return Checks(
        inside, widths, np.sqrt(np.nanmean(np.concatenate(errors) ** 2, axis=0))
    )


# --- The robots that ship -------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Chosen:
    """Draws that are simulated again, as the emulators may be wrong."""

    shares: Shares
    policies: list[str]
    dared: Float[np.ndarray, " N"]
    emulated: Float[np.ndarray, " N"]  # likelihood of the emulators' numbers


def choose(fitted: Fitted, count: int, seed: int = 0) -> Chosen:
    """Choose draws from the posterior, each as often as its weight says."""
    draws = draw(fitted.emulators, DRAWS, fitted.shares.shape[1])
    at = resample(weights(draws, PRINTED), count)
    at = np.random.default_rng(seed).permutation(at)
    return Chosen(
        draws.shares[at],
        [POLICIES[i] for i in draws.policy[at]],
        draws.dared[at],
        likelihood(draws.expected[at], PRINTED, std=draws.std[at]),
    )


def weigh_again(
    chosen: Chosen, robots: Sequence[Values], runs: Sequence[RobotRun]
) -> list[dict[str, float | str]]:
    """Return rows of the file that ships: each robot's values, its weight now that
    it was simulated, and what it ran."""
    logs = as_dared(logs_of(runs), chosen.dared)
    again = np.nan_to_num(likelihood(logs, PRINTED)) / chosen.emulated
    again /= again.mean()
    return [
        {**values, "weight": float(weight), **dataclasses.asdict(run)}
        for values, run, weight in zip(robots, runs, again, strict=True)
    ]
