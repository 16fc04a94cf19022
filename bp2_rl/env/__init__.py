"""The MDP. Importing this registers `bp2` with `brax.envs`."""

from brax import envs

from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.settings.env import EnvConfig

__all__ = ["BP2Env", "EnvConfig"]

envs.register_environment("bp2", BP2Env)
