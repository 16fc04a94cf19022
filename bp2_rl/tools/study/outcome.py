"""Measure a study's policies in C MuJoCo, and compare the variants of the training over
seeds.

The comparison is a table and two figures.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy import stats

from bp2_rl.base.folders import folder_names
from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.env.observations import layout_of
from bp2_rl.evaluation.judge import JUDGED_LAUNCHES, measure_launches
from bp2_rl.learning.exports import POLICIES
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.robot import bp2, conventions
from bp2_rl.settings.task import TaskSources
from bp2_rl.tools.study.plan import VARIANTS, Training, variant_named

MEASURED = "measured.json"
# commands under which a policy is launched, shares of the training's fastest
LADDER = (1.0, 0.8, 0.6)
GOAL = bp2.OUTDOOR_TOP_SPEED  # m/s
RESAMPLES = 10_000
BASELINE = "ours"
"""The variant that the others are compared with."""
COLORS = ("#0072B2", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#000000")
LINES = ("-", (0, (4, 1.5)), (0, (1, 1)))
STYLES = dict(
    zip(
        VARIANTS,
        itertools.islice(itertools.product(LINES, COLORS), len(VARIANTS)),
        strict=True,
    )
)
"""Line style and colour of each variant, the same in every figure."""


@dataclasses.dataclass(frozen=True)
class PolicyMeasurement:
    """The top speed of a saved policy in C MuJoCo, from a standing start."""

    control_steps: int  # of all its training, the stages before included
    weights_sha256: str  # of the policy
    top_speed: float  # m/s, best of the launches under LADDER; 0 if all fell
    falls: int  # launches that ended in a fall


@dataclasses.dataclass(frozen=True)
class _Measured:
    """The content of the file of measurements beside a run's policies."""

    ladder: tuple[float, ...]
    policies: tuple[PolicyMeasurement, ...]


def measure_policies(
    run_dir: Path, task: TaskSources | None = None
) -> list[PolicyMeasurement]:
    """Measure the top speeds of a run's saved policies, trained with this task, and
    write them to `MEASURED`; reuse earlier results.

    Raises:
        UserError: the task is another.
    """
    known = {
        measurement.weights_sha256: measurement
        for measurement in read_measurements(run_dir)
    }
    result: list[PolicyMeasurement] = []
    names = (name for name in folder_names(run_dir / POLICIES) if name.isdecimal())
    for name in sorted(names, key=int):
        folder = run_dir / POLICIES / name
        policy = load_policy(folder, layout_of=layout_of, task=task)
        result.append(known.get(policy.card.weights_sha256) or _measure(policy))
    save_config(run_dir / MEASURED, _Measured(LADDER, tuple(result)))
    return result


def read_measurements(run_dir: Path) -> list[PolicyMeasurement]:
    """Return the measurements that `measure_policies` wrote for a run; empty if there
    are none."""
    path = run_dir / MEASURED
    if not path.is_file():
        return []
    measured = load_config(_Measured, path)
    return list(measured.policies) if measured.ladder == LADDER else []


def _measure(policy: Policy) -> PolicyMeasurement:
    env = policy.card.env
    best = 0.0
    falls = 0
    for share in LADDER:
        if best >= share * env.commands.max_forward:
            break  # a slower command makes no faster run
        asked = dataclasses.replace(JUDGED_LAUNCHES[0], share=share, noise_seed=None)
        [launch] = measure_launches(policy, env, [asked])
        falls += launch.fell
        best = max(best, launch.best_speed)
    return PolicyMeasurement(
        control_steps=policy.card.physics_steps // conventions.SUBSTEPS,
        weights_sha256=policy.card.weights_sha256,
        top_speed=best,
        falls=falls,
    )


# --- Over the seeds -------------------------------------------------------------------

