"""Fig. 1 of the paper and its inset: how fast robots run beside the law of animals, and
what they ask of their motors."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import NOT_MEASURED, metric, table_of
from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.learning.policy import load_policy
from bp2_rl.paper.figures.drawn import DASHES, Drawn, name_rows, note
from bp2_rl.paper.figures.settings import ScalingFigureSettings
from bp2_rl.paper.published import (
    KMH,
    PAPER_GRAVITY,
    Mammal,
    PublishedRobot,
    read_robots,
    speed_law,
)
from bp2_rl.paper.published_tables import read_table
from bp2_rl.robot import bp2, conventions

BENCHMARK = "topspeed"
BP2, TREADMILL = "BP2", "BP2, treadmill"  # the first as in Table S1
BAND = 0.6, 0.8  # in which the paper has the ratio "typically distributed"
MASSES = np.geomspace(1e-2, 1e4, 400)  # kg, of the law
SHARES = 0.8, 0.4  # of the law, drawn as lines
NAMED = 0.45  # of the law: faster robots are named beside their points
GROUPS = {
    "legs": ("o", INK),
    "wheels on legs": ("s", LEG_COLORS["RR"]),
    "BP2, measured": ("*", FALL),
    "BP2, simulated": ("*", FRONT),
}
"""Marks and colours of the groups of robots."""


@dataclasses.dataclass(frozen=True)
class ComparedRobot:
    """A robot's speed beside the law of animals, and its power demand beside its
    motors' envelope."""

    name: str = metric("Robot", form="s")
    mass: float = metric("Mass", "kg", "g")
    top_speed: float = metric("Speed", "m/s")
    law_speed: float = metric("Law", "m/s")  # of an animal of its mass
    share: float = metric("Share")  # of the law's speed
    # one motor's peak torque x no-load speed
    motor_envelope: float | None = metric("Motor", "W", ".0f")
    # m g v over that, with 9.81 m/s2
    demand: float | None = metric(f"Ratio, g = {conventions.GRAVITY:g}", form=".3f")
    # the demand with the paper's 9.8 m/s2
    demand_as_printed: float | None = metric(f"g = {PAPER_GRAVITY:g}", form=".3f")
    wheels: bool = metric("Wheels", form=lambda wheels: "yes" if wheels else "")


@dataclasses.dataclass(frozen=True)
class Spread:
    """Distribution of the power ratio over Table S1 without BP2, with the paper's g, to
    check its "typically distributed between 0.6 and 0.8"."""

    number: int  # robots with motor data
    within: tuple[str, ...]  # of them, in the band
    median: float
    quartiles: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Species:
    """A mammal's mass and top speed, and the share of the law's speed."""

    name: str
    mass: float  # kg
    top_speed: float  # m/s
    share: float  # of the law's


@dataclasses.dataclass(frozen=True)
class ScalingNumbers:
    """All robots and mammals that the figure shows."""

    robots: tuple[ComparedRobot, ...]  # Table S1
    treadmill: ComparedRobot
    simulated: tuple[ComparedRobot, ...]
    mammals: tuple[Species, ...]
    spread: Spread

    @property
    def everyone(self) -> tuple[ComparedRobot, ...]:
        """All robots, BP2's rows first."""
        first, others = (
            [robot for robot in self.robots if (robot.name == BP2) == own]
            for own in (True, False)
        )
        return (*self.simulated, self.treadmill, *first, *others)


def scaling(settings: ScalingFigureSettings) -> Drawn:
    """Draw and tabulate robots' speeds beside the law of animals, and their power
    demands."""
    numbers = compare_robots(settings)
    placed = sorted(numbers.everyone, key=lambda robot: -robot.share)
    title = f"Robots beside the law of animals; {NOT_MEASURED}: not published"
    picture = scaling_figure(numbers)
    return Drawn(numbers, (table_of(title, placed),), {"scaling": picture})


