"""The MDP. Importing this registers `bp2`, `bp2_ideal` and `bp2_kinematic` with `brax.envs`.

It also keeps XLA to one thread on CPUs (`base.workers.use_one_xla_thread`), if JAX has not computed anything yet.
"""

import functools

# isort: off
from bp2_rl.robot import mjx  # noqa: F401  # before Brax, which imports MJX and lets it print
from brax import envs
# isort: on

from bp2_rl.env.bp2_env import BP2Env, make
from bp2_rl.env.named import CONFIGS
from bp2_rl.settings.env import EnvConfig

__all__ = ["BP2Env", "EnvConfig"]

for name in CONFIGS:
    maker = functools.partial(make, name)
    envs.register_environment(name, maker)  # pyright: ignore[reportArgumentType]  # it is only called
