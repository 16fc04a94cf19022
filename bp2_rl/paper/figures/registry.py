"""The paper's figures by name: the settings that a figure takes, and the function that
draws it.

A new figure is an entry. Nothing slow is imported before a figure is drawn: a mistaken
flag is answered at once.
"""

import pkgutil
from typing import TYPE_CHECKING

from bp2_rl.paper.figures import settings
from bp2_rl.paper.pendulum import settings as pendulum

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn

FIGURES: dict[str, tuple[type[object], str]] = {
    "scaling": (settings.ScalingFigureSettings, "figures.scaling:scaling"),
    "race": (settings.RaceFigureSettings, "figures.race:race"),
    "robot": (settings.RobotFigureSettings, "figures.robot:robot"),
    "rewards": (settings.RewardsFigureSettings, "figures.rewards:rewards"),
    "strides": (settings.StridesFigureSettings, "figures.strides:strides"),
    "operating": (settings.OperatingFigureSettings, "figures.operating:operating"),
    "identifiability": (
        settings.IdentifiabilityFigureSettings,
        "figures.identifiability:identifiability",
    ),
    "binding": (settings.BindingFigureSettings, "figures.binding:binding"),
    "exchange": (pendulum.PendulumExchangeSettings, "pendulum.exchange:study_exchange"),
    "sections": (pendulum.PendulumSectionsSettings, "pendulum.sections:cut_sections"),
    "torque": (pendulum.PendulumTorqueSettings, "pendulum.torque:compare_torques"),
    "map": (pendulum.PendulumMapSettings, "pendulum.reduction:map_reduction"),
    "trapping": (pendulum.PendulumTrappingSettings, "pendulum.trapping:find_trapping"),
    "gaits": (pendulum.PendulumGaitsSettings, "pendulum.gaits:gain_by_gait"),
}
"""Settings (a frozen dataclass with defaults) and drawing function (MODULE:FUNCTION
within `bp2_rl.paper`) of every figure, by name."""


def draw(name: str, told: object) -> "Drawn":
    """Draw the figure of this name with its settings; its module is imported only
    now."""
    return pkgutil.resolve_name(f"bp2_rl.paper.{FIGURES[name][1]}")(told)