def compare_robots(settings: ScalingFigureSettings) -> ScalingNumbers:
    """Read tables and reports, and compare robots and mammals with the law of
    animals."""
    robots = read_robots()
    own = next(robot for robot in robots if robot.robot == BP2)
    speed = bp2.TREADMILL_TOP_SPEED
    treadmill = dataclasses.replace(own, robot=TREADMILL, top_speed=speed)
    simulated = read_reports(settings.runs) if settings.runs else shipped()
    mammals = read_table(settings.mammals, Mammal) if settings.mammals else ()
    return ScalingNumbers(
        robots=tuple(map(place_robot, robots)),
        treadmill=place_robot(treadmill),
        simulated=tuple(map(place_robot, simulated)),
        mammals=tuple(map(place_mammal, mammals)),
        spread=count_band([robot for robot in robots if robot.robot != BP2]),
    )


def place_robot(robot: PublishedRobot) -> ComparedRobot:
    """Return a robot's speed as a share of the law of animals, and its power demand."""
    law = float(speed_law(robot.mass))
    return ComparedRobot(
        robot.robot,
        robot.mass,
        robot.top_speed,
        law,
        robot.top_speed / law,
        robot.motor_envelope,
        robot.demand(),
        robot.demand(PAPER_GRAVITY),
        robot.wheels,
    )


def place_mammal(mammal: Mammal) -> Species:
    """Return a mammal's speed as a share of the law of animals."""
    speed = mammal.top_speed / KMH
    share = speed / float(speed_law(mammal.mass))
    return Species(mammal.species, mammal.mass, speed, share)


def count_band(robots: Sequence[PublishedRobot]) -> Spread:
    """Return the distribution of robots' power ratios, and which lie in the paper's
    band."""
    known = {
        robot.robot: demand
        for robot in robots
        if (demand := robot.demand(PAPER_GRAVITY)) is not None
    }
    low, high = BAND
    first, median, third = np.quantile(list(known.values()), (0.25, 0.5, 0.75))
    return Spread(
        number=len(known),
        within=tuple(name for name in known if low <= known[name] <= high),
        median=float(median),
        quartiles=(float(first), float(third)),
    )


# --- Simulated robots -----------------------------------------------------------------


def shipped() -> tuple[PublishedRobot, ...]:
    """Return the shipped policy as a robot with BP2's mass and the top speed on its
    card; empty without results."""
    results = load_policy(asset_path("policies/built")).card.results.get(BENCHMARK, {})
    if not (speed := results.get("best_speed")):
        return ()
    name = results.get("robot", "").partition(":")[0] or "own"
    motor = bp2.PEAK_TORQUE, bp2.NO_LOAD_SPEED
    mass = 4.0 * bp2.QUARTER_MASS
    return (_simulated(f"simulated, {name} robot", mass, *motor, speed),)


def read_reports(folders: Sequence[Path]) -> tuple[PublishedRobot, ...]:
    """Return the robots in reports of the topspeed benchmark, with their best speeds
    over 1 s.

    Raises:
        UserError: no such report, or its robot ran no whole second.
    """
    # slow to import, and mostly not needed
    from bp2_rl.paper.figures.runs import read_runs

    robots = []
    for name, report, run in read_runs(folders, BENCHMARK):
        speed = report.results.get(BENCHMARK, {}).get("best_speed")
        if not isinstance(speed, float):
            raise UserError(f"--runs: {name} ran no whole second")
        motor = run.hardware.joint_peak_torque, run.hardware.joint_no_load_speed
        robots.append(_simulated(name, run.mass, *motor, speed))
    return tuple(robots)


def _simulated(
    name: str, mass: float, peak_torque: float, no_load_speed: float, speed: float
) -> PublishedRobot:
    return PublishedRobot(
        name, mass, peak_torque, no_load_speed, speed, wheels=False, source="simulation"
    )


# --- The figure -----------------------------------------------------------------------


