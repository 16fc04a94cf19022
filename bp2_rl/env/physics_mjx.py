"""The five physics steps of a control step in MJX."""

import importlib.util
from typing import Literal

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Array, Float
from mujoco import mjx

from bp2_rl.env import randomization
from bp2_rl.env.controller import Targets
from bp2_rl.env.physics import AGES, Effort, Physics, in_force, target_history
from bp2_rl.env.randomization import Randomization
from bp2_rl.errors import UserError
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import Actuator, joint_torque
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, foot_geom_ids


class MjxPhysics:
    """MJX's own JAX implementation, or the one on NVIDIA's Warp.

    Args:
        model: BP2 on flat ground, without what is only seen.
        motors: its motors at full strength.
        impl: `jax` runs anywhere and is deterministic; `warp` is for NVIDIA GPUs and not exactly repeatable.
        num_robots: for `warp`, the largest number of robots in one batch.

    Raises:
        UserError: `impl` cannot run here.
    """

    def __init__(self, model: mujoco.MjModel, motors: Actuator, impl: Literal["jax", "warp"], num_robots: int = 1):
        self.model, self._template = _put_on_device(model, impl, num_robots)
        self.motors = motors
        self._trunk = int(model.body("trunk").id)
        self._feet = foot_geom_ids(model)

    def __call__(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        """See `physics.Simulator`."""
        model = randomization.randomize_model(self.model, robot, self._trunk)
        motors = randomization.randomize_actuator(self.motors, robot)
        history = target_history(physics, targets)
        data = self._template.replace(qpos=physics.qpos, qvel=physics.qvel, qacc_warmstart=physics.qacc_warmstart)

        def substep(carry: tuple[mjx.Data, Array], ages: Array) -> tuple[tuple[mjx.Data, Array], tuple[Array, Array]]:
            data, torque = carry
            q, qd = data.qpos[MOTOR_QPOS], data.qvel[MOTOR_QVEL]
            q_target, qd_target = history[in_force(ages, robot.latency)]
            torque = joint_torque(motors, torque, q, qd, q_target, qd_target, specs.PHYSICS_STEP)
            data = mjx.step(model, data.replace(ctrl=torque))
            return (data, torque), (torque, torque * qd)

        (data, torque), (torques, powers) = jax.lax.scan(substep, (data, physics.torque), jnp.asarray(AGES))
        after = Physics(
            qpos=data.qpos,
            qvel=data.qvel,
            qacc_warmstart=data.qacc_warmstart,
            torque=torque,
            targets=history[:-1],
        )
        touching = data.geom_xpos[self._feet, 2] <= specs.FOOT_RADIUS
        effort = Effort(torque=jnp.mean(torques, axis=0), power=jnp.mean(powers, axis=0))
        return after, effort, touching.astype(jnp.float32)


def _put_on_device(model: mujoco.MjModel, impl: Literal["jax", "warp"], num_robots: int) -> tuple[mjx.Model, mjx.Data]:
    """MJX's model and an empty state."""
    if impl == "jax":
        return mjx.put_model(model), mjx.make_data(model)
    if importlib.util.find_spec("warp") is None:
        raise UserError("--impl warp needs the package warp-lang: pip install 'bp2_rl[warp]', or use --impl jax")
    if jax.default_backend() != "gpu":
        raise UserError(f"--impl warp needs an NVIDIA GPU, and JAX sees only {jax.default_backend()}: use --impl jax")
    feet, limits = len(specs.LEGS), specs.NUM_MOTORS
    rows = 4 * feet + limits  # a pyramidal contact has four
    data = mjx.make_data(model, impl="warp", naconmax=num_robots * feet, njmax=rows)
    return mjx.put_model(model, impl="warp"), data
