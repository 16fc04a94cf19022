"""Limits over speed: which are touched, what they cost, and how far a policy is from
the optimiser."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.outcome import NOT_MEASURED, Table, show
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import CostWeights, Problem
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.paper.benchmarks.efficiency.measured import measure_energy
from bp2_rl.paper.benchmarks.speeds import whole_strides
from bp2_rl.paper.figures.drawn import Comparison, Drawn
from bp2_rl.paper.figures.runs import read_runs
from bp2_rl.paper.figures.settings import BindingSettings
from bp2_rl.paper.trajectories.gait_summary import (
    GaitSummary,
    running_cost,
    summarise_gait,
)
from bp2_rl.paper.trajectories.shadow_prices import (
    LIMITS,
    LOSSES,
    Change,
    ShadowPrices,
    find_shadow_prices,
)
from bp2_rl.robot import bp2
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import IDEAL, ROBOTS
from bp2_rl.simulation.account import replay
from bp2_rl.simulation.gait import contacts
from bp2_rl.simulation.samples import steady_window
from bp2_rl.simulation.trajectory import Trajectory

BENCHMARK = "topspeed"
SPEED = "speed"
# hips and knees
MOTORS = [3 * leg + joint for leg in range(len(LEGS)) for joint in (1, 2)]


@dataclasses.dataclass(frozen=True)
class BindingAtSpeed:
    """The optimiser at a speed."""

    speed: float  # m/s
    gait: GaitSummary | None  # None where no trajectory was found
    cost: float | None  # of the optimiser's own objective
    touched: dict[str, float]  # by limit: share of motors or feet times instants
    prices: dict[str, float]  # d ln cost / d ln of the parameter


@dataclasses.dataclass(frozen=True)
class Gap:
    """A policy's gait, and the optimiser's at the same speed on the same robot."""

    name: str
    policy: GaitSummary
    optimiser: GaitSummary | None


@dataclasses.dataclass(frozen=True)
class BindingNumbers:
    """All that the figure shows."""

    robot: str
    speeds: tuple[BindingAtSpeed, ...]
    # its prices are d speed / d ln of the parameter, m/s; without a gait: not found
    greatest: BindingAtSpeed
    gaps: tuple[Gap, ...]


def measure(settings: BindingSettings) -> BindingNumbers:
    """Solve at each speed, find the shadow prices, and set the runs beside.

    Raises:
        UserError: a run is of another robot, or has no two strides.
    """
    hardware = ROBOTS[settings.robot]
    ran = read_runs(settings.runs, BENCHMARK)
    for name, _, run in ran:
        if run.hardware != hardware:
            raise UserError(
                f"--runs: {name} is not of the robot that --robot names, {settings.robot}"
            )
    policies = [(name, describe_run(run)) for name, _, run in ran]
    problem = Problem(intervals=settings.intervals, hardware=hardware)
    changes: dict[str, Change] = {
        **LIMITS,
        **(LOSSES if hardware.losses != IDEAL.losses else {}),
    }
    found: list[BindingAtSpeed] = []
    solutions: list[Solution] = []
    for speed in settings.speeds:
        priced = _cheapest(problem.at(speed), solutions, changes | {SPEED: _speed})
        found.append(_relative(speed, priced))
        if priced is not None:
            solutions.append(priced.solution)
    if not solutions:
        raise UserError(
            "--speeds: no trajectory was found at any of them: name slower ones, or more --intervals"
        )
    greatest = _greatest(solutions[-1], changes)
    gaps = tuple(
        Gap(name, gait, _beside(problem.at(gait.speed), solutions))
        for name, gait in policies
    )
    return BindingNumbers(settings.robot, tuple(found), greatest, gaps)


def _greatest(start: Solution, changes: dict[str, Change]) -> BindingAtSpeed:
    try:
        top = find_shadow_prices(start, changes, greatest=True)
    except NotSolved:
        return _relative(start.problem.speed, None)
    return BindingAtSpeed(
        top.solution.problem.speed,
        summarise_gait(top.solution),
        top.solution.cost,
        top.active,
        dict(top.prices),
    )


def _speed(problem: Problem, factor: float) -> Problem:
    return problem.at(factor * problem.speed)


def _cheapest(
    problem: Problem, before: list[Solution], changes: dict[str, Change]
) -> ShadowPrices | None:
    """The cheaper of what the cold guess and the neighbour leads to, with its shadow
    prices; None if there is none."""
    best = min(
        _solved(problem, before), key=lambda solution: solution.cost, default=None
    )
    try:
        return None if best is None else find_shadow_prices(best, changes)
    except NotSolved:
        return None


def _solved(problem: Problem, before: list[Solution]) -> Iterator[Solution]:
    near = sorted(
        before, key=lambda solution: abs(solution.problem.speed - problem.speed)
    )[:1]
    for start in (None, *(solution.motion for solution in near)):
        try:
            yield solve(problem, start)
        except NotSolved:
            continue


def _beside(problem: Problem, solutions: list[Solution]) -> GaitSummary | None:
    best = min(
        _solved(problem, solutions), key=lambda solution: solution.cost, default=None
    )
    return None if best is None else summarise_gait(best)


def _relative(speed: float, priced: ShadowPrices | None) -> BindingAtSpeed:
    if priced is None:
        return BindingAtSpeed(speed, None, None, {}, {})
    cost = priced.solution.cost
    prices = {name: price / cost for name, price in priced.prices.items()}
    return BindingAtSpeed(
        speed, summarise_gait(priced.solution), cost, priced.active, prices
    )


def describe_run(run: Trajectory) -> GaitSummary:
    """A policy's, over the whole strides of the steady part of its run.

    Raises:
        UserError: it has no two.
    """
    chosen = whole_strides(steady_window(run))
    energy = (
        None
        if chosen is None
        else measure_energy(chosen[0], replay(chosen[0])[0], chosen[1])
    )
    if chosen is None or energy is None:
        raise UserError(f"--runs: {run.name} makes no two strides: name a longer run")
    part, strides = chosen
    torque, qd = part.torque[:, MOTORS], part.joint_velocity[:, MOTORS]
    cos, sin = np.cos(part.heading)[:, None], np.sin(part.heading)[:, None]
    along = cos * part.foot_force[..., 0] + sin * part.foot_force[..., 1]
    force = np.stack([along, part.foot_force[..., 2]], axis=-1).reshape(len(part), -1)
    return GaitSummary(
        speed=float(np.mean(part.ground_velocity[:, 0])),
        period=len(part) * part.dt / strides,
        duty=float(np.mean(contacts(part))),
        peak_torque=float(np.max(np.abs(torque))),
        rms_torque=float(np.sqrt(np.mean(torque**2))),
        peak_force=float(np.max(part.foot_force[..., 2])),
        positive=energy.positive,
        running_cost=float(
            np.mean(running_cost(torque, qd, force, run.hardware, CostWeights()))
        ),
    )


# --- Tables and figure ----------------------------------------------------------------


MORE = 0.1  # by which a parameter is thought to grow where the greatest speed is told
COLORS = FRONT, FALL, *(LEG_COLORS[leg] for leg in ("RR", "RL", "FL")), INK, QUIET
SHOWN = 1e-3  # m/s or 1: prices below are nothing


def binding(settings: BindingSettings) -> Drawn:
    """The figure, its tables, and what becomes of the paper's words about envelopes."""
    numbers = measure(settings)
    tables = (
        _touched_table(numbers),
        _price_table(numbers),
        *((_gap_table(numbers),) if numbers.gaps else ()),
    )
    return Drawn(
        numbers, tables, compare(numbers), {"binding": binding_figure(numbers)}
    )


