"""Published numbers of robots, animals and athletes: the paper's Tables S1 and S2, the
law of animals, and a user's own tables."""

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated, TypeVar, cast

import numpy as np

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.races import PAPER_BP2, TRACK, TRAINED, UNTRAINED
from bp2_rl.paper.published_tables import ColumnHeading, read_table
from bp2_rl.robot import bp2
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.simulation.measuring import power_demand

FloatOrArray = TypeVar("FloatOrArray", float, np.ndarray)

# --- Robots and animals ---------------------------------------------------------------

TABLE_S1 = "published/robots.csv"
# m/s2, DERIVED: the paper's 1.475 is 36 g 10.74 / (120 x 21.4) with this g; 9.81 gives
# 1.477
PAPER_GRAVITY = 9.8
KMH = 3.6  # km/h in a m/s
Mass = Annotated[float, Within(1e-6, 1e6), ColumnHeading("mass [kg]")]


@dataclasses.dataclass(frozen=True)
class PublishedRobot:
    """One row of the paper's Table S1; what is not published is None."""

    robot: str
    mass: Mass  # kg
    peak_torque: Annotated[
        float | None, Within(1e-3, 1e6), ColumnHeading("peak torque [Nm]")
    ]  # of a motor, at the joint
    no_load_speed: Annotated[
        float | None, Within(1e-3, 1e6), ColumnHeading("no-load speed [rad/s]")
    ]
    top_speed: Annotated[float, Within(1e-3, 1e3), ColumnHeading("top speed [m/s]")]
    wheels: bool  # at the ends of its legs; the paper does not mark them
    source: str

    @property
    def motor_envelope(self) -> float | None:
        """One motor's peak torque x no-load speed, W, which the paper calls "maximum
        motor power envelope"; no motor gives that power."""
        if self.peak_torque is None or self.no_load_speed is None:
            return None
        return self.peak_torque * self.no_load_speed

    def demand(self, gravity: float = GRAVITY) -> float | None:
        """Return the robot's `power_demand` at its top speed; None without motor
        data."""
        envelope = self.motor_envelope
        return envelope and power_demand(self.mass, gravity, self.top_speed, envelope)


@dataclasses.dataclass(frozen=True)
class Mammal:
    """A species in a user's table of mammals, with mass and top speed."""

    species: str
    mass: Mass  # kg
    # as Hirt et al. tabulate it
    top_speed: Annotated[float, Within(1e-3, 1e3), ColumnHeading("top speed [km/h]")]


def read_robots() -> tuple[PublishedRobot, ...]:
    """Return the robots of the paper's Table S1, in its order."""
    return read_table(asset_path(TABLE_S1), PublishedRobot)


def speed_law(mass: FloatOrArray) -> FloatOrArray:
    """Return the greatest running speed of an animal of a mass (kg), m/s: 25.5 m^0.26
    (1 - exp(-22 m^-0.6)) km/h.

    Source: paper, Fig. 1, from Hirt, Jetz, Rall and Brose (Nature Ecology & Evolution
    1, 2017), whose unit is km/h; the paper prints none.
    """
    speed = 25.5 * mass**0.26 * (1.0 - np.exp(-22.0 * mass**-0.6)) / KMH
    return cast(FloatOrArray, speed)


# --- Races over 100 m, beside those of `evaluation.races` ------------------------------

TABLE_S2 = "published/standards.csv"
BOLT_REACTION = 0.146  # s, reaction time; Berlin 2009
# s, Paris 2024 (World Athletics, results of the final)
LYLES_TIME = 9.784
LYLES_REACTION = 0.178
PUBLISHED_ACCELERATIONS = {
    TRAINED: 4.8,
    UNTRAINED: 2.8,
    PAPER_BP2: bp2.LAUNCH_ACCELERATION,
}
"""Mean acceleration over the first 5 m, m/s2; the paper gives the figures of the
people, too."""


@dataclasses.dataclass(frozen=True)
class Standard:
    """One row of the paper's Table S2: the time over 100 m for a national level of
    China."""

    category: str
    level: Annotated[int, Within(1, 9)]  # 1 is the highest
    time: Annotated[float, Within(1.0, 100.0), ColumnHeading("time [s]")]
    source: str


@dataclasses.dataclass(frozen=True)
class SplitRow:
    """One row of a user's table of races: an athlete's split time at a distance."""

    athlete: str
    distance: Annotated[
        float, Within(0.0, TRACK, open_below=True), ColumnHeading("distance [m]")
    ]
    # from the gun
    time: Annotated[
        float, Within(0.0, 1000.0, open_below=True), ColumnHeading("time [s]")
    ]
    reaction: Annotated[float | None, Within(0.0, 1.0), ColumnHeading("reaction [s]")]


@dataclasses.dataclass(frozen=True)
class Athlete:
    """An athlete's race over 100 m: time, reaction and splits, as far as published."""

    name: str
    time: float  # s over 100 m, from the gun
    reaction: float | None  # s, from the gun to the first push; None if not published
    distances: tuple[float, ...] = ()  # m, of the splits
    splits: tuple[float, ...] = ()  # s, from the gun


def read_standards() -> tuple[Standard, ...]:
    """Return the times and levels of the paper's Table S2, in its order."""
    return read_table(asset_path(TABLE_S2), Standard)


def best_level(time: float, category: str) -> int | None:
    """Return the highest level of a category that a time over 100 m (s) meets; None if
    it meets none."""
    met = [
        standard.level
        for standard in read_standards()
        if standard.category == category and time <= standard.time
    ]
    return min(met, default=None)


def read_athletes(path: Path) -> tuple[Athlete, ...]:
    """Read the races in a user's table of splits, in its order.

    Raises:
        UserError: as `read_table`, or where an athlete's splits are no race over 100 m.
    """
    rows = read_table(path, SplitRow)
    by_name: dict[str, list[SplitRow]] = {}
    for row in rows:
        by_name.setdefault(row.athlete, []).append(row)
    return tuple(
        _athlete(f"{path}: {name}", splits) for name, splits in by_name.items()
    )


def _athlete(place: str, rows: list[SplitRow]) -> Athlete:
    first, last = rows[0], rows[-1]
    if len(rows) < 3 or last.distance != TRACK:
        raise UserError(f"{place} needs three splits at least, the last at {TRACK:g} m")
    if any(
        after.distance <= row.distance or after.time <= row.time
        for row, after in itertools.pairwise(rows)
    ):
        raise UserError(f"{place}: distance and time must rise from split to split")
    if (
        any(row.reaction != first.reaction for row in rows)
        or (first.reaction or 0.0) >= first.time
    ):
        raise UserError(
            f"{place}: the reaction must be the same on each line, and end before the first split"
        )
    return Athlete(
        first.athlete,
        last.time,
        first.reaction,
        tuple(row.distance for row in rows),
        tuple(row.time for row in rows),
    )
