"""Fig. 1 of the paper, its inset, and the ratio robot by robot."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.outcome import NOT_MEASURED, Table, show
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.labels import label
from bp2_rl.paper.figures.scaling_numbers import (
    BAND,
    BP2,
    ComparedRobot,
    ScalingNumbers,
    compare,
    measure,
)
from bp2_rl.paper.figures.settings import ScalingSettings
from bp2_rl.paper.robots import PAPER_GRAVITY, speed_law
from bp2_rl.robot.conventions import GRAVITY

# colours of BP2, of ours, and of robots on wheels
PAPER, SIMULATED, WHEELED = FALL, FRONT, LEG_COLORS["RR"]
MASSES = np.geomspace(1e-2, 1e4, 400)  # kg, of the law
SHARES = 0.8, 0.4  # of the law, drawn as lines
LEFT = 1.15  # of an axis's first value: where lines are named


def scaling(settings: ScalingSettings) -> Drawn:
    """The figure, its tables, and what comes of what the paper says of it."""
    numbers = measure(settings)
    return Drawn(
        numbers,
        (robot_table(numbers),),
        compare(numbers),
        {"scaling": scaling_figure(numbers)},
    )


def robot_table(numbers: ScalingNumbers) -> Table:
    """Every robot beside the law and its motors, the fastest for its mass first."""
    placed = sorted(
        (*numbers.robots, numbers.treadmill, *numbers.simulated),
        key=lambda robot: -robot.share,
    )
    head = (
        "Robot",
        "kg",
        "m/s",
        "law, m/s",
        "share",
        "motor, W",
        f"ratio, g = {PAPER_GRAVITY:g}",
        f"g = {GRAVITY:g}",
    )
    lines = [
        (
            robot.name + (" (wheels)" if robot.wheels else ""),
            f"{robot.mass:g}",
            f"{robot.top_speed:.2f}",
            f"{robot.law_speed:.2f}",
            f"{robot.share:.2f}",
            show(robot.motor_envelope, ".0f"),
            show(robot.demand_as_printed, ".3f"),
            show(robot.demand, ".3f"),
        )
        for robot in placed
    ]
    return Table(
        f"Robots beside the law of animals; {NOT_MEASURED}: not published", head, lines
    )


@styled
def scaling_figure(numbers: ScalingNumbers) -> Figure:
    """Speed over mass; output over motor envelope; the ratio of these, robot by
    robot."""
    figure = Figure(figsize=(1.3 * WIDTH, 11.4), layout="constrained")
    axes = figure.subplot_mosaic(
        [["law", "law"], ["motors", "ratio"]], height_ratios=(1.0, 1.08)
    )
    _draw_law(axes["law"], numbers)
    _draw_motors(axes["motors"], numbers)
    _draw_ratios(axes["ratio"], numbers)
    # the layout is final from here: names are placed among what is there
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    _name_law(axes["law"], numbers)
    _name_motors(axes["motors"], numbers)
    return figure


def _draw_law(axes: Axes, numbers: ScalingNumbers) -> None:
    if numbers.mammals:
        mass, speed = zip(
            *((species.mass, species.top_speed) for species in numbers.mammals),
            strict=True,
        )
        axes.plot(
            mass,
            speed,
            "o",
            ms=3.5,
            color=QUIET,
            alpha=0.6,
            markeredgewidth=0,
            label="mammals",
            zorder=1,
        )
    axes.plot(
        MASSES,
        speed_law(MASSES),
        color=INK,
        linewidth=1.6,
        label="law of animals",
        zorder=2,
    )
    for share in SHARES:
        axes.plot(
            MASSES,
            share * speed_law(MASSES),
            color=QUIET,
            linewidth=0.7,
            linestyle=(0, (4, 3)),
            zorder=1,
        )
    _scatter(axes, numbers, lambda robot: (robot.mass, robot.top_speed))
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="Body mass [kg]",
        ylabel="Greatest speed [m/s]",
    )
    masses = [robot.mass for robot in numbers.robots] + [
        species.mass for species in numbers.mammals
    ]
    axes.set(
        xlim=(0.5 * min(masses), 2.0 * max(masses)), title="A   Speed over body mass"
    )
    speeds = [0.6, 25.0, *(species.top_speed for species in numbers.mammals)]
    axes.set_ylim(0.8 * min(speeds), 1.2 * max(speeds))
    _plain_ticks(axes)
    axes.legend(loc="lower right", fontsize=8.5)


def _draw_motors(axes: Axes, numbers: ScalingNumbers) -> None:
    x = np.array([60.0, 8000.0])
    axes.fill_between(x, BAND[0] * x, BAND[1] * x, color=QUIET, alpha=0.18, linewidth=0)
    for ratio in (BAND[0], BAND[1], numbers.bp2.demand_as_printed or 1.0):
        axes.plot(x, ratio * x, color=QUIET, linewidth=0.7, linestyle=(0, (4, 3)))
    _scatter(axes, numbers, _motor_point)
    axes.set(xscale="log", yscale="log", xlim=x, ylim=(10.0, 12e3))
    axes.set(
        xlabel="One motor's peak torque x no-load speed [W]",
        ylabel="m g v [W]",
        title="B   What is asked of motors",
    )
    _plain_ticks(axes)


def _draw_ratios(axes: Axes, numbers: ScalingNumbers) -> None:
    known = [
        robot
        for robot in (*numbers.robots, numbers.treadmill, *numbers.simulated)
        if robot.demand is not None
    ]
    ranked = sorted(known, key=lambda robot: robot.demand or 0.0)
    axes.axvspan(*BAND, color=QUIET, alpha=0.18, linewidth=0)
    axes.axvline(numbers.spread.median, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.annotate(
        f"median {numbers.spread.median:.2f}",
        (BAND[1], 0.0),
        (4, 0),
        textcoords="offset points",
        va="center",
    )
    for place, robot in enumerate(ranked):
        demand, color = robot.demand_as_printed or 0.0, _color(numbers, robot)
        axes.plot((0.0, demand), (place, place), color=color, linewidth=0.8, alpha=0.6)
        axes.plot(demand, place, _mark(numbers, robot), ms=5, color=color)
        axes.annotate(
            f"{demand:.3f}",
            (1.01, place),
            xycoords=("axes fraction", "data"),
            va="center",
            fontsize=7.5,
        )
    axes.set(
        yticks=range(len(ranked)),
        ylim=(-0.8, len(ranked)),
        xlim=(0.0, 1.04 * (ranked[-1].demand or 1.0)),
    )
    axes.set_yticklabels([robot.name for robot in ranked], fontsize=7.5)
    spread = numbers.spread
    axes.set(
        title=f"C   m g v over that: {len(spread.within)} of {spread.number} others in {BAND[0]:g} to {BAND[1]:g}"
    )
    axes.set(xlabel=f"Ratio, g = {PAPER_GRAVITY:g} m/s²")
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


def _name_law(axes: Axes, numbers: ScalingNumbers) -> None:
    for share in SHARES:
        _along(
            axes,
            f"{share:.0%} of the law",
            lambda mass, share=share: share * float(speed_law(mass)),
        )
    everyone = (
        *numbers.simulated,
        numbers.treadmill,
        numbers.bp2,
        *(r for r in numbers.robots if r.name != BP2),
    )
    points = [(robot.mass, robot.top_speed) for robot in everyone]
    names = [_with_share(numbers, robot) for robot in everyone]
    label(axes, points, names, [_color(numbers, robot) for robot in everyone])


def _name_motors(axes: Axes, numbers: ScalingNumbers) -> None:
    ratio = numbers.bp2.demand_as_printed or 1.0
    _along(axes, f"{ratio:.3f}", lambda envelope: ratio * envelope)
    _along(axes, f"{BAND[0]:g} to {BAND[1]:g}", lambda envelope: BAND[1] * envelope)
    everyone = [
        r
        for r in (*numbers.simulated, numbers.treadmill, numbers.bp2, *numbers.robots)
        if r.demand is not None
    ]
    everyone = list(dict.fromkeys(everyone))
    # those are named beside, in panel C
    within = {*numbers.spread.within, *numbers.spread.unknown}
    names = ["" if robot.name in within else robot.name for robot in everyone]
    label(
        axes,
        [_motor_point(robot) for robot in everyone],
        names,
        [_color(numbers, robot) for robot in everyone],
    )


def _scatter(
    axes: Axes,
    numbers: ScalingNumbers,
    point: Callable[[ComparedRobot], tuple[float, float]],
) -> None:
    named = set()
    for robot in (*numbers.robots, numbers.treadmill, *numbers.simulated):
        if np.isnan(point(robot)).any():
            continue
        mark, color, group = (
            _mark(numbers, robot),
            _color(numbers, robot),
            _group(numbers, robot),
        )
        size = 9 if mark == "*" else 5
        label = None if group in named else group
        axes.plot(
            *point(robot),
            mark,
            ms=size,
            color=color,
            markeredgewidth=0,
            label=label,
            zorder=3,
        )
        named.add(group)


def _motor_point(robot: ComparedRobot) -> tuple[float, float]:
    if robot.motor_envelope is None:
        return np.nan, np.nan
    return robot.motor_envelope, robot.mass * PAPER_GRAVITY * robot.top_speed


def _with_share(numbers: ScalingNumbers, robot: ComparedRobot) -> str:
    ours = robot.name in (BP2, numbers.treadmill.name) or robot in numbers.simulated
    return f"{robot.name}, {robot.share:.2f} of the law" if ours else robot.name


def _group(numbers: ScalingNumbers, robot: ComparedRobot) -> str:
    if robot in numbers.simulated:
        return "BP2, simulated"
    if robot.name in (BP2, numbers.treadmill.name):
        return "BP2, measured"
    return "wheels on legs" if robot.wheels else "legs"


def _mark(numbers: ScalingNumbers, robot: ComparedRobot) -> str:
    return {"legs": "o", "wheels on legs": "s"}.get(_group(numbers, robot), "*")


def _color(numbers: ScalingNumbers, robot: ComparedRobot) -> str:
    colors = {
        "legs": INK,
        "wheels on legs": WHEELED,
        "BP2, measured": PAPER,
        "BP2, simulated": SIMULATED,
    }
    return colors[_group(numbers, robot)]


def _along(axes: Axes, text: str, line: Callable[[float], float]) -> None:
    """Write above a line, at its left end, in its direction."""
    x = LEFT * axes.get_xlim()[0]
    ends = axes.transData.transform([(x, line(x)), (1.05 * x, line(1.05 * x))])
    angle = np.rad2deg(np.arctan2(*(ends[1] - ends[0])[::-1]))
    axes.annotate(
        text,
        (x, line(x)),
        (0, 2.5),
        textcoords="offset points",
        color=QUIET,
        fontsize=7.5,
        va="bottom",
        rotation=angle,
        rotation_mode="anchor",
    )


def _plain_ticks(axes: Axes) -> None:
    """1, 2, 5, 10, 20 and so on, written out."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_locator(NullLocator())
