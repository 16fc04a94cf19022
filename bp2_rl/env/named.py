"""The environments that have a name: those that `train.py` trains in."""

from collections.abc import Callable

from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.training import make_config

CONFIGS: dict[str, Callable[[], EnvConfig]] = {
    "bp2": lambda: make_config("imitation", "gpu").env,  # the built robot on the library of trots
    "bp2_ideal": lambda: make_config("imitation", "gpu", robot="ideal").env,  # the robot without losses
    "bp2_kinematic": lambda: make_config("imitation", "smoke").env,  # the built robot on the kinematic gait, at 3 m/s
}
"""The settings of each, by its name."""


def maker_of(name: str) -> Callable[..., BP2Env]:
    """What makes the environment of this name; a config of one's own takes the place of its settings."""

    def make(config: EnvConfig | None = None, *, impl: Impl = "jax", num_robots: int = 1) -> BP2Env:
        return BP2Env(config or CONFIGS[name](), impl=impl, num_robots=num_robots)

    return make
