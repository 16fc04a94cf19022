"""The open training stack for BP2: robot model, reference motion, MDP, learner, policy, evidence."""

import importlib.util
import os

__version__ = "0.1.0"

# On CPUs XLA can wait for ever in its own thread pool: a batched kernel of MJX (256 robots on two cores do it) asks
# the pool for help from inside the pool. One thread cannot. It must be set before JAX starts; trainings in which C
# MuJoCo simulates set it anew (`cli/train.py`). Set NPROC yourself to have it otherwise.
NPROC_IS_OURS = "NPROC" not in os.environ
if NPROC_IS_OURS and (os.environ.get("JAX_PLATFORMS") == "cpu" or importlib.util.find_spec("jax_plugins") is None):
    os.environ["NPROC"] = "1"
