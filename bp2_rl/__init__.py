"""The open training stack for BP2: robot model, reference motion, MDP, learner, policy,
evidence.

    import bp2_rl as bp2

    policy = bp2.load_policy("built")  # a shipped policy, or the folder of a run
    run = bp2.rollout(policy, bp2.Ramp(10.0, hold=5.0))  # in C MuJoCo
    print(run.metrics.best_speed)

    env = bp2.make("bp2")  # a Brax environment
    bp2.train(bp2.preset("imitation", "cpu"), "runs/first")  # uses all processors in a new process

Each public name has its own help, such as `help(bp2_rl.rollout)`.
"""

import importlib
from typing import TYPE_CHECKING, Any

from bp2_rl.base import __version__ as __version__

if TYPE_CHECKING:  # isort: off
    from bp2_rl.base.errors import RunStopped as RunStopped, UserError as UserError
    from bp2_rl.env.bp2_env import BP2Env as BP2Env, make as make
    from bp2_rl.evaluation.judged_training import resume as resume, train as train
    from bp2_rl.learning.policy import Policy as Policy, load_policy as load_policy
    from bp2_rl.robot.hardware import HardwareSpec as HardwareSpec
    from bp2_rl.robot.observation import (
        Mirror as Mirror,
        ObservationTerm as ObservationTerm,
    )
    from bp2_rl.settings.env import EnvConfig as EnvConfig
    from bp2_rl.settings.presets import preset as preset
    from bp2_rl.settings.task import (
        RewardTerm as RewardTerm,
        Task as Task,
        TerminationTerm as TerminationTerm,
    )
    from bp2_rl.settings.training import TrainConfig as TrainConfig
    from bp2_rl.simulation.rollout import (
        RunRequest as RunRequest,
        rollout as rollout,
        simulate as simulate,
    )
    from bp2_rl.simulation.metrics import RunMetrics as RunMetrics
    from bp2_rl.simulation.schedule import (
        Course as Course,
        CourseLeg as CourseLeg,
        Ramp as Ramp,
    )
    from bp2_rl.simulation.trajectory import Trajectory as Trajectory
    from bp2_rl.simulation.world import Push as Push, World as World
# isort: on

HOMES = {
    name: home
    for home, names in {
        "learning.policy": "load_policy Policy",
        "simulation.rollout": "rollout simulate RunRequest",
        "simulation.schedule": "Ramp Course CourseLeg",
        "simulation.trajectory": "Trajectory",
        "simulation.metrics": "RunMetrics",
        "simulation.world": "World Push",
        "settings.presets": "preset",
        "settings.training": "TrainConfig",
        "evaluation.judged_training": "train resume",
        "env.bp2_env": "make BP2Env",
        "settings.env": "EnvConfig",
        "robot.hardware": "HardwareSpec",
        "settings.task": "Task RewardTerm TerminationTerm",
        "robot.observation": "ObservationTerm Mirror",
        "base.errors": "UserError RunStopped",
    }.items()
    for name in names.split()
}
"""Where each public name is defined: its module is imported when the name is asked for,
so that commands start fast."""


__all__ = list(HOMES)  # what help(bp2_rl) shows  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Return a public name of the package."""
    if name not in HOMES:
        raise AttributeError(
            f"bp2_rl has no {name}; its public names are {', '.join(HOMES)}"
        )
    return getattr(importlib.import_module(f"bp2_rl.{HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*HOMES, "__version__"])
