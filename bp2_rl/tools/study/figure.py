"""A study in pictures: how fast each variant gets, and when."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.tools.study.measuring import PolicyMeasurement
from bp2_rl.tools.study.outcome import GOAL, Outcome, both_stages, interquartile_mean
from bp2_rl.tools.study.plan import VARIANTS

COLORS = ("#0072B2", "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#000000")
LINES = ("-", (0, (4, 1.5)), (0, (1, 1)))
STYLES = dict(
    zip(
        VARIANTS,
        itertools.islice(itertools.product(LINES, COLORS), len(VARIANTS)),
        strict=True,
    )
)
"""(line, colour) of each variant, the same in every figure."""


@styled
def learning_curves(
    folder: Path, variants: Sequence[str], seeds: Sequence[int]
) -> Figure:
    """Top speed in C MuJoCo over control steps: interquartile mean over seeds, and from
    the slowest to the fastest."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    for variant in variants:
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
        if VARIANTS[variant].imitation:  # the variant they are borrowed from shows them
            steps, speeds = steps[len(first[0]) - 1 :], speeds[:, len(first[0]) - 1 :]
        line, color = STYLES[variant]
        middle = interquartile_mean(speeds)
        axes.plot(
            steps / 1e6,
            middle,
            ls=line,
            color=color,
            marker="o",
            ms=3,
            label=VARIANTS[variant].meaning,
        )
        low, high = speeds.min(axis=0), speeds.max(axis=0)
        axes.fill_between(steps / 1e6, low, high, color=color, alpha=0.15, linewidth=0)
    axes.axhline(GOAL, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.annotate(
        f"BP2: {GOAL}",
        (0.0, GOAL),
        xytext=(4, 4),
        textcoords="offset points",
        color=INK,
    )
    axes.set(
        xlabel="Control steps [M]; dotted: where the relaxed stage begins",
        ylabel="Top speed [m/s]",
    )
    axes.set(
        title="Top speed of the saved policies in C MuJoCo, 0 where they fall",
        xlim=(0, None),
        ylim=(0, None),
    )
    axes.margins(x=0.01)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


@styled
def top_speeds(outcomes: Sequence[Outcome]) -> Figure:
    """Top speed in C MuJoCo of each seed of each variant, after both stages, and after
    the imitation stage."""
    figure = Figure(figsize=(WIDTH, 1.2 + 0.32 * len(outcomes)), layout="constrained")
    axes = figure.subplots()
    before = [
        (speed, row)
        for row, one in enumerate(outcomes)
        for speed in one.imitation_top_speeds
    ]
    after = [
        (speed, row) for row, one in enumerate(outcomes) for speed in one.top_speeds
    ]
    axes.plot(
        *zip(*before, strict=True),
        "o",
        mfc="none",
        color=QUIET,
        ms=6,
        label="imitation",
    )
    axes.plot(*zip(*after, strict=True), "o", color=COLORS[0], ms=6, label="relaxed")
    axes.axvline(GOAL, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.annotate(
        f"BP2: {GOAL}",
        (GOAL, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(4, 4),
        textcoords="offset points",
    )
    axes.set_yticks(
        range(len(outcomes)), [VARIANTS[one.variant].meaning for one in outcomes]
    )
    axes.set(
        xlabel="Top speed in C MuJoCo [m/s], 0 where it falls; a circle a seed",
        xlim=(0, None),
    )
    axes.invert_yaxis()
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


def _curve(
    runs: Sequence[Sequence[PolicyMeasurement]],
) -> tuple[np.ndarray, np.ndarray]:
    """(control steps, top speeds "seed step") of a stage, where all seeds have a
    policy: a stopped run saves more."""
    by_step = [{j.control_steps: j.top_speed for j in run} for run in runs]
    steps = sorted(set.intersection(*map(set, by_step)))
    return np.array(steps), np.array([[run[step] for step in steps] for run in by_step])
