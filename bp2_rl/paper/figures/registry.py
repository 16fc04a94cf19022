"""The figures of the paper that are drawn here: the module and its function are called as the figure.

A new figure is an entry. Nothing slow is imported before a figure is drawn: a mistaken flag is answered at once.
"""

import pkgutil
from typing import TYPE_CHECKING, Any

from bp2_rl.paper.figures import settings

if TYPE_CHECKING:
    from bp2_rl.paper.figures.drawn import Drawn

FIGURES: dict[str, type[Any]] = {
    "scaling": settings.ScalingSettings,
    "race": settings.RaceSettings,
    "robot": settings.RobotSettings,
    "rewards": settings.RewardsSettings,
    "strides": settings.StridesSettings,
    "operating": settings.OperatingSettings,
    "learning": settings.LearningSettings,
    "identifiability": settings.IdentifiabilitySettings,
    "binding": settings.BindingSettings,
}
"""What each of them may be told, a frozen dataclass with defaults that says what is drawn."""


def draw(name: str, told: Any) -> "Drawn":
    """Draw a figure; its module is imported only now."""
    return pkgutil.resolve_name(f"{__package__}.{name}:{name}")(told)
