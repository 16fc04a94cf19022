"""The open training stack for BP2: robot model, reference motion, MDP, learner, policy, evidence.

    import bp2_rl

    policy = bp2_rl.load_policy("built")  # one that ships, or the folder of a run
    [run] = bp2_rl.simulate(policy, [bp2_rl.RunRequest(bp2_rl.Ramp((10.0, 0.0, 0.0)))])
    print(bp2_rl.measure(run).best_speed)

`bp2_rl.env` registers the environment `bp2` with Brax.
"""

import pkgutil
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bp2_rl.env.bp2_env import BP2Env as BP2Env
    from bp2_rl.learning.policy import load_policy as load_policy
    from bp2_rl.learning.run import resume as resume
    from bp2_rl.learning.run import start as train  # noqa: F401
    from bp2_rl.settings.env import EnvConfig as EnvConfig
    from bp2_rl.settings.presets import make_config as make_config
    from bp2_rl.simulation.metrics import measure as measure
    from bp2_rl.simulation.rollout import RunRequest as RunRequest
    from bp2_rl.simulation.rollout import simulate as simulate
    from bp2_rl.simulation.schedule import Course as Course
    from bp2_rl.simulation.schedule import Ramp as Ramp
    from bp2_rl.simulation.world import World as World

__version__ = "0.1.0"
HOMES = {
    "BP2Env": "env.bp2_env:BP2Env",
    "EnvConfig": "settings.env:EnvConfig",
    "make_config": "settings.presets:make_config",
    "train": "learning.run:start",
    "resume": "learning.run:resume",
    "load_policy": "learning.policy:load_policy",
    "simulate": "simulation.rollout:simulate",
    "RunRequest": "simulation.rollout:RunRequest",
    "Ramp": "simulation.schedule:Ramp",
    "Course": "simulation.schedule:Course",
    "World": "simulation.world:World",
    "measure": "simulation.metrics:measure",
}
"""Where each public name is defined: its module is imported when the name is asked for, so that commands start fast."""


def __getattr__(name: str) -> Any:
    """Return a public name of the package."""
    if name not in HOMES:
        raise AttributeError(f"bp2_rl has no {name}; its public names are {', '.join(HOMES)}")
    return pkgutil.resolve_name(f"bp2_rl.{HOMES[name]}")


def __dir__() -> list[str]:
    return sorted([*globals(), *HOMES])
