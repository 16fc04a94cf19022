"""The open training stack for BP2: robot model, reference motion, MDP, learner, policy, evidence."""

import importlib.util
import os

__version__ = "0.1.0"

# On CPUs XLA can wait for ever in its own thread pool: a batched kernel of MJX (256 robots on two cores do it) asks
# the pool for help from inside the pool. One thread cannot, and is no slower at these sizes. It must be set before
# JAX starts; set NPROC yourself to have it otherwise.
if os.environ.get("JAX_PLATFORMS") == "cpu" or importlib.util.find_spec("jax_plugins") is None:
    os.environ.setdefault("NPROC", "1")
