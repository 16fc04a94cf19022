"""Settings of the pendulums' figures, and BP2 as pendulums on a beam; read before
anything slow is imported."""

import dataclasses
import math
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.robot import bp2, conventions

# --- BP2: its legs hang from its trunk, so much is left of it here --------------------

MASS_RATIO = (
    4.0 * bp2.TRUNK_QUARTER_MASS / (bp2.THIGH_MASS + bp2.SHANK_MASS + bp2.TOE_MASS)
)
"""Mass of BP2's trunk over the mass of one leg."""
LEG_LENGTH = bp2.THIGH_LENGTH
"""Length of the pendulum that a leg stands for, m. ASSUMED: the leg's mass is in its
thigh, folded up to its knee."""
STRIDE_FREQUENCY = 3.2
"""Stride frequency, Hz, DERIVED: the period of the shipped library's trot at 10 m/s is
0.315 s."""
HIP_AMPLITUDE = 0.6
"""Amplitude of a hip's swing, rad, ASSUMED. In the library's trot at 10 m/s a hip
swings by 0.75 rad either way; a wider swing gains less."""


def reduced_frequency(frequency: float, length: float) -> float:
    """Return W, a frequency in Hz over the frequency of a pendulum's small swings.

    Args:
        frequency: Hz.
        length: of the pendulum, m.
    """
    return 2.0 * math.pi * frequency * math.sqrt(length / conventions.GRAVITY)


# --- Settings -------------------------------------------------------------------------

MassRatio = Annotated[float, Within(0.05, 1e4)]
"""The beam's mass over one pendulum's. A lighter beam whirls so fast that the
integration takes minutes."""
Angle = Annotated[float, Within(1e-3, 3.1), tyro.conf.arg(metavar="RAD")]
"""Angle to which a pendulum is lifted, or swings."""
Swing = Annotated[float, Within(0.3, 1.5), tyro.conf.arg(metavar="RAD")]
"""Amplitude whose trapping is studied. Below the bounds, an exchange takes hundreds of
periods and the search minutes; above, the law is no guide for it."""
Periods = Annotated[float, Within(2.0, 1000.0), tyro.conf.arg(metavar="T0")]
"""How long a motion is watched, in periods of one small swing."""
Hertz = Annotated[float, Within(0.01, 1000.0), tyro.conf.arg(metavar="HZ")]
Length = Annotated[float, Within(0.001, 1000.0), tyro.conf.arg(metavar="M")]


MOST = 12  # values of a list: rows, columns or panels of a picture


@dataclasses.dataclass(frozen=True)
class PendulumSettings(Bounded, path="--"):
    """Settings of a figure of pendulums; each list has a value at least, and none
    twice."""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        super().__post_init__()
        for name, values in vars(self).items():
            if not isinstance(values, tuple):
                continue
            flag = f"--{name.replace('_', '-')}"
            if not 1 <= len(values) <= MOST:
                raise UserError(f"{flag} takes 1 to {MOST} values, got {len(values)}")
            if len(set(values)) < len(values):
                shown = " ".join(f"{value:g}" for value in values)
                raise UserError(f"{flag}: {shown} has a value twice")


@dataclasses.dataclass(frozen=True)
class DrivenSettings(PendulumSettings):
    """Settings of a figure of pendulums that motors drive."""

    frequency: Hertz = 5.0
    """of the motion; the paper's by default"""
    length: Length = 1.0
    """of a pendulum: the paper gives none, and in Hz the frequency needs one"""

    def __post_init__(self) -> None:
        """Refuse impossible values, and a motion at resonance."""
        super().__post_init__()
        driven_frequency(self.frequency, self.length)


@dataclasses.dataclass(frozen=True)
class PendulumExchangeSettings(PendulumSettings):
    """Figure of two pendulums' energies after one is released (paper, Fig. 3C)."""

    mass_ratio: tuple[MassRatio, ...] = (1.0, 2.0, 5.0)
    """the beam's mass over one pendulum's; a row of the picture each"""
    amplitude: Angle = math.pi / 3.0
    """from which the first is let go; the paper's 60 deg by default"""
    periods: Periods = 40.0


@dataclasses.dataclass(frozen=True)
class PendulumSectionsSettings(PendulumSettings):
    """Figure of Poincare sections of two pendulums, by mass ratio (paper, Fig. 3D)."""

    mass_ratio: tuple[MassRatio, ...] = (0.5, 1.0, 5.0, 20.0, 25.0, 100.0)
    """the beam's mass over one pendulum's; a panel each"""
    amplitude: Angle = math.pi / 3.0
    """from which the first is let go; the paper's 60 deg by default"""
    periods: Periods = 200.0


@dataclasses.dataclass(frozen=True)
class PendulumTorqueSettings(DrivenSettings):
    """Figure of two pendulums' torques, beam free and beam fixed (paper, Fig. 3E)."""

    mass_ratio: MassRatio = 1.0
    """the beam's mass over one pendulum's"""
    amplitude: Angle = 1.0
    phase: Annotated[
        float, Within(-2.0 * math.pi, 2.0 * math.pi), tyro.conf.arg(metavar="RAD")
    ] = math.pi / 4.0
    """by which the second is ahead of the first"""


@dataclasses.dataclass(frozen=True)
class PendulumMapSettings(DrivenSettings):
    """Figure of the peak torque that a free beam saves two pendulums, and BP2.

    Frequency and length are those of the maps over amplitudes, but BP2's.
    """

    mass_ratio: tuple[MassRatio, ...] = (0.5, 1.0, 4.0)
    """the beam's mass over one pendulum's, a column for each; another column is
    BP2's"""


@dataclasses.dataclass(frozen=True)
class PendulumTrappingSettings(PendulumSettings):
    """Figure of the beam mass that traps a swing in its pendulum (beyond the paper)."""

    thresholds: tuple[Swing, ...] = (0.5, 0.6, 0.8, math.pi / 3.0, 1.2, 1.4)
    """amplitudes of the thresholds, rad"""


@dataclasses.dataclass(frozen=True)
class PendulumGaitsSettings(DrivenSettings):
    """Figure of torque saved by a free beam, four legs, by gait (beyond the paper)."""

    mass_ratio: tuple[MassRatio, ...] = (MASS_RATIO, 1.0)
    """the beam's mass over one leg's; BP2's trunk over its leg and the paper's by
    default; a panel each"""
    amplitude: Angle = HIP_AMPLITUDE
    frequency: Hertz = STRIDE_FREQUENCY
    """of the stride; BP2's at 10 m/s by default"""
    length: Length = LEG_LENGTH
    """of the pendulum that a leg stands for; BP2's thigh by default"""


def driven_frequency(frequency: float, length: float) -> float:
    """Return `reduced_frequency` of a driven motion, which must not be at resonance.

    Raises:
        UserError: it is the pendulum's own, where a fixed beam asks for hardly any
            torque to compare with.
    """
    reduced = reduced_frequency(frequency, length)
    if abs(reduced - 1.0) < 1e-3:
        raise UserError(
            f"{frequency:g} Hz is a pendulum's own frequency at a length of {length:g} m, where a fixed beam asks for "
            "no torque to compare with: choose another --frequency or --length"
        )
    return reduced
