"""The open training stack for BP2: robot model, reference motion, MDP, learner, policy, evidence.

    import bp2_rl as bp2

    policy = bp2.load_policy("built")  # one that ships, or the folder of a run
    run = bp2.rollout(policy, bp2.Ramp(10.0, hold=5.0))  # in C MuJoCo
    print(run.metrics.best_speed)

    env = bp2.make("bp2")  # a Brax environment
    bp2.train(bp2.preset("imitation", "cpu"), "runs/first")  # in a Python of its own it takes all processors

The public names, each with its own help, such as `help(bp2_rl.rollout)`:

    load_policy, rollout, simulate, RunRequest    run policies in C MuJoCo
    Ramp, Course, World, Push                     what the robot is asked to do, and what it meets
    preset, TrainConfig, train, resume            train policies
    make, BP2Env, EnvConfig, HardwareSpec         the environment, its settings and its robot
    UserError, RunStopped                         wrong input, and a run that ends early with its work kept
"""

import pkgutil
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bp2_rl.base.errors import RunStopped as RunStopped
    from bp2_rl.base.errors import UserError as UserError
    from bp2_rl.env.bp2_env import BP2Env as BP2Env
    from bp2_rl.env.bp2_env import make_env as make  # noqa: F401
    from bp2_rl.evaluation.judged_training import resume as resume
    from bp2_rl.evaluation.judged_training import train as train
    from bp2_rl.learning.policy import load_policy as load_policy
    from bp2_rl.robot.hardware import HardwareSpec as HardwareSpec
    from bp2_rl.settings.env import EnvConfig as EnvConfig
    from bp2_rl.settings.presets import make_config as preset  # noqa: F401
    from bp2_rl.settings.training import TrainConfig as TrainConfig
    from bp2_rl.simulation.rollout import RunRequest as RunRequest
    from bp2_rl.simulation.rollout import rollout as rollout
    from bp2_rl.simulation.rollout import simulate as simulate
    from bp2_rl.simulation.schedule import Course as Course
    from bp2_rl.simulation.schedule import Ramp as Ramp
    from bp2_rl.simulation.world import Push as Push
    from bp2_rl.simulation.world import World as World

__version__ = "0.1.0"
IMPORTED_AT = time.time()
"""s since 1970: a source written later may not be what this process has imported."""
HOMES = {
    "load_policy": "learning.policy:load_policy",
    "rollout": "simulation.rollout:rollout",
    "simulate": "simulation.rollout:simulate",
    "RunRequest": "simulation.rollout:RunRequest",
    "Ramp": "simulation.schedule:Ramp",
    "Course": "simulation.schedule:Course",
    "World": "simulation.world:World",
    "Push": "simulation.world:Push",
    "HardwareSpec": "robot.hardware:HardwareSpec",
    "make": "env.bp2_env:make_env",
    "BP2Env": "env.bp2_env:BP2Env",
    "EnvConfig": "settings.env:EnvConfig",
    "preset": "settings.presets:make_config",
    "train": "evaluation.judged_training:train",
    "resume": "evaluation.judged_training:resume",
    "TrainConfig": "settings.training:TrainConfig",
    "UserError": "base.errors:UserError",
    "RunStopped": "base.errors:RunStopped",
}
"""Where each public name is defined: its module is imported when the name is asked for, so that commands start fast."""


__all__ = list(HOMES)  # what help(bp2_rl) shows  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Return a public name of the package."""
    if name not in HOMES:
        raise AttributeError(f"bp2_rl has no {name}; its public names are {', '.join(HOMES)}")
    return pkgutil.resolve_name(f"bp2_rl.{HOMES[name]}")


def __dir__() -> list[str]:
    return sorted([*HOMES, "__version__"])
