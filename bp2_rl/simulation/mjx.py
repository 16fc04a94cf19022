"""The simulator with MJX's physics, the reference engine of training, in place of C
MuJoCo's."""

import functools
from collections.abc import Callable, Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from bp2_rl.base.errors import UserError
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.mjx import mjx
from bp2_rl.robot.model import load_model
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.simulator import OneByOne, RobotSetup


class MjxSimulator(OneByOne):
    """N robots whose states MJX advances, with training's solver settings, in float32
    on JAX's default device.

    As in training torque keeps to the envelope at a step's start alone, and legs pass
    through each other. Foot forces are C MuJoCo's for the states and torques, because
    MJX keeps its own in private fields.

    Raises:
        UserError: a robot has another world than level ground, other numerics, or is
            drawn.
    """

    backend: ClassVar[Backend] = "mjx"
    takes_again: ClassVar[bool] = False

    def __init__(
        self,
        robots: Sequence[RobotSetup],
        models: Sequence[mujoco.MjModel] | None = None,
    ):
        if any(robot != RobotSetup(robot.config) for robot in robots):
            raise UserError(
                "MJX runs robots as designed on level ground without other numerics; use --backend mujoco"
            )
        super().__init__(robots, models)
        self._physics = [_compiled_step(robot.config.hardware) for robot in robots]

    def _take_steps(self, robot: int, data: mujoco.MjData, steps: int) -> None:
        mujoco.mj_forward(self.models[robot], data)  # for the forces on the feet
        before = data.qpos, data.qvel, data.qacc_warmstart, data.ctrl, data.qfrc_applied
        qpos, qvel, warm_start = self._physics[robot](*before)
        data.qpos[:] = qpos
        data.qvel[:] = qvel
        data.qacc_warmstart[:] = warm_start
        data.time += self.models[robot].opt.timestep


@functools.lru_cache(maxsize=8)
def _compiled_step(hardware: HardwareSpec) -> Callable[..., tuple[jax.Array, ...]]:
    """Return a physics step: (qpos, qvel, warm start, ctrl, qfrc_applied) -> (qpos,
    qvel, warm start)."""
    # a robot falls before its trunk touches
    model = load_model(hardware, visual=False, feet_only=True)
    on_device = mjx.put_model(model)
    template = mjx.make_data(model)

    @jax.jit
    def step(*before: jax.Array) -> tuple[jax.Array, ...]:
        names = "qpos", "qvel", "qacc_warmstart", "ctrl", "qfrc_applied"
        given = {
            name: jnp.asarray(x, jnp.float32)
            for name, x in zip(names, before, strict=True)
        }
        with jax.default_matmul_precision("highest"):  # TF32 is too coarse for physics
            after = mjx.step(on_device, template.replace(**given))
        return after.qpos, after.qvel, after.qacc_warmstart

    return step