def compare(numbers: BindingNumbers) -> tuple[Comparison, ...]:
    """What the limits say of the paper's claims."""
    top = numbers.greatest
    best = sorted(
        (name for name in top.prices if top.prices[name] != 0.0),
        key=lambda name: -abs(top.prices[name]),
    )
    gains = ", ".join(f"{name} {MORE * top.prices[name]:+.2f} m/s" for name in best[:4])
    more = (
        f"; {MORE:.0%} more of each: {gains}"
        if top.gait is not None
        else " or more: no greatest speed was found"
    )
    return (
        Comparison(
            f"the motors' envelopes bound the speed, {bp2.TREADMILL_TOP_SPEED:g} m/s",
            f"the optimiser's {numbers.robot} robot reaches {top.speed:.1f} m/s{more}",
            "not comparable",
            "in the plane, without feedback: an upper bound, and a local optimum",
        ),
    )


def _touched_table(numbers: BindingNumbers) -> Table:
    columns = [*numbers.speeds, numbers.greatest]
    names = sorted({name for at in columns for name in at.touched})
    lines = [
        (name, *(_share(at.touched.get(name), at.gait) for at in columns))
        for name in names
    ]
    return Table(
        "Limits that hold: share of motors, feet or joints x instants",
        ("Limit", *_heads(numbers)),
        lines,
    )


def _share(value: float | None, gait: GaitSummary | None) -> str:
    return NOT_MEASURED if gait is None else "" if value is None else f"{value:.1%}"


def _heads(numbers: BindingNumbers) -> tuple[str, ...]:
    top = numbers.greatest
    return (
        *(f"{at.speed:g} m/s" for at in numbers.speeds),
        "greatest, not found" if top.gait is None else f"greatest, {top.speed:.2f} m/s",
    )


def _price_table(numbers: BindingNumbers) -> Table:
    top = numbers.greatest.prices
    names = list(
        dict.fromkeys(
            name for at in (numbers.greatest, *numbers.speeds) for name in at.prices
        )
    )
    lines = [
        (
            name,
            *(show(at.prices.get(name), "+.3f") for at in numbers.speeds),
            f"{MORE * top[name]:+.2f} m/s" if name in top else "",
        )
        for name in names
    ]
    lines.append(("cost", *(show(at.cost, ".3f") for at in numbers.speeds), ""))
    title = f"What 1 % more of each does to the cost, in per cent; and {MORE:.0%} more to the greatest speed"
    return Table(title, ("One more of", *_heads(numbers)), lines)


