"""What came out of a study: each variant over its seeds, and the table of them."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import stats

from bp2_rl.robot import bp2
from bp2_rl.tools.study.measuring import PolicyMeasurement, read_measurements
from bp2_rl.tools.study.plan import VARIANTS, Training

GOAL = bp2.OUTDOOR_TOP_SPEED  # m/s
RESAMPLES = 10_000
BASELINE = "ours"
"""The variant that the others are compared with."""
Stages = tuple[list[PolicyMeasurement], list[PolicyMeasurement]]
"""What was measured of the policies of an imitation run and of the relaxed run after
it."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A variant over its seeds."""

    variant: str
    seeds: tuple[int, ...]  # those that were trained and judged to the end
    top_speeds: tuple[float, ...]  # m/s, of the last policies, by seed
    # m/s, of the policies that the relaxed stage began with
    imitation_top_speeds: tuple[float, ...]
    # control steps of the first saved policy that reaches GOAL
    steps_to_goal: tuple[int | None, ...]
    top_speed: float  # m/s, interquartile mean over seeds
    top_speed_interval: tuple[float, float]  # m/s, bootstrap, 95 %


def outcome(folder: Path, variant: str, seeds: Sequence[int]) -> Outcome | None:
    """A variant's outcome, of those seeds of which both stages were judged; None if
    there is none."""
    stages = both_stages(folder, variant, seeds)
    if not stages:
        return None
    final = np.array([second[-1].top_speed for _, second in stages.values()])
    return Outcome(
        variant=variant,
        seeds=tuple(stages),
        top_speeds=tuple(final.tolist()),
        imitation_top_speeds=tuple(first[-1].top_speed for first, _ in stages.values()),
        steps_to_goal=tuple(
            _steps_to_goal(first + second) for first, second in stages.values()
        ),
        top_speed=float(interquartile_mean(final)),
        top_speed_interval=bootstrap_interval(final),
    )


def both_stages(folder: Path, variant: str, seeds: Sequence[int]) -> dict[int, Stages]:
    """What was measured of a variant's imitation and relaxed runs, by seed, where there
    are both."""
    origin = VARIANTS[variant].imitation or variant
    stages = {
        seed: (
            read_measurements(folder / Training(origin, seed, "imitation").name),
            read_measurements(folder / Training(variant, seed, "relaxed").name),
        )
        for seed in seeds
    }
    return {seed: both for seed, both in stages.items() if all(both)}


def _steps_to_goal(policies: list[PolicyMeasurement]) -> int | None:
    return next(
        (policy.control_steps for policy in policies if policy.top_speed >= GOAL), None
    )


def interquartile_mean(values: Float[np.ndarray, "n ..."]) -> Float[Any, "..."]:
    """Mean of the middle half along the first axis; with fewer than four values, of
    all."""
    return stats.trim_mean(values, 0.25, axis=0)


def bootstrap_interval(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """95 % percentile bootstrap interval of the interquartile mean (Agarwal et al.
    2021)."""
    draws = np.random.default_rng(0).choice(values, (len(values), RESAMPLES))
    low, high = np.percentile(interquartile_mean(draws), [2.5, 97.5])
    return float(low), float(high)


def difference_interval(
    values: Sequence[float], others: Sequence[float]
) -> tuple[float, float]:
    """95 % interval of the difference of two means, by Welch's t-test; infinite where
    the values do not tell how far they scatter."""
    if min(len(values), len(others)) < 2 or len({*values, *others}) < 3:
        return -math.inf, math.inf
    low, high = stats.ttest_ind(values, others, equal_var=False).confidence_interval()
    return float(low), float(high)


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes in Markdown."""
    recipe = next((o.top_speeds for o in outcomes if o.variant == BASELINE), ())
    head = (
        "variant",
        "seeds",
        "top speed [m/s]",
        "95 %",
        f"minus {BASELINE}, 95 %",
        "by seed",
        "after imitation",
        f"M steps to {GOAL} m/s",
    )
    lines = [head, ("---", *("---:",) * (len(head) - 1))]
    for o in outcomes:
        low, high = o.top_speed_interval
        less, more = difference_interval(
            o.top_speeds, () if o.variant == BASELINE else recipe
        )
        lines.append(
            (
                o.variant,
                ", ".join(map(str, o.seeds)),
                f"{o.top_speed:.2f}",
                f"{low:.2f}-{high:.2f}",
                f"{less:+.2f} to {more:+.2f}" if math.isfinite(less + more) else "-",
                _each(o.top_speeds, "{:.2f}"),
                _each(o.imitation_top_speeds, "{:.2f}"),
                _each(
                    [None if s is None else s / 1e6 for s in o.steps_to_goal], "{:.0f}"
                ),
            )
        )
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _each(values: Sequence[float | None], form: str) -> str:
    return ", ".join("-" if value is None else form.format(value) for value in values)
