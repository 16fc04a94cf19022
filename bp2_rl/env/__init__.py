"""The MDP. Importing `bp2_env` registers `bp2`, `bp2_ideal` and `bp2_kinematic` with
`brax.envs`.

Importing this package limits XLA to one thread on CPUs, unless JAX has computed
something before.
"""

from bp2_rl.base.processes import use_one_xla_thread

use_one_xla_thread()