GAIT = {
    "period": ("Period [s]", ".3f"),
    "duty": ("Duty", ".3f"),
    "peak_torque": ("Peak [Nm]", ".0f"),
    "rms_torque": ("RMS [Nm]", ".1f"),
    "peak_force": ("Force [N]", ".0f"),
    "positive": ("Work / m g d", ".3f"),
    "running_cost": ("R", ".2f"),
}
"""Columns of the gap."""


def _gap_table(numbers: BindingNumbers) -> Table:
    lines = []
    for gap in numbers.gaps:
        for who, gait in (("policy", gap.policy), ("optimiser", gap.optimiser)):
            values = [
                show(None if gait is None else getattr(gait, name), form)
                for name, (_, form) in GAIT.items()
            ]
            lines.append((f"{gap.policy.speed:.2f} m/s, {who}", *values))
    return Table(
        "At the same speed on the same robot",
        ("Gait", *(head for head, _ in GAIT.values())),
        lines,
    )


@styled
def binding_figure(numbers: BindingNumbers) -> Figure:
    """Touched limits, prices of the cost, gains of the greatest speed; below, the
    policy over the optimiser."""
    figure = Figure(
        figsize=(1.3 * WIDTH, 8.2 if numbers.gaps else 4.4), layout="constrained"
    )
    rows: list[Any] = [
        ["touched", "prices", "greatest"],
        *([["gap", "gap", "gap"]] if numbers.gaps else []),
    ]
    axes = figure.subplot_mosaic(rows)
    _draw_touched(axes["touched"], numbers)
    _draw_prices(axes["prices"], numbers)
    _draw_greatest(axes["greatest"], numbers)
    if numbers.gaps:
        _draw_gap(axes["gap"], numbers)
    return figure


def _draw_touched(axes: Axes, numbers: BindingNumbers) -> None:
    columns = [at for at in (*numbers.speeds, numbers.greatest) if at.gait is not None]
    speeds = [at.speed for at in columns]
    names = sorted(
        {name for at in columns for name in at.touched},
        key=lambda name: -_most(columns, name),
    )
    for name, color in zip(names, COLORS, strict=False):
        share = [100.0 * at.touched.get(name, 0.0) for at in columns]
        axes.plot(speeds, share, "o-", ms=4, color=color, label=name)
    axes.set(
        xlabel="Speed [m/s]",
        ylabel="Instants at which it holds [%]",
        title="A   Limits that hold",
    )
    axes.legend(fontsize=8)


def _most(columns: list[BindingAtSpeed], name: str) -> float:
    return max(at.touched.get(name, 0.0) for at in columns)


def _draw_prices(axes: Axes, numbers: BindingNumbers) -> None:
    columns = [at for at in numbers.speeds if at.gait is not None]
    size = {
        name: max(abs(at.prices[name]) for at in columns)
        for name in columns[0].prices
        if name != SPEED
    }
    for name, color in zip(
        sorted(size, key=lambda name: -size[name]), COLORS, strict=False
    ):
        axes.plot(
            [at.speed for at in columns],
            [at.prices[name] for at in columns],
            "o-",
            ms=4,
            color=color,
            label=name,
        )
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set(
        xlabel="Speed [m/s]",
        ylabel="Change of the cost [%]",
        title="B   1 % more of each",
    )
    axes.legend(fontsize=8)


def _draw_greatest(axes: Axes, numbers: BindingNumbers) -> None:
    top = numbers.greatest
    gains = {
        name: MORE * price
        for name, price in top.prices.items()
        if abs(MORE * price) >= SHOWN
    }
    names = sorted(gains, key=lambda name: abs(gains[name]))
    axes.barh(range(len(names)), [gains[name] for name in names], color=FRONT)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.axvline(0.0, color=QUIET, linewidth=0.8)
    axes.grid(visible=False, axis="y")
    axes.set(
        xlabel="Change of the greatest speed [m/s]",
        title=f"C   {MORE:.0%} more, from {top.speed:.1f} m/s",
    )


def _draw_gap(axes: Axes, numbers: BindingNumbers) -> None:
    gaps = [gap for gap in numbers.gaps if gap.optimiser is not None]
    width = 0.8 / max(len(gaps), 1)
    for place, (gap, color) in enumerate(zip(gaps, COLORS, strict=False)):
        ratio = [
            getattr(gap.policy, name) / getattr(gap.optimiser, name) for name in GAIT
        ]
        x = np.arange(len(GAIT)) + (place - 0.5 * (len(gaps) - 1)) * width
        axes.bar(x, ratio, width, color=color, label=f"{gap.policy.speed:.1f} m/s")
    axes.axhline(1.0, color=INK, linewidth=1.0)
    axes.set_xticks(
        range(len(GAIT)), [head.partition(" [")[0] for head, _ in GAIT.values()]
    )
    axes.grid(visible=False, axis="x")
    axes.set(
        ylabel="Policy / optimiser",
        title="D   The policy beside the optimiser, same speed, same robot",
    )
    axes.legend()
