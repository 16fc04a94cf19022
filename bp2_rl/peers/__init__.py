"""BP2 among other projects' environments. Nothing here is imported unless its package asks for it."""

import functools
import subprocess
import sys

from bp2_rl.base.errors import UserError, not_installed

GYMNASIUM = {"bp2": "BP2-v0", "bp2_ideal": "BP2Ideal-v0", "bp2_kinematic": "BP2Kinematic-v0"}
"""What each named environment is called in Gymnasium, after `bp2_rl/`."""
PLAYGROUND = {"bp2": "BP2", "bp2_ideal": "BP2Ideal", "bp2_kinematic": "BP2Kinematic"}
"""What each named environment is called in MuJoCo Playground."""
EPISODE = 1000  # control steps, 5 s


def register_gymnasium() -> None:
    """Register `bp2_rl/BP2-v0` and the others with Gymnasium; twice does no harm."""
    import gymnasium

    for name, ours in GYMNASIUM.items():
        if (identity := f"bp2_rl/{ours}") not in gymnasium.registry:
            gymnasium.register(
                identity,
                entry_point="bp2_rl.peers.gymnasium_env:BP2GymEnv",
                vector_entry_point="bp2_rl.peers.gymnasium_vector:BP2VectorEnv",
                max_episode_steps=EPISODE,
                kwargs={"name": name},
            )


def register_playground() -> None:
    """Register `BP2` and the others with MuJoCo Playground's locomotion suite.

    Raises:
        UserError: Playground is not installed, or lacks MuJoCo Menagerie, without which it loads nothing, and cannot
            download it.
    """
    try:
        from mujoco_playground import locomotion
        from mujoco_playground._src import mjx_env
    except ImportError as missing:
        raise not_installed("registering with MuJoCo Playground", "playground", "playground") from missing
    try:
        mjx_env.ensure_menagerie_exists()
    except (OSError, subprocess.CalledProcessError) as failed:
        raise UserError(
            "MuJoCo Playground downloads MuJoCo Menagerie with git before it loads its first environment, and could "
            f"not: try again online, or clone https://github.com/google-deepmind/mujoco_menagerie elsewhere and copy "
            f"it to {mjx_env.MENAGERIE_PATH}"
        ) from failed
    from bp2_rl.peers.playground_env import BP2Playground, default_config

    for name, theirs in PLAYGROUND.items():
        locomotion.register_environment(theirs, BP2Playground, functools.partial(default_config, name))


if "gymnasium" in sys.modules:  # so that `gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0")` finds it, in any process
    register_gymnasium()