Stages = tuple[list[PolicyMeasurement], list[PolicyMeasurement]]
"""Measurements of the policies of an imitation run, and of the relaxed run that
follows."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """The top speeds of a variant over its seeds, with their mean and interval."""

    variant: str
    seeds: tuple[int, ...]  # those that were trained and judged to the end
    top_speeds: tuple[float, ...]  # m/s, of the last policies, by seed
    # m/s, of the policies that the relaxed stage began with
    imitation_top_speeds: tuple[float, ...]
    # control steps of the first saved policy that reaches GOAL
    steps_to_goal: tuple[int | None, ...]
    top_speed: float  # m/s, interquartile mean over seeds
    top_speed_interval: tuple[float, float]  # m/s, bootstrap, 95 %


def outcome_of(folder: Path, variant: str, seeds: Sequence[int]) -> Outcome | None:
    """Return a variant's outcome over the seeds whose two stages were measured; None
    without any."""
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
    """Return the measurements of a variant's imitation and relaxed runs, by seed, where
    both exist."""
    origin = variant_named(variant).imitation or variant
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


def interquartile_mean(
    values: Float[np.ndarray, "n ..."],
) -> Float[np.ndarray | np.floating, "..."]:
    """Return the mean of the middle half of the values along the first axis; of all if
    fewer than four."""
    return stats.trim_mean(values, 0.25, axis=0)


def bootstrap_interval(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the interquartile mean (Agarwal
    et al. 2021)."""
    draws = np.random.default_rng(0).choice(values, (len(values), RESAMPLES))
    low, high = np.percentile(interquartile_mean(draws), [2.5, 97.5])
    return float(low), float(high)


def difference_interval(
    values: Sequence[float], others: Sequence[float]
) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two means (Welch's t-test);
    infinite if it is undefined."""
    if min(len(values), len(others)) < 2 or len({*values, *others}) < 3:
        return -math.inf, math.inf
    low, high = stats.ttest_ind(values, others, equal_var=False).confidence_interval()
    return float(low), float(high)


def outcome_table(outcomes: Sequence[Outcome]) -> str:
    """Return the outcomes of a study's variants as a Markdown table."""
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


# --- In pictures ----------------------------------------------------------------------


@styled
def draw_learning_curves(
    folder: Path, variants: Sequence[str], seeds: Sequence[int]
) -> Figure:
    """Draw top speed in C MuJoCo over control steps: interquartile mean and range over
    seeds, for each variant."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    for place, variant in enumerate(variants):
        stages = both_stages(folder, variant, seeds).values()
        if not stages:
            continue
        first, second = (_curve(runs) for runs in zip(*stages, strict=True))
        steps, speeds = (
            np.concatenate(parts, axis=-1) for parts in zip(first, second, strict=True)
        )
        axes.axvline(
            first[0][-1] / 1e6,
            color=QUIET,
            linewidth=0.8,
            linestyle=(0, (2, 2)),
            zorder=1,
        )
        if variant_named(
            variant
        ).imitation:  # the variant they are borrowed from shows them
            steps, speeds = steps[len(first[0]) - 1 :], speeds[:, len(first[0]) - 1 :]
        line, color = STYLES.get(variant, ("-.", COLORS[place % len(COLORS)]))
        middle = interquartile_mean(speeds)
        axes.plot(
            steps / 1e6,
            middle,
            ls=line,
            color=color,
            marker="o",
            ms=3,
            label=variant_named(variant).meaning,
        )
        low, high = speeds.min(axis=0), speeds.max(axis=0)
        axes.fill_between(steps / 1e6, low, high, color=color, alpha=0.15, linewidth=0)
    label = f"BP2: {GOAL} m/s"
    axes.axhline(GOAL, label=label, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.set(
        xlabel="Control steps [M]; dotted: where the relaxed stage begins",
        ylabel="Top speed [m/s]",
        title="Top speed of the saved policies in C MuJoCo, 0 where they fall",
        xlim=(0, None),
        ylim=(0, None),
    )
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


def _curve(
    runs: Sequence[Sequence[PolicyMeasurement]],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the control steps of a stage at which every seed has a policy, and the top
    speeds (seed, step)."""
    by_step = [{j.control_steps: j.top_speed for j in run} for run in runs]
    steps = sorted(set.intersection(*map(set, by_step)))
    return np.array(steps), np.array([[run[step] for step in steps] for run in by_step])
