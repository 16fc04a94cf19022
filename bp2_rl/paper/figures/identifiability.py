"""The Jacobian of the paper's numbers, its singular values, and what is left of each
assumption's range."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from bp2_rl.base.plotting import FRONT, INK, QUIET, WIDTH, mark_level, styled
from bp2_rl.evaluation.benchmarks.outcome import Table, show
from bp2_rl.paper.figures.assumed import ASSUMED
from bp2_rl.paper.figures.drawn import Comparison, Drawn
from bp2_rl.paper.figures.identifiability_numbers import (
    LAUNCH,
    OUTDOORS,
    SPRINT,
    Combination,
    IdentifiabilityNumbers,
    RowNumbers,
    jacobian,
    measure,
)
from bp2_rl.paper.figures.settings import IdentifiabilitySettings
from bp2_rl.robot import bp2

NAMED = 0.25  # of a combination's length: parts that are named
LINEAR = 0.1  # units: below, the map's colours are linear


def identifiability(settings: IdentifiabilitySettings) -> Drawn:
    """The figure, its tables, and what becomes of the paper's numbers as evidence."""
    numbers = measure(settings)
    tables = (
        _assumption_table(numbers),
        _row_table(numbers),
        _combination_table(numbers),
    )
    return Drawn(
        numbers,
        tables,
        compare(numbers),
        {"identifiability": identifiability_figure(numbers)},
    )


def compare(numbers: IdentifiabilityNumbers) -> tuple[Comparison, ...]:
    """Which of the paper's numbers say nothing, or nothing of their own, of what had to
    be assumed."""
    by_name = {row.name: row for row in numbers.rows}
    share = _parallel(by_name[SPRINT], by_name[OUTDOORS])
    return (
        Comparison(
            f"{len(numbers.rows)} numbers that hang on the hardware",
            f"they pin down {numbers.pinned} combinations of {numbers.assumptions} assumptions, "
            f"{numbers.by_rounding} if the model had no error",
            "not comparable",
            "the paper does not print these; most of them nothing else tells",
        ),
        Comparison(
            "1765 W of a hind motor",
            "peak torque times corner speed, 1764 W",
            "not comparable",
            "it pins that product; the corner of our envelope was derived from it",
        ),
        Comparison(
            "12.2 s over 100 m",
            f"moves as {share:+.2f} times the top speed outdoors does",
            "not comparable",
            "once 10.74 m/s and 2.38 m/s2 are printed it says nothing more of the hardware",
        ),
        Comparison(
            f"a launch of {by_name[LAUNCH].printed:g} m/s2",
            f"needs a friction of {numbers.grip:.2f} and, on two legs, {numbers.launch_torque:.0f} Nm of a hip",
            "not comparable",
            f"friction of {bp2.FOOT_FRICTION:g} and {bp2.PEAK_TORQUE:g} Nm leave room: it is control's, and pins "
            "nothing assumed",
        ),
    )


def _parallel(row: RowNumbers, other: RowNumbers) -> float:
    """How many times another row a row is, by least squares."""
    one, two = (
        np.array([each.slopes[name] for name in other.slopes]) for each in (row, other)
    )
    return float(one @ two / (two @ two))


def _assumption_table(numbers: IdentifiabilityNumbers) -> Table:
    head = ("Assumed", "Value", "From", "To", "Unit", "Left of its range")
    lines = [
        (
            one.name,
            f"{one.value:g}",
            f"{one.low:g}",
            f"{one.high:g}",
            one.unit,
            f"{numbers.left[one.name]:.0%}",
        )
        for one in ASSUMED
    ]
    return Table(
        "What is assumed, and what the paper's numbers leave of it", head, lines
    )


def _row_table(numbers: IdentifiabilityNumbers) -> Table:
    head = (
        "Number",
        "Paper",
        "Ours",
        "Known to",
        "Moves most with",
        "Slopes differ by",
    )
    lines = []
    for row, units in zip(numbers.rows, jacobian(numbers.rows), strict=True):
        most = [
            f"{ASSUMED[i].name} {units[i]:+.2g}"
            for i in np.argsort(-np.abs(units))[:3]
            if abs(units[i]) > 1e-3
        ]
        paper = f"{row.printed:g} {row.unit}"
        known = f"{row.uncertainty:.1%}"
        lines.append(
            (
                row.name,
                paper,
                show(row.ours, ".4g"),
                known,
                ", ".join(most) or "nothing",
                f"{row.bend:.0%}",
            )
        )
    return Table(
        "The paper's numbers: what half a range does, in uncertainties", head, lines
    )


