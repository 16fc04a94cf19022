"""The figures of the paper that are drawn here: each with its panel, what it may be told, and the function that draws.

A new figure is an entry. Nothing slow is imported before a figure is drawn: a mistaken flag is answered at once.
"""

import pkgutil
from typing import TYPE_CHECKING, Any, NamedTuple

from bp2_rl.paper.figures.settings import (
    BindingSettings,
    IdentifiabilitySettings,
    LearningSettings,
    OperatingSettings,
    RaceSettings,
    RewardsSettings,
    RobotSettings,
    ScalingSettings,
    StridesSettings,
)

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn


class FigureEntry(NamedTuple):
    """One figure."""

    panel: str  # of the paper
    what: str  # it shows
    settings: type[Any]  # a frozen dataclass with defaults
    function: str  # MODULE:NAME within this package: it takes the settings and returns a `Drawn`

    def draw(self, settings: Any) -> "Drawn":
        """Draw the figure; its module is imported only now."""
        return pkgutil.resolve_name(f"{__package__}.{self.function}")(settings)


FIGURES = {
    "scaling": FigureEntry(
        "Fig. 1, inset, Table S1",
        "greatest speed over body mass, and what is asked of the motors",
        ScalingSettings,
        "scaling.figure:scaling",
    ),
    "race": FigureEntry(
        "Fig. 6 B-D, Table S2", "100 m beside athletes, and how they start", RaceSettings, "race.figure:race"
    ),
    "robot": FigureEntry(
        "Fig. 2, Fig. S1, Table S3", "the robot as it is modelled, and its dimensions", RobotSettings, "robot:robot"
    ),
    "rewards": FigureEntry(
        "Table S4", "reward coefficients, and their weights over speed", RewardsSettings, "rewards:rewards"
    ),
    "strides": FigureEntry("Fig. 5 A", "three cycles of a run's gait as keyframes", StridesSettings, "strides:strides"),
    "operating": FigureEntry(
        "Fig. 5 E", "torque over speed of hips and knees", OperatingSettings, "operating:operating"
    ),
    "learning": FigureEntry(
        "beyond the paper",
        "how soon policies run, over control steps and over time",
        LearningSettings,
        "learning:learning",
    ),
    "identifiability": FigureEntry(
        "beyond the paper",
        "which assumptions the paper's numbers pin down, and which nothing does; takes minutes",
        IdentifiabilitySettings,
        "identifiability.figure:identifiability",
    ),
    "binding": FigureEntry(
        "beyond the paper",
        "which limits hold the optimiser back over speed, and the policy beside it; takes minutes",
        BindingSettings,
        "binding:binding",
    ),
}
"""By name."""
