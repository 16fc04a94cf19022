"""The interface of the physics engines: five physics steps of 1 ms per control step.

Every engine recomputes the joint torque (PD law, current loop, envelope, bus) at each
physics step:

    jax     MJX as it is (`physics.mjx`): the reference, runs anywhere
    kernel  the same equations, fused (`physics.kernel`): the fastest, runs anywhere
    warp    MJX on NVIDIA's Warp (`physics.mjx`): for NVIDIA GPUs, not exactly repeatable
"""

from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int

from bp2_rl.base import arrays
from bp2_rl.env.controller import Targets
from bp2_rl.env.randomization import Randomization
from bp2_rl.robot import conventions


def target_ages(targets: int) -> Float[np.ndarray, "5 targets"]:
    """Return the age, s, of the last joint targets, newest first, at the start of every
    physics step of a control step."""
    return np.add.outer(
        conventions.PHYSICS_STEP * np.arange(conventions.SUBSTEPS),
        conventions.CONTROL_STEP * np.arange(targets),
    )


TARGET_AGES = target_ages(3)
"""Ages, s, of the targets in `target_history`, at every physics step."""
LONGEST_LATENCY = float(TARGET_AGES[0, -1])  # s, the longest age of a remembered target


class Physics(struct.PyTreeNode):
    """The state of a simulated robot between two control steps, its motors included."""

    qpos: Float[Array, "... nq"]
    qvel: Float[Array, "... nv"]
    qacc_warmstart: Float[Array, "... nv"]
    torque: Float[Array, "... 12"]  # Nm, last applied
    targets: Targets  # the last two, newest first: "... 2 12" each


class Effort(struct.PyTreeNode):
    """The motors' mean torque and power in one control step."""

    torque: Float[Array, "... 12"]  # Nm, mean
    power: Float[Array, "... 12"]  # W, mean mechanical


@runtime_checkable
class PhysicsEngine(Protocol):
    """A physics engine: a pure function that one can jit, vmap and scan."""

    def __call__(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        """Advance one robot by five physics steps.

        Return the state afterwards, the mean effort, and 1 for each foot that touches
        the ground at the start of the last physics step.
        """
        ...


def newest_active(
    ages: Float[arrays.Array, " targets"], latency: Float[arrays.Array, "*robots"]
) -> Int[arrays.Array, "*robots"]:
    """Return the index of the target that the joints follow: the newest that is older
    than the latency (s).

    NumPy and JAX arrays alike.
    """
    xp = latency.__array_namespace__()
    return xp.argmax(ages >= latency[..., None] - 1e-6, axis=-1)


def target_history(physics: Physics, targets: Targets) -> tuple[Targets, Targets]:
    """Return the joint targets of this and of the last two control steps, newest first
    ("3 12"), and the first two."""
    history = jax.tree.map(
        lambda now, before: jnp.concatenate([now[None], before]),
        targets,
        physics.targets,
    )
    return history, jax.tree.map(lambda x: x[:-1], history)
