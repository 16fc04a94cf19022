"""The environments that have a name: those that `train.py` trains in."""

from collections.abc import Callable

from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.presets import make_config

CONFIGS: dict[str, Callable[[], EnvConfig]] = {
    "bp2": lambda: make_config("imitation", "gpu").env,  # the built robot on the library of trots
    "bp2_ideal": lambda: make_config("imitation", "gpu", robot="ideal").env,  # the robot without losses
    "bp2_kinematic": lambda: make_config("imitation", "smoke").env,  # the built robot on the kinematic gait, at 3 m/s
}
"""The settings of each environment, by its name."""
DEFAULT = "bp2"
"""The environment that `BP2Env()` is."""
