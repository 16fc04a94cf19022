"""The named environments of `make`, and their settings."""

from collections.abc import Callable

from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.presets import preset

CONFIGS: dict[str, Callable[[], EnvConfig]] = {
    # the built robot on the library of trots
    "bp2": lambda: preset("imitation", "gpu").env,
    # the robot without losses
    "bp2_ideal": lambda: preset("imitation", "gpu", robot="ideal").env,
    # the built robot on the kinematic gait, at 3 m/s
    "bp2_kinematic": lambda: preset("imitation", "smoke").env,
}
"""The settings of each environment, by its name."""
