"""Learning curves of a study."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from bp2_rl.evaluation.figures import INK, QUIET, STYLE, WIDTH
from bp2_rl.evaluation.study import GOAL, VARIANTS, Judgement, Training, interquartile_mean, judgements

COLORS = dict(zip(VARIANTS, ("#0072B2", "#E69F00", "#D55E00", "#009E73", "#CC79A7"), strict=True))


def learning_curves(folder: Path, variants: Sequence[str], seeds: Sequence[int]) -> Figure:
    """Top speed in C MuJoCo over control steps: interquartile mean over seeds, and from the slowest to the fastest."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
        axes = figure.subplots()
        for variant in variants:
            origin = VARIANTS[variant].imitation
            first = _curve(folder, origin or variant, "imitation", seeds)
            second = _curve(folder, variant, "relaxed", seeds)
            curves = [curve for curve in (first, second) if curve is not None]
            if not curves:
                continue
            steps, speeds = (np.concatenate(parts, axis=-1) for parts in zip(*curves, strict=True))
            if first is not None:
                axes.axvline(first[0][-1] / 1e6, color=QUIET, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
                if origin:  # the variant they are borrowed from shows them
                    steps, speeds = steps[len(first[0]) - 1 :], speeds[:, len(first[0]) - 1 :]
            color = COLORS[variant]
            middle = interquartile_mean(speeds)
            axes.plot(steps / 1e6, middle, color=color, marker="o", ms=3, label=VARIANTS[variant].meaning)
            low, high = speeds.min(axis=0), speeds.max(axis=0)
            axes.fill_between(steps / 1e6, low, high, color=color, alpha=0.15, linewidth=0)
        axes.axhline(GOAL, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        axes.annotate(f"BP2: {GOAL}", (0.0, GOAL), xytext=(4, 4), textcoords="offset points", color=INK)
        axes.set(xlabel="Control steps [M]; dotted: where the relaxed stage begins", ylabel="Top speed [m/s]")
        axes.set(title="Top speed of the saved policies in C MuJoCo, 0 where they fall", xlim=(0, None), ylim=(0, None))
        axes.margins(x=0.01)
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
        return figure


def _curve(folder: Path, variant: str, stage: str, seeds: Sequence[int]) -> tuple[np.ndarray, np.ndarray] | None:
    """(control steps, top speeds "seed step") of a stage; None where none was judged."""
    runs: list[list[Judgement]] = [judgements(folder / Training(variant, seed, stage).name) for seed in seeds]  # pyright: ignore[reportArgumentType]
    runs = [run for run in runs if run]
    if not runs:
        return None
    return np.array([j.control_steps for j in runs[0]]), np.array([[j.top_speed for j in run] for run in runs])
