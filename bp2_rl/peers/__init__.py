"""BP2 as an environment of Gymnasium. Gymnasium imports the modules of this package
when an environment is made."""

import sys

GYMNASIUM = {
    "bp2": "BP2-v0",
    "bp2_ideal": "BP2Ideal-v0",
    "bp2_kinematic": "BP2Kinematic-v0",
}
"""Gymnasium's names of the named environments, after `bp2_rl/`."""
EPISODE = 1000  # control steps, 5 s


def register_gymnasium() -> None:
    """Register `bp2_rl/BP2-v0` and the other environments with Gymnasium; a second call
    changes nothing."""
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


# so that `gymnasium.make("bp2_rl.peers:bp2_rl/BP2-v0")` finds it, in any process
if "gymnasium" in sys.modules:
    register_gymnasium()
