"""How fast robots run beside the law of animals, and what they ask of their motors."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.learning.policy import load_policy
from bp2_rl.paper.figures.drawn import Comparison
from bp2_rl.paper.figures.settings import ScalingSettings
from bp2_rl.paper.robots import (
    KMH,
    PAPER_GRAVITY,
    Mammal,
    PublishedRobot,
    read_mammals,
    read_robots,
    speed_law,
)
from bp2_rl.robot import bp2, conventions
from bp2_rl.simulation.measuring import froude_number

BENCHMARK = "topspeed"
BP2, TREADMILL = "BP2", "BP2, treadmill"  # the first as in Table S1
DEMANDING, HOUND, RUNNER_UP = "KAIST Raibo2", "KAIST Hound", "WildCat"
BAND = 0.6, 0.8  # in which the paper has the ratio "typically distributed"
PAPER_DEMAND, PAPER_FROUDE = 1.475, 21.4  # paper, Results and Abstract
HOUND_POWER = 1706.0  # W, of a motor at most: paper, Results


@dataclasses.dataclass(frozen=True)
class ComparedRobot:
    """A robot in the figure."""

    name: str
    mass: float  # kg
    top_speed: float  # m/s
    law_speed: float  # m/s, of an animal of its mass
    share: float  # of that
    motor_envelope: float | None  # W, one motor's peak torque x no-load speed
    demand: float | None  # m g v over that, with 9.81 m/s2
    demand_as_printed: float | None  # the demand with the paper's 9.8 m/s2
    wheels: bool


@dataclasses.dataclass(frozen=True)
class Spread:
    """The paper's "typically distributed between 0.6 and 0.8", counted: Table S1
    without BP2, with the paper's g."""

    below: tuple[str, ...]
    within: tuple[str, ...]
    above: tuple[str, ...]
    unknown: tuple[str, ...]  # without motor data
    median: float
    quartiles: tuple[float, float]
    legged_within: tuple[str, ...]  # without those on wheels
    legged: int

    @property
    def number(self) -> int:
        """How many robots there are motor data of."""
        return len(self.below) + len(self.within) + len(self.above)


@dataclasses.dataclass(frozen=True)
class Species:
    """A mammal in the figure."""

    name: str
    mass: float  # kg
    top_speed: float  # m/s
    share: float  # of the law's


@dataclasses.dataclass(frozen=True)
class ScalingNumbers:
    """All that the figure shows."""

    robots: tuple[ComparedRobot, ...]  # Table S1
    treadmill: ComparedRobot
    simulated: tuple[ComparedRobot, ...]
    mammals: tuple[Species, ...]
    spread: Spread
    froude: float  # v^2 / (g h) of BP2 at its top speed outdoors, h its standing height
    # BP2's with the 35.8 kg of Table S3 and 9.81 m/s2, as reports here have it
    demand_of_table_s3: float
    corner_power: float  # W, of one motor of BP2: peak torque x corner speed

    @property
    def bp2(self) -> ComparedRobot:
        """Outdoors."""
        return find(self.robots, BP2)


def measure(settings: ScalingSettings) -> ScalingNumbers:
    """Read the tables and the reports, and place what is in them."""
    robots = read_robots()
    published = next(robot for robot in robots if robot.robot == BP2)
    treadmill = dataclasses.replace(
        published, robot=TREADMILL, top_speed=bp2.TREADMILL_TOP_SPEED
    )
    simulated = read_reports(settings.runs) if settings.runs else shipped()
    mammals = read_mammals(settings.mammals) if settings.mammals else ()
    own = dataclasses.replace(published, mass=4.0 * bp2.QUARTER_MASS).demand()
    assert own is not None  # it has motors
    return ScalingNumbers(
        robots=tuple(map(place, robots)),
        treadmill=place(treadmill),
        simulated=tuple(map(place, simulated)),
        mammals=tuple(map(place_mammal, mammals)),
        spread=count([robot for robot in robots if robot.robot != BP2]),
        froude=froude_number(published.top_speed),
        demand_of_table_s3=own,
        corner_power=bp2.PEAK_TORQUE * bp2.CORNER_SPEED,
    )


def place(robot: PublishedRobot) -> ComparedRobot:
    """A robot beside the law and its motors."""
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
    """A mammal beside the law."""
    speed = mammal.top_speed / KMH
    return Species(
        mammal.species, mammal.mass, speed, speed / float(speed_law(mammal.mass))
    )


def count(robots: Sequence[PublishedRobot]) -> Spread:
    """Which robots are within the paper's band."""
    known = {
        robot: demand
        for robot in robots
        if (demand := robot.demand(PAPER_GRAVITY)) is not None
    }
    low, high = BAND
    first, median, third = np.quantile(list(known.values()), (0.25, 0.5, 0.75))
    within = tuple(robot for robot, demand in known.items() if low <= demand <= high)
    return Spread(
        below=tuple(robot.robot for robot, demand in known.items() if demand < low),
        within=tuple(robot.robot for robot in within),
        above=tuple(robot.robot for robot, demand in known.items() if demand > high),
        unknown=tuple(robot.robot for robot in robots if robot not in known),
        median=float(median),
        quartiles=(float(first), float(third)),
        legged_within=tuple(robot.robot for robot in within if not robot.wheels),
        legged=sum(not robot.wheels for robot in known),
    )


def find(robots: Sequence[ComparedRobot], name: str) -> ComparedRobot:
    """The robot of a name."""
    return next(robot for robot in robots if robot.name == name)


# --- Simulated robots -----------------------------------------------------------------


