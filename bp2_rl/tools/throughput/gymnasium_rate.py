"""How fast BP2 is in Gymnasium: one robot alone, and many side by side."""

import time
from typing import Any

import numpy as np

from bp2_rl.peers.gymnasium_env import BP2GymEnv
from bp2_rl.peers.gymnasium_vector import BP2VectorEnv
from bp2_rl.settings.env import EnvConfig

WARM_UP = 3  # steps, in which all compiles


def measure_gymnasium(config: EnvConfig, robots: int, seconds: float) -> float:
    """Control steps a second, all robots together, on C MuJoCo, with actions of zero and episodes that begin anew.

    Args:
        config: of the environment.
        robots: 1: the single environment, else the vector environment.
        seconds: to step for.
    """
    env: Any = BP2GymEnv(config=config) if robots == 1 else BP2VectorEnv(robots, config=config)
    action = np.zeros(env.action_space.shape, np.float32)
    env.reset(seed=0)
    for _ in range(WARM_UP):
        env.step(action)
    steps, began = 0, time.perf_counter()
    while (passed := time.perf_counter() - began) < seconds:
        _, _, terminated, _, _ = env.step(action)
        if robots == 1 and terminated:
            env.reset()
        steps += robots
    return steps / passed
