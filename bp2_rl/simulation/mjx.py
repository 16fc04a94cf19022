"""Runs of a policy in MJX, the reference engine of training, with start, controller and motors as in C MuJoCo."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array

from bp2_rl.base.errors import UserError
from bp2_rl.env.controller import Controller, ControllerState, Targets, motors_of
from bp2_rl.env.physics.mjx import MjxPhysics, Remembered
from bp2_rl.env.termination import fall
from bp2_rl.robot import conventions
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import foot_forces, load_model
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.operator import HeadingHold
from bp2_rl.simulation.policy_runner import ActionFunction, control_step, control_steps_behind
from bp2_rl.simulation.rollout import Recording, RunRequest, draw_sensor_noise, sampled_commands
from bp2_rl.simulation.simulator import CONVERGED, settled
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import LEVEL


def simulate_in_mjx(policy: ActionFunction, config: EnvConfig, request: RunRequest) -> Trajectory:
    """Run a policy in MJX with the solver settings and the float32 of training, on JAX's default device.

    Foot forces are C MuJoCo's for the recorded states and torques: MJX keeps its own in private fields.

    Raises:
        UserError: the request has another world than level ground, a watch, a gyro's bias or other numerics.
    """
    if request != dataclasses.replace(request, world=LEVEL, gyro_bias=0.0, numerics=CONVERGED, watch=None):
        raise UserError("MJX runs on level ground, without a watch, a gyro's bias or other numerics; use mujoco")
    robot = request.robot(config)
    start = settled([robot])
    state = Controller(config).init()
    with jax.default_matmul_precision("highest"):  # TF32 is too coarse for physics
        commands = sampled_commands(request.schedule)
        noise = [drawn[0] for drawn in draw_sensor_noise([request], len(commands) - 1)]
        run = _compiled_run(policy, config, request.operator, robot.config, noisy=bool(noise))
        recorded = run(state, start.qpos[0], start.qvel[0], start.torque[0], commands, *noise)
    qpos, qvel, torque, target, command = (
        np.asarray(x, np.float64).reshape(-1, x.shape[-1]) for x in jax.device_get(recorded)
    )
    down = np.flatnonzero(fall(qpos, qvel, config.termination).happened)
    length = int(down[0]) if len(down) else len(qpos)
    fell = len(down) > 0
    there = np.flatnonzero(qpos[:length, 0] >= request.finish)
    if len(there):
        length, fell = int(there[0]) + 1, False
    recording = Recording(qpos, qvel, torque, target, command, np.zeros((len(qpos), 4, 3)))
    model, data = start.models[0], start.data[0]
    for step in range(length):
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[step], qvel[step], torque[step]
        mujoco.mj_forward(model, data)
        recording.foot_force[step] = foot_forces(data)
    return recording.trajectory(request, config, "mjx", length=length, fell=fell, mass=start.mass(0))


@functools.lru_cache(maxsize=8)
def _compiled_run(
    policy: ActionFunction, config: EnvConfig, operator: HeadingHold, robot: EnvConfig, *, noisy: bool
) -> Callable[..., tuple[Array, ...]]:
    """Return a compiled function that runs one robot through MJX.

    (controller state, qpos, qvel, torque, commands "K+1 3") -> qpos, qvel, torque, target, command, each "K 5 ...".
    With noisy sensors two more arguments come last: random keys "K 2", and the noise's share "K".
    """
    hardware = robot.hardware
    # A run counts to the fall only, and a robot falls before its trunk touches.
    motors, resistance = motors_of(robot), Resistance.from_hardware(hardware)
    physics = MjxPhysics(load_model(hardware, visual=False, feet_only=True), motors, resistance, "jax")
    control = control_step(policy, config, config.randomization if noisy else None)
    late = control_steps_behind(hardware.losses.latency)
    behind, longest = jnp.array(late), max(late) + 1
    before = Targets(jnp.array(hardware.anatomy.stand), jnp.zeros(conventions.NUM_MOTORS))

    def control_period(carry: Any, inputs: tuple[Array, ...]) -> tuple[Any, tuple[Array, ...]]:
        (state, command, robot, issued), (scheduled, *drawn) = carry, inputs
        asked = operator.steer(scheduled, robot.qpos[1], yaw_of(robot.qpos[3:7]))
        state, targets, _, next_command = control(state, command, robot.qpos, robot.qvel, asked, *drawn)
        issued = jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), targets, issued)

        def physics_step(robot: Remembered, late: Array) -> tuple[Remembered, tuple[Array, ...]]:
            now = jax.tree.map(lambda x: x[late], issued)
            after, _ = physics.physics_step(physics.model, motors, resistance, robot, now)
            return after, (robot.qpos, robot.qvel, after.torque, now.position, command)

        robot, samples = jax.lax.scan(physics_step, robot, behind)
        return (state, next_command, robot, issued), samples

    def run(
        state: ControllerState, qpos: Array, qvel: Array, torque: Array, commands: Array, *noise: Array
    ) -> tuple[Array, ...]:
        qpos, qvel, torque, commands = (jnp.asarray(x, jnp.float32) for x in (qpos, qvel, torque, commands))
        robot = Remembered(qpos, qvel, jnp.zeros_like(qvel), torque)
        issued = jax.tree.map(lambda x: jnp.tile(x, (longest, 1)), before)
        return jax.lax.scan(control_period, (state, commands[0], robot, issued), (commands[1:], *noise))[1]

    return jax.jit(run)