def shipped() -> tuple[PublishedRobot, ...]:
    """The policy that ships, as its card has it: on the built robot, and of the model's
    mass; none without results."""
    card = load_policy(asset_path("policies/built")).card
    speed = card.results.get(BENCHMARK, {}).get("best_speed")
    name = card.results.get(BENCHMARK, {}).get("robot", "").partition(":")[0]
    return (
        ()
        if not speed
        else (
            _simulated(
                f"simulated, {name or 'own'} robot", 4.0 * bp2.QUARTER_MASS, speed
            ),
        )
    )


def read_reports(folders: Sequence[Path]) -> tuple[PublishedRobot, ...]:
    """The robots of topspeed reports, at their best seconds.

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
        hardware = run.hardware
        robots.append(
            _simulated(
                name,
                run.mass,
                speed,
                hardware.joint_peak_torque,
                hardware.joint_no_load_speed,
            )
        )
    return tuple(robots)


def _simulated(
    name: str,
    mass: float,
    speed: float,
    peak_torque: float = bp2.PEAK_TORQUE,
    no_load_speed: float = bp2.NO_LOAD_SPEED,
) -> PublishedRobot:
    return PublishedRobot(
        name, mass, peak_torque, no_load_speed, speed, wheels=False, source="simulation"
    )


# --- What comes of the paper's statements ---------------------------------------------


def compare(numbers: ScalingNumbers) -> tuple[Comparison, ...]:
    """What the paper says of the figure, and what the numbers say."""
    own, spread = numbers.bp2, numbers.spread
    raibo2, hound, wildcat = (
        find(numbers.robots, name) for name in (DEMANDING, HOUND, RUNNER_UP)
    )
    assert own.demand is not None  # these two have motor data
    assert own.demand_as_printed is not None
    assert raibo2.demand_as_printed is not None
    least = min(
        robot.demand_as_printed for robot in numbers.robots if robot.demand_as_printed
    )
    fastest = max(
        (r for r in numbers.robots if r.name not in (BP2, RUNNER_UP)),
        key=lambda r: r.share,
    )
    return (
        Comparison(
            "the law is 25.5 m^0.26 (1 - exp(-22 m^-0.6)), without a unit",
            f"{own.law_speed:.2f} m/s at {own.mass:g} kg, {wildcat.law_speed:.2f} m/s at {wildcat.mass:g} kg",
            "same",
            "it is in km/h in its source; read as m/s it would be 3.6 times as much",
        ),
        Comparison(
            "robots run significantly slower than animals",
            f"BP2 at {own.share:.2f} of the law outdoors, {numbers.treadmill.share:.2f} on the treadmill; "
            f"{wildcat.name} {wildcat.share:.2f}, then {fastest.name} {fastest.share:.2f}",
            "same",
        ),
        Comparison(
            f"BP2's ratio is {PAPER_DEMAND:g}",
            f"{own.demand_as_printed:.3f} with g = {PAPER_GRAVITY:g}, {own.demand:.3f} with {conventions.GRAVITY:g}, "
            f"{numbers.demand_of_table_s3:.3f} with the {4.0 * bp2.QUARTER_MASS:g} kg of Table S3",
            "same",
        ),
        Comparison(
            f"the ratio is typically between {BAND[0]:g} and {BAND[1]:g}",
            f"{len(spread.within)} of the {spread.number} others with motor data are; {len(spread.below)} are below, "
            f"{len(spread.above)} above; median {spread.median:.2f}, half of them from {spread.quartiles[0]:.2f} to "
            f"{spread.quartiles[1]:.2f}; on legs alone {len(spread.legged_within)} of {spread.legged}",
            "differs",
            f"Table S1 spreads from {least:.2f} to {raibo2.demand_as_printed:.2f}",
        ),
        Comparison(
            "Raibo2 reaches approximately 1.2",
            f"{raibo2.demand_as_printed:.2f}, the greatest of the others",
            "same",
        ),
        Comparison(
            "BP2's ratio is markedly higher than any other",
            f"{own.demand_as_printed / raibo2.demand_as_printed:.2f} times the next",
            "same",
        ),
        Comparison(
            "the ratio is that of output to the maximum motor power envelope",
            f"peak torque x no-load speed: {own.motor_envelope:.0f} W of one BP2 motor that gives "
            f"{numbers.corner_power:.0f} W at its corner; {hound.motor_envelope:.0f} W of one Hound motor that gave "
            f"{HOUND_POWER:.0f} W",
            "not comparable",
            "no motor gives peak torque at no-load speed, so the product is no power, and by how much differs by motor",
        ),
        Comparison(
            f"10.74 m/s is a Froude number of {PAPER_FROUDE:g}",
            f"{numbers.froude:.1f}, v² / (g h) with the standing height of {bp2.STANDING_HEIGHT:g} m",
            "same",
        ),
        Comparison(
            "WildCat is in the figure",
            "in the law's panel; Table S1 has no motor data of it",
            "not comparable",
            "its ratio is unknown",
        ),
        _mammals(numbers),
    )


def _mammals(numbers: ScalingNumbers) -> Comparison:
    paper = "171 species of mammals follow the law"
    if not numbers.mammals:
        return Comparison(
            paper,
            "none ship here",
            "not comparable",
            "the table's licence is unclear: see --mammals",
        )
    shares = [species.share for species in numbers.mammals]
    first, median, third = np.quantile(shares, (0.25, 0.5, 0.75))
    found = f"{len(shares)} species: median {median:.2f} of the law, half of them from {first:.2f} to {third:.2f}"
    return Comparison(
        paper,
        found,
        "same" if first <= 1.0 <= third else "differs",
        "by the table given",
    )
