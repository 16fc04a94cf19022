"""The five physics steps of a control step in MJX."""

import importlib.util
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float

from bp2_rl.base.errors import UserError, not_installed
from bp2_rl.env.controller import Targets
from bp2_rl.env.physics.drive import Drive
from bp2_rl.env.physics.interface import (
    TARGET_AGES,
    Effort,
    Physics,
    newest_active,
    target_history,
)
from bp2_rl.env.randomization import Randomization, as_drawn
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.mjx import mjx
from bp2_rl.robot.model import foot_geom_ids

SOLVER_LIMITS = 1 << 9 | 1 << 10
"""Bits of MuJoCo Warp's warnings that the solver has run out of iterations, without
importing the extra `warp`."""


class MjxPhysics:
    """The physics engines `jax` and `warp`: stock `mjx.step`, under the torques of the
    robot's motors.

    Before each step of 1 ms the motors' torque is computed (PD law, current loop,
    envelope, bus) and applied as `ctrl`; what resists motion (`robot.losses`) is
    applied as `qfrc_applied`. Torque is held for the step and keeps to the envelope at
    the step's start. A hardware's `envelope="throughout"`, which also bounds the torque
    at the step's end, is honoured in C MuJoCo alone (`simulation.simulator`); training
    treats it as `start`, in every engine.

    Args:
        model: the robot on flat ground, without visual geoms.
        motors: its motors at full strength.
        resistance: of the robot as designed, if anything resists.
        impl: `jax` runs anywhere and is deterministic; `warp` is for NVIDIA GPUs and
            not exactly repeatable.
        num_robots: for `warp`, the largest number of robots in one batch.

    Raises:
        UserError: `impl` cannot run here.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        motors: Actuator,
        resistance: Resistance | None,
        impl: Literal["jax", "warp"],
        num_robots: int = 1,
    ):
        self.model, self._template = _put_on_device(model, impl, num_robots)
        self.drive = Drive(motors, resistance)
        self._trunk = int(model.body("trunk").id)
        self._feet = foot_geom_ids(model)
        self._foot_radius = model.geom_size[self._feet, 0]

    def __call__(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        """See `interface.PhysicsEngine`."""
        model = randomize_model(self.model, robot, self._trunk)
        drive = self.drive.randomized(robot)
        history, remembered = target_history(physics, targets)

        def physics_step(
            state: tuple[Array, Array, Array, Array], ages: Array
        ) -> tuple[tuple[Array, Array, Array, Array], tuple[Array, ...]]:
            qpos, qvel, warmstart, torque = state
            now = newest_active(ages, robot.latency)
            issued = jax.tree.map(lambda x: x[now], history)
            torque, power, resisting = drive.forces(torque, qpos, qvel, issued)
            data = self._template.replace(
                qpos=qpos, qvel=qvel, qacc_warmstart=warmstart, ctrl=torque
            )
            if resisting is not None:
                data = data.replace(qfrc_applied=resisting)
            data = mjx.step(model, data)
            after = data.qpos, data.qvel, data.qacc_warmstart, torque
            return after, (torque, power, data.geom_xpos[self._feet, 2])

        # All else in `mjx.Data` is recomputed at each step, to save memory.
        before = physics.qpos, physics.qvel, physics.qacc_warmstart, physics.torque
        after, (torques, powers, heights) = jax.lax.scan(
            physics_step, before, jnp.asarray(TARGET_AGES)
        )
        touching = heights[-1] <= self._foot_radius
        effort = Effort(
            torque=jnp.mean(torques, axis=0), power=jnp.mean(powers, axis=0)
        )
        return Physics(*after, targets=remembered), effort, touching.astype(jnp.float32)


def randomize_model(
    model: mjx.Model, randomization: Randomization, trunk: int
) -> mjx.Model:
    """Return the model with this robot's masses, inertias, trunk centre of mass,
    friction, springs, rotors and slope (`trunk`: body index)."""
    gravity = randomization.gravity
    option = model.opt if gravity is None else model.opt.replace(gravity=gravity)
    return model.replace(
        opt=option,
        body_mass=model.body_mass * randomization.mass,
        body_inertia=model.body_inertia * randomization.mass[:, None],
        body_ipos=model.body_ipos.at[trunk].add(randomization.com_offset),
        geom_friction=model.geom_friction.at[:, 0].set(randomization.friction),
        # In all models only springs have stiffness and damping, and only motors armature.
        jnt_stiffness=as_drawn(model.jnt_stiffness, randomization.spring_stiffness),
        dof_damping=as_drawn(model.dof_damping, randomization.spring_damping),
        dof_armature=as_drawn(model.dof_armature, randomization.armature),
    )


def _put_on_device(
    model: mujoco.MjModel, impl: Literal["jax", "warp"], num_robots: int
) -> tuple[mjx.Model, mjx.Data]:
    """Return MJX's model and an empty state on this process's own device; MJX would
    take the first of all processes."""
    device = jax.local_devices()[0]
    if impl == "jax":
        return mjx.put_model(model, device=device), mjx.make_data(model, device=device)
    if importlib.util.find_spec("warp") is None:
        raise not_installed("--impl warp", "warp-lang", "warp", ", or use --impl jax")
    if jax.default_backend() != "gpu":
        raise UserError(
            f"--impl warp needs an NVIDIA GPU, and JAX sees only {jax.default_backend()}: use --impl jax"
        )
    feet, limits = len(conventions.LEGS), conventions.NUM_MOTORS
    rows = 4 * feet + limits  # a pyramidal contact has four
    data = mjx.make_data(
        model, impl="warp", device=device, naconmax=num_robots * feet, njmax=rows
    )
    device_model: Any = mjx.put_model(model, impl="warp", device=device)
    # Training uses a few solver iterations without convergence; Warp would print a
    # warning at each step.
    warnings = {
        "opt._impl.warn_overflow": device_model.opt._impl.warn_overflow & ~SOLVER_LIMITS
    }
    return device_model.tree_replace(warnings), data
