"""The figures of the paper that are drawn here: each with its panel, what it may be told, and the function that draws.

A new figure is an entry. Nothing slow is imported before a figure is drawn: a mistaken flag is answered at once.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from bp2_rl.paper.figures.binding.settings import BindingSettings
from bp2_rl.paper.figures.identifiability.settings import IdentifiabilitySettings
from bp2_rl.paper.figures.race.settings import RaceSettings
from bp2_rl.paper.figures.scaling.settings import ScalingSettings
from bp2_rl.paper.figures.settings import (
    LearningSettings,
    OperatingSettings,
    RewardsSettings,
    RobotSettings,
    StridesSettings,
)

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn


class FigureEntry(NamedTuple):
    """One figure."""

    panel: str  # of the paper
    what: str  # it shows
    settings: type[Any]  # a frozen dataclass with defaults
    draw: Callable[[Any], "Drawn"]


def _scaling(settings: ScalingSettings) -> "Drawn":
    from bp2_rl.paper.figures.scaling.figure import scaling

    return scaling(settings)


def _race(settings: RaceSettings) -> "Drawn":
    from bp2_rl.paper.figures.race.figure import race

    return race(settings)


def _robot(settings: RobotSettings) -> "Drawn":
    from bp2_rl.paper.figures.robot import robot

    return robot(settings)


def _rewards(settings: RewardsSettings) -> "Drawn":
    from bp2_rl.paper.figures.rewards import rewards

    return rewards(settings)


def _strides(settings: StridesSettings) -> "Drawn":
    from bp2_rl.paper.figures.strides import strides

    return strides(settings)


def _operating(settings: OperatingSettings) -> "Drawn":
    from bp2_rl.paper.figures.operating import operating

    return operating(settings)


def _learning(settings: LearningSettings) -> "Drawn":
    from bp2_rl.paper.figures.learning import learning

    return learning(settings)


def _identifiability(settings: IdentifiabilitySettings) -> "Drawn":
    from bp2_rl.paper.figures.identifiability.figure import identifiability

    return identifiability(settings)


def _binding(settings: BindingSettings) -> "Drawn":
    from bp2_rl.paper.figures.binding.figure import binding

    return binding(settings)


FIGURES = {
    "scaling": FigureEntry(
        "Fig. 1, inset, Table S1",
        "greatest speed over body mass, and what is asked of the motors",
        ScalingSettings,
        _scaling,
    ),
    "race": FigureEntry("Fig. 6 B-D, Table S2", "100 m beside athletes, and how they start", RaceSettings, _race),
    "robot": FigureEntry(
        "Fig. 2, Fig. S1, Table S3", "the robot as it is modelled, and its dimensions", RobotSettings, _robot
    ),
    "rewards": FigureEntry("Table S4", "reward coefficients, and their weights over speed", RewardsSettings, _rewards),
    "strides": FigureEntry("Fig. 5 A", "three cycles of a run's gait as keyframes", StridesSettings, _strides),
    "operating": FigureEntry("Fig. 5 E", "torque over speed of hips and knees", OperatingSettings, _operating),
    "learning": FigureEntry(
        "beyond the paper",
        "how soon policies run, over control steps and over time",
        LearningSettings,
        _learning,
    ),
    "identifiability": FigureEntry(
        "beyond the paper",
        "which assumptions the paper's numbers pin down, and which nothing does; takes minutes",
        IdentifiabilitySettings,
        _identifiability,
    ),
    "binding": FigureEntry(
        "beyond the paper",
        "which limits hold the optimiser back over speed, and the policy beside it; takes minutes",
        BindingSettings,
        _binding,
    ),
}
"""By name."""