def _combination_table(numbers: IdentifiabilityNumbers) -> Table:
    head = ("Singular value", "Assumptions that move together", "Seen in")
    lines = [
        (f"{one.singular:.2g}", _named(one.assumptions), _named(one.seen_in))
        for one in numbers.combinations
        if one.singular > 1e-9
    ]
    unseen = sum(one.singular <= 1e-9 for one in numbers.combinations)
    lines.append(
        (f"0, {unseen} times", "whatever is at right angles to these", "nothing")
    )
    return Table("Combinations, the strongest first", head, lines, words=True)


def _named(parts: dict[str, float]) -> str:
    largest = sorted(parts.items(), key=lambda part: -abs(part[1]))
    return ", ".join(
        f"{name} {part:+.2f}" for name, part in largest if abs(part) >= NAMED
    )


@styled
def identifiability_figure(numbers: IdentifiabilityNumbers) -> Figure:
    """The Jacobian above, singular values and what is left below."""
    figure = Figure(figsize=(1.3 * WIDTH, 9.0), layout="constrained")
    axes = figure.subplot_mosaic(
        [["map", "map"], ["values", "left"]],
        height_ratios=(1.15, 1.0),
        width_ratios=(1, 1.4),
    )
    _draw_map(figure, axes["map"], numbers)
    _draw_values(axes["values"], numbers.combinations)
    _draw_left(axes["left"], numbers)
    return figure


def _draw_map(figure: Figure, axes: Axes, numbers: IdentifiabilityNumbers) -> None:
    J = jacobian(numbers.rows)
    top = float(np.max(np.abs(J)))
    image = axes.imshow(
        J, cmap="PuOr", norm=SymLogNorm(LINEAR, vmin=-top, vmax=top), aspect="auto"
    )
    for (i, j), value in np.ndenumerate(J):
        if abs(value) >= LINEAR:
            color = "white" if abs(value) > 3.0 else INK
            axes.text(
                j,
                i,
                f"{value:.2g}",
                ha="center",
                va="center",
                fontsize=7.5,
                color=color,
            )
    axes.set_xticks(
        range(len(ASSUMED)), [one.name for one in ASSUMED], rotation=40, ha="right"
    )
    axes.set_yticks(
        range(len(numbers.rows)),
        [f"{row.name}, {row.printed:g} {row.unit}" for row in numbers.rows],
    )
    axes.grid(visible=False)
    axes.set_title(
        "A   What half an assumption's range does to a number of the paper, in its uncertainties"
    )
    figure.colorbar(image, ax=axes, pad=0.01, ticks=[-10, -1, 0, 1, 10])


def _draw_values(axes: Axes, combinations: tuple[Combination, ...]) -> None:
    values = [one.singular for one in combinations]
    seen = [value for value in values if value > 1e-9]
    axes.semilogy(range(1, len(seen) + 1), seen, "o", color=FRONT)
    mark_level(axes, 1.0, "moves by its uncertainty")
    unseen = f"{len(values) - len(seen)} more combinations\nare seen in nothing"
    axes.annotate(
        unseen,
        (0.97, 0.97),
        xycoords="axes fraction",
        ha="right",
        va="top",
        color=QUIET,
    )
    axes.set(
        xlabel="Combination",
        ylabel="Singular value",
        title="B   Combinations of assumptions",
    )
    axes.set_xlim(0.5, len(values) + 0.5)


def _draw_left(axes: Axes, numbers: IdentifiabilityNumbers) -> None:
    order = sorted(numbers.left.items(), key=lambda item: -item[1])
    names, left = zip(*order, strict=True)
    axes.barh(
        range(len(names)), [100.0 * share for share in left], color=FRONT, height=0.7
    )
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set(
        xlim=(0.0, 100.0),
        xlabel="Left of the range [%]",
        title="C   What the paper's numbers leave open",
    )
    axes.grid(visible=False, axis="y")
