"""The figure of what the optimiser's limits cost over speed, and of how far policies
are from the optimum."""

import contextlib
import dataclasses

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import Table, show, table_of
from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import CostWeights, Problem
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.paper.benchmarks.efficiency.measured import measure_energy
from bp2_rl.paper.benchmarks.speeds import whole_strides
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.runs import read_runs
from bp2_rl.paper.figures.settings import BindingFigureSettings
from bp2_rl.paper.trajectories.comparison import (
    GaitSummary,
    running_cost,
    summarise_gait,
)
from bp2_rl.paper.trajectories.shadow_prices import (
    LIMIT_CHANGES,
    LOSS_CHANGES,
    Change,
    ShadowPrices,
    find_shadow_prices,
)
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import IDEAL, ROBOTS
from bp2_rl.simulation.account import replay
from bp2_rl.simulation.gait import contacts
from bp2_rl.simulation.trajectory import Trajectory, steady_window

BENCHMARK = "topspeed"
SPEED = "speed"
# hips and knees
MOTORS = [3 * leg + joint for leg in range(len(LEGS)) for joint in (1, 2)]


@dataclasses.dataclass(frozen=True)
class BindingAtSpeed:
    """The optimiser's trot at one speed, and the shadow prices of its limits."""

    speed: float  # m/s
    gait: GaitSummary | None  # None where no trajectory was found
    cost: float | None  # of the optimiser's own objective
    prices: dict[str, float]  # d ln cost / d ln of the parameter


@dataclasses.dataclass(frozen=True)
class Gap:
    """A policy's gait, and the optimiser's at the same speed on the same robot."""

    name: str
    policy: GaitSummary
    optimiser: GaitSummary | None


@dataclasses.dataclass(frozen=True)
class BindingNumbers:
    """All numbers of the figure: shadow prices over speed, and policies beside the
    optimiser."""

    robot: str
    speeds: tuple[BindingAtSpeed, ...]
    # its prices are d speed / d ln of the parameter, m/s; without a gait: not found
    greatest: BindingAtSpeed
    gaps: tuple[Gap, ...]


def price_limits(settings: BindingFigureSettings) -> BindingNumbers:
    """Solve a trot at each speed, find its limits' shadow prices, and compare policies'
    runs.

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
        **LIMIT_CHANGES,
        **(LOSS_CHANGES if hardware.losses != IDEAL.losses else {}),
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
    gaps: list[Gap] = []
    for name, gait in policies:
        best = _best(problem.at(gait.speed), solutions)
        gaps.append(Gap(name, gait, None if best is None else summarise_gait(best)))
    return BindingNumbers(settings.robot, tuple(found), greatest, tuple(gaps))


def _greatest(start: Solution, changes: dict[str, Change]) -> BindingAtSpeed:
    try:
        top = find_shadow_prices(start, changes, greatest=True)
    except NotSolved:
        return _relative(start.problem.speed, None)
    return BindingAtSpeed(
        top.solution.problem.speed,
        summarise_gait(top.solution),
        top.solution.cost,
        dict(top.prices),
    )


def _speed(problem: Problem, factor: float) -> Problem:
    return problem.at(factor * problem.speed)


def _cheapest(
    problem: Problem, before: list[Solution], changes: dict[str, Change]
) -> ShadowPrices | None:
    """Return the shadow prices of the cheapest trot; None if there is none."""
    best = _best(problem, before)
    try:
        return None if best is None else find_shadow_prices(best, changes)
    except NotSolved:
        return None


def _best(problem: Problem, before: list[Solution]) -> Solution | None:
    """Return the cheaper of the trots solved from a cold guess and from the nearest
    solution."""
    near = sorted(before, key=lambda other: abs(other.problem.speed - problem.speed))
    found: list[Solution] = []
    for start in (None, *(solution.motion for solution in near[:1])):
        with contextlib.suppress(NotSolved):
            found.append(solve(problem, start))
    return min(found, key=lambda solution: solution.cost, default=None)


def _relative(speed: float, priced: ShadowPrices | None) -> BindingAtSpeed:
    if priced is None:
        return BindingAtSpeed(speed, None, None, {})
    cost = priced.solution.cost
    prices = {name: price / cost for name, price in priced.prices.items()}
    return BindingAtSpeed(speed, summarise_gait(priced.solution), cost, prices)


def describe_run(run: Trajectory) -> GaitSummary:
    """Summarise a policy's gait over the whole strides of the steady part of its run.

    Raises:
        UserError: the run has no two strides.
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
        speed=part.mean_speed,
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


def binding(settings: BindingFigureSettings) -> Drawn:
    """Draw and tabulate the limits' shadow prices, and policies beside the
    optimiser."""
    numbers = price_limits(settings)
    tables = [_price_table(numbers)]
    gaits = [gait for gap in numbers.gaps for gait in (gap.policy, gap.optimiser)]
    if known := [gait for gait in gaits if gait is not None]:
        title = "At the same speed on the same robot: each policy, then the optimiser"
        tables.append(table_of(title, known))
    return Drawn(numbers, tuple(tables), {"binding": binding_figure(numbers)})


def _price_table(numbers: BindingNumbers) -> Table:
    top = numbers.greatest
    known = dict.fromkeys(name for at in (top, *numbers.speeds) for name in at.prices)
    lines = [
        (
            name,
            *(show(at.prices.get(name), "+.3f") for at in numbers.speeds),
            f"{MORE * top.prices[name]:+.2f} m/s" if name in top.prices else "",
        )
        for name in known
    ]
    lines.append(("cost", *(show(at.cost, ".3f") for at in numbers.speeds), ""))
    greatest = "not found" if top.gait is None else f"{top.speed:.2f} m/s"
    head = "One more of", *(f"{at.speed:g} m/s" for at in numbers.speeds)
    title = f"What 1 % more of each does to the cost, in per cent; and {MORE:.0%} more to the greatest speed"
    return Table(title, (*head, f"greatest, {greatest}"), lines)


@styled
def binding_figure(numbers: BindingNumbers) -> Figure:
    """Draw over speed how the cost changes if a limit is relaxed by 1 %, for every
    limit."""
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
    over_speed = figure.subplots()
    columns = [at for at in numbers.speeds if at.gait is not None]
    names = [name for name in columns[0].prices if name != SPEED]
    size = {name: max(abs(at.prices[name]) for at in columns) for name in names}
    names.sort(key=lambda name: -size[name])
    for name, color in zip(names, COLORS, strict=False):
        prices = [at.prices[name] for at in columns]
        speeds = [at.speed for at in columns]
        over_speed.plot(speeds, prices, "o-", ms=4, color=color, label=name)
    over_speed.axhline(0.0, color=QUIET, linewidth=0.8)
    over_speed.set(
        title="1 % more of each",
        xlabel="Speed [m/s]",
        ylabel="Change of the cost [%]",
    )
    over_speed.legend(fontsize=8)
    return figure