@styled
def scaling_figure(numbers: ScalingNumbers) -> Figure:
    """Draw speed over mass, and the ratio of output to motor envelope, robot by
    robot."""
    figure = Figure(figsize=(1.3 * WIDTH, 11.4), layout="constrained")
    law, ratio = figure.subplots(2, 1, height_ratios=(1.0, 0.8))
    _draw_law(law, numbers)
    _draw_ratios(ratio, numbers)
    return figure


def _draw_law(axes: Axes, numbers: ScalingNumbers) -> None:
    for share in SHARES:
        speeds = share * speed_law(MASSES)
        axes.plot(MASSES, speeds, color=QUIET, linewidth=0.7, linestyle=DASHES)
    axes.plot(MASSES, speed_law(MASSES), color=INK, label="law of animals")
    mammals = [(species.mass, species.top_speed) for species in numbers.mammals]
    if mammals:
        axes.scatter(*zip(*mammals, strict=True), s=12, color=QUIET, label="mammals")
    named: set[str] = set()
    for robot in numbers.everyone:
        group = _group(numbers, robot)
        mark, color = GROUPS[group]
        label = None if group in named else group
        size = 9 if mark == "*" else 5
        axes.plot(
            robot.mass,
            robot.top_speed,
            mark,
            ms=size,
            color=color,
            mew=0,
            label=label,
            zorder=3,
        )
        named.add(group)
        if robot.share >= NAMED:
            # BP2's speeds lie close above each other
            left = robot is numbers.treadmill
            note(
                axes,
                f"{robot.name}, {robot.share:.2f} of the law",
                (robot.mass, robot.top_speed),
                (-7 if left else 7, 0),
                ha="right" if left else "left",
                va="center",
                fontsize=7.5,
                color=color,
            )
    points = [*mammals, *((robot.mass, robot.top_speed) for robot in numbers.robots)]
    masses, speeds = zip(*points, (36.0, 0.6), (36.0, 25.0), strict=True)
    axes.set(
        title=f"A   Speed over body mass; dashed: {SHARES[0]:.0%} and {SHARES[1]:.0%} of the law",
        xscale="log",
        yscale="log",
        xlabel="Body mass [kg]",
        ylabel="Greatest speed [m/s]",
        xlim=(0.5 * min(masses), 2.0 * max(masses)),
        ylim=(0.8 * min(speeds), 1.2 * max(speeds)),
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_locator(NullLocator())
    axes.legend(loc="lower right", fontsize=8.5)


def _draw_ratios(axes: Axes, numbers: ScalingNumbers) -> None:
    known = [
        (robot.demand_as_printed, robot)
        for robot in numbers.everyone
        if robot.demand_as_printed is not None
    ]
    ranked = sorted(known, key=lambda pair: pair[0])
    spread = numbers.spread
    axes.axvspan(*BAND, color=QUIET, alpha=0.18, linewidth=0)
    axes.axvline(spread.median, color=INK, linewidth=0.9, linestyle=DASHES)
    note(axes, f"median {spread.median:.2f}", (BAND[1], 0.0), (4, 0), va="center")
    for row, (demand, robot) in enumerate(ranked):
        mark, color = GROUPS[_group(numbers, robot)]
        axes.plot((0.0, demand), (row, row), color=color, linewidth=0.8, alpha=0.6)
        axes.plot(demand, row, mark, ms=5, color=color)
        note(axes, f"{demand:.3f}", (demand, row), (6, 0), va="center", fontsize=7.5)
    name_rows(axes, [robot.name for _, robot in ranked], 7.5)
    axes.set(
        title=f"B   m g v over peak torque x no-load speed: {len(spread.within)} of {spread.number} others in "
        f"{BAND[0]:g} to {BAND[1]:g}",
        xlabel=f"Ratio, g = {PAPER_GRAVITY:g} m/s²",
        xlim=(0.0, 1.1 * ranked[-1][0]),
    )


def _group(numbers: ScalingNumbers, robot: ComparedRobot) -> str:
    if robot in numbers.simulated:
        return "BP2, simulated"
    if robot.name in (BP2, TREADMILL):
        return "BP2, measured"
    return "wheels on legs" if robot.wheels else "legs"
