"""The MDP. Importing this registers `bp2` with `brax.envs`."""

# isort: off
from bp2_rl.robot import mjx  # noqa: F401  # before Brax, which imports MJX and lets it print
from brax import envs
# isort: on

from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.settings.env import EnvConfig

__all__ = ["BP2Env", "EnvConfig"]

envs.register_environment("bp2", BP2Env)
