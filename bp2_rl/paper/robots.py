"""How fast robots run for what they weigh and what their motors give: the paper's Table
S1, and the law of animals."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.paper.published_tables import ColumnHeading, read_table
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.simulation.measuring import power_demand

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
        """One motor's peak torque x no-load speed, W: the paper's "maximum motor power
        envelope", and no power."""
        if self.peak_torque is None or self.no_load_speed is None:
            return None
        return self.peak_torque * self.no_load_speed

    def demand(self, gravity: float = GRAVITY) -> float | None:
        """`power_demand` at its top speed; None without motor data."""
        if self.peak_torque is None or self.no_load_speed is None:
            return None
        return power_demand(
            self.mass, gravity, self.top_speed, self.peak_torque, self.no_load_speed
        )


@dataclasses.dataclass(frozen=True)
class Mammal:
    """One species of a user's table."""

    species: str
    mass: Mass  # kg
    # as Hirt et al. tabulate it
    top_speed: Annotated[float, Within(1e-3, 1e3), ColumnHeading("top speed [km/h]")]


def read_robots() -> tuple[PublishedRobot, ...]:
    """The paper's Table S1, in its order."""
    return read_table(asset_path(TABLE_S1), PublishedRobot)


def read_mammals(path: Path) -> tuple[Mammal, ...]:
    """A user's table of mammals; raises as `read_table`."""
    return read_table(path, Mammal)


def speed_law(mass: Any) -> Any:
    """The greatest running speed of an animal of a mass (kg, "..."), m/s: 25.5 m^0.26
    (1 - exp(-22 m^-0.6)) km/h.

    Source: paper, Fig. 1, from Hirt, Jetz, Rall and Brose (Nature Ecology & Evolution
    1, 2017), whose unit is km/h; the paper prints none.
    """
    return 25.5 * mass**0.26 * (1.0 - np.exp(-22.0 * mass**-0.6)) / KMH
