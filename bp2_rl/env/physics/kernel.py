"""The five physics steps of a control step in the fused kernel, all robots of a batch
side by side."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

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
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.coordinates import with_legs
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.step import MuJoCoState, step
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import foot_geom_ids


class KernelPhysics:
    """The physics engine `kernel`: the fused step of `robot.kernel`, on any device.

    Args:
        model: the robot on flat ground, with feet as its only contacts.
        motors: its motors at full strength.
        resistance: of the robot as designed, if it has any.

    Raises:
        UserError: the kernel cannot simulate this robot.
    """

    def __init__(
        self, model: mujoco.MjModel, motors: Actuator, resistance: Resistance | None
    ):
        self.design = Design.of(model)
        self._foot_radius = model.geom_size[foot_geom_ids(model), 0]
        self.drive = Drive(motors, resistance)
        self._one = custom_vmap(self._single)
        self._one.def_vmap(self._batched)

    def __call__(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        """See `interface.PhysicsEngine`; under `jax.vmap` the robots of the batch are
        computed side by side."""
        return self._one(physics, targets, robot)

    def _single(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        batch = jax.tree.map(lambda x: x[None], (physics, targets, robot))
        return jax.tree.map(lambda x: x[0], self._side_by_side(*batch))

    def _batched(
        self,
        size: int,
        batched: list[Physics | Targets | Randomization],
        physics: Physics,
        targets: Targets,
        robot: Randomization,
    ) -> tuple[object, object]:
        """Step a batch, as `custom_vmap`'s rule; inputs that are the same for all
        robots are repeated."""
        arguments = [physics, targets, robot]
        whole = jax.tree.map(
            lambda x, is_batched: (
                x if is_batched else jnp.broadcast_to(x, (size, *x.shape))
            ),
            arguments,
            batched,
        )
        out = self._side_by_side(*whole)
        return out, jax.tree.map(lambda _: True, out)

    def _side_by_side(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "N 4"]]:
        """Step robots that lie along the first axis; inside the kernel they lie along
        the last."""
        design = randomize_design(self.design, robot)
        masses = Masses.of(design, robot.mass.T, robot.com_offset.T)
        robots = Robots(design, masses, robot.friction)
        drive = self.drive.randomized(robot)
        history, remembered = jax.vmap(target_history)(physics, targets)

        def physics_step(
            state: tuple[MuJoCoState, Array], ages: Array
        ) -> tuple[tuple[MuJoCoState, Array], tuple[Array, ...]]:
            moving, torque = state
            now = newest_active(ages, robot.latency)
            issued = jax.tree.map(lambda x: _choose(now, x), history)
            qpos, qvel = moving.qpos.T, moving.qvel.T
            torque, power, resisting = drive.forces(torque, qpos, qvel, issued)
            applied = with_legs(
                jnp.zeros_like(qvel), torque, jnp.zeros_like(torque[:, :4])
            )
            if resisting is not None:
                applied += resisting
            moving, heights = step(robots, moving, applied.T, robot.ground)
            return (moving, torque), (torque, power, heights)

        before = MuJoCoState(physics.qpos.T, physics.qvel.T, physics.qacc_warmstart.T)
        (after, torque), (torques, powers, heights) = jax.lax.scan(
            physics_step, (before, physics.torque), jnp.asarray(TARGET_AGES)
        )
        touching = (self._foot_radius >= heights[-1].T).astype(jnp.float32)
        effort = Effort(
            torque=jnp.mean(torques, axis=0), power=jnp.mean(powers, axis=0)
        )
        moved = jax.tree.map(lambda x: x.T, after)
        return (
            Physics(*moved, torque=torque, targets=remembered),
            effort,
            touching,
        )


def randomize_design(design: Design, robot: Randomization) -> Design:
    """Return the design with each robot's random springs, rotors and slopes, if they
    are randomised."""
    if robot.gravity is not None:
        x, y, z = robot.gravity.T
        design = dataclasses.replace(design, gravity=(x, y, z))
    return dataclasses.replace(
        design,
        stiffness=as_drawn(design.stiffness, robot.spring_stiffness),
        damping=as_drawn(design.damping, robot.spring_damping),
        armature=as_drawn(design.armature, robot.armature),
    )


def _choose(which: Array, among: Float[Array, "N 3 12"]) -> Float[Array, "N 12"]:
    """Return each robot's target number `which`, by selections; a gather would be
    sequential."""
    chosen = among[:, -1]
    for i in reversed(range(among.shape[1] - 1)):
        chosen = jnp.where((which == i)[:, None], among[:, i], chosen)
    return chosen
