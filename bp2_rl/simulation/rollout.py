"""A policy x a command schedule x a simulator -> Trajectory.

C MuJoCo is the judge: an independent implementation of the physics, in float64 with a converged solver, so that
nothing a policy has learnt about MJX's approximations helps it there. MJX runs the policy in the simulator it was
trained in. Both start from the same settled stand and run the same controller and the same motors.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.env.controller import Controller, Targets, motors_of
from bp2_rl.env.physics.mjx import MjxPhysics, Remembered
from bp2_rl.env.termination import fall
from bp2_rl.robot import specs
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import NQ, NU, NV, foot_forces, load_model
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.driver import ActionFunction, Driver, control_step, control_steps_behind
from bp2_rl.simulation.machine import JUDGE, Machine, Numerics
from bp2_rl.simulation.operator import HEADING_HOLD, HeadingHold
from bp2_rl.simulation.schedule import Schedule
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import LEVEL, World, sensed_pose

Array = Any  # numpy or jax array
Watch = Callable[[Machine, Float[np.ndarray, "12"]], bool]  # after a millisecond under this torque: whether to stop

SETTLING_TIME = 4.0  # s of standing before the clock starts
SETTLING_DAMPING = 10.0  # 1/s, on everything that moves meanwhile: BP2's own sway takes half a minute to die away
DT = specs.PHYSICS_STEP


# --- The simulators ------------------------------------------------------------------------------------------


def rollout_mujoco(
    policy: ActionFunction,
    schedule: Schedule,
    config: EnvConfig,
    *,
    operator: HeadingHold = HEADING_HOLD,
    name: str = "policy",
    finish: float = math.inf,
    numerics: Numerics = JUDGE,
    hardware: HardwareSpec | None = None,
    world: World = LEVEL,
    gyro_bias: float = 0.0,
    machine: type[Machine] = Machine,
    watch: Watch | None = None,
) -> Trajectory:
    """Run one robot in C MuJoCo until the schedule ends, it falls, or its trunk is `finish` metres ahead.

    Physics at 1 kHz in float64 with the motors' envelope applied at every step; the policy at 200 Hz in float32 on the
    CPU, as on the robot. Whatever the `numerics`, the start is the same and samples are taken each ms, with the torque
    and the limits at its beginning. `hardware` is that of the robot, if it is not the one that the policy and its
    controller take it for. Joint targets act after its latency; until the first does, it stands. `gyro_bias` (rad/s) is
    that of the gyro from which the operator has the heading. `machine` is the kind that takes the milliseconds. `watch`
    is shown the machine after each millisecond with the torque that it applied; it may change the machine's motors,
    and says when it has seen enough.
    """
    robot = dataclasses.replace(config, hardware=hardware or config.hardware)
    body = standing_start(robot, world, machine)
    model, data = body.model, body.data
    numerics.apply(model)
    commands = sampled_commands(schedule)
    recording = Recording.empty((len(commands) - 1) * specs.SUBSTEPS)
    driver = Driver(policy, config, operator, latency=robot.hardware.losses.latency, command=commands[0])

    for k, scheduled in enumerate(commands[1:]):
        sensed = sensed_pose(data.qpos, world, gyro_bias, k * specs.CONTROL_STEP)
        for substep, (position, velocity) in enumerate(driver.tick(sensed, data.qvel, scheduled)):
            step = k * specs.SUBSTEPS + substep
            world.push(data, step)
            recording.qpos[step], recording.qvel[step] = data.qpos, data.qvel
            recording.target[step], recording.command[step] = position, driver.command
            recording.torque[step] = body.millisecond(position, velocity, numerics)
            recording.foot_force[step] = foot_forces(data)
            fell = bool(fall(data.qpos, data.qvel, config.termination).happened)
            enough = watch is not None and watch(body, recording.torque[step])
            if fell or enough or recording.qpos[step, 0] >= finish:
                return recording.trajectory(step + 1, fell, schedule, model, robot, name, "C MuJoCo")
    return recording.trajectory(len(recording.qpos), False, schedule, model, robot, name, "C MuJoCo")


def rollout_mjx(
    policy: ActionFunction,
    schedule: Schedule,
    config: EnvConfig,
    *,
    operator: HeadingHold = HEADING_HOLD,
    name: str = "policy",
    finish: float = math.inf,
    hardware: HardwareSpec | None = None,
) -> Trajectory:
    """Run one robot as `rollout_mujoco` does, but in MJX with the solver settings and the float32 of training.

    It runs on JAX's default device.

    Foot forces are C MuJoCo's for the recorded states and torques: MJX keeps its own in private fields.
    """
    robot = dataclasses.replace(config, hardware=hardware or config.hardware)
    machine = standing_start(robot)
    model, start = machine.model, machine.data
    commands = sampled_commands(schedule)
    state = Controller(config).init()
    with jax.default_matmul_precision("highest"):  # TF32 is too coarse for physics
        run = _compiled_mjx_run(policy, config, operator, robot.hardware)
        recorded = run(state, start.qpos, start.qvel, start.ctrl, commands)
    qpos, qvel, torque, target, command = (
        np.asarray(x, np.float64).reshape(-1, x.shape[-1]) for x in jax.device_get(recorded)
    )
    down = np.flatnonzero(fall(qpos, qvel, config.termination).happened)
    length = int(down[0]) if len(down) else len(qpos)
    fell = len(down) > 0
    there = np.flatnonzero(qpos[:length, 0] >= finish)
    if len(there):
        length, fell = int(there[0]) + 1, False
    recording = Recording(qpos, qvel, torque, target, command, np.zeros((len(qpos), 4, 3)))
    for step in range(length):
        start.qpos[:], start.qvel[:], start.ctrl[:] = qpos[step], qvel[step], torque[step]
        mujoco.mj_forward(model, start)
        recording.foot_force[step] = foot_forces(start)
    return recording.trajectory(length, fell, schedule, model, robot, name, "MJX")


def mjx_run(
    policy: ActionFunction, config: EnvConfig, operator: HeadingHold, hardware: HardwareSpec
) -> Callable[..., tuple[Array, ...]]:
    """A pure function that runs one robot through MJX; jit it, and vmap it for many.

    (controller state, qpos, qvel, torque, commands "K+1 3") -> qpos, qvel, torque, target, command, each "K 5 ...".
    """
    # A run counts to the fall only, and a robot falls before its trunk touches.
    motors, resistance = motors_of(dataclasses.replace(config, hardware=hardware)), Resistance.from_hardware(hardware)
    physics = MjxPhysics(load_model(hardware, visual=False, feet_only=True), motors, resistance, "jax")
    control = control_step(policy, config, operator)
    late = control_steps_behind(hardware.losses.latency)
    behind, longest = jnp.array(late), max(late) + 1
    before = Targets(jnp.array(specs.STAND_JOINTS), jnp.zeros(NU))

    def control_period(carry, scheduled):
        state, command, robot, issued = carry
        state, targets, _, next_command = control(state, command, robot.qpos, robot.qvel, scheduled)
        issued = jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), targets, issued)

        def physics_step(robot, late):
            now = jax.tree.map(lambda x: x[late], issued)
            after, _ = physics.millisecond(physics.model, motors, resistance, robot, now)
            return after, (robot.qpos, robot.qvel, after.torque, now.position, command)

        robot, samples = jax.lax.scan(physics_step, robot, behind)
        return (state, next_command, robot, issued), samples

    def run(state, qpos, qvel, torque, commands):
        qpos, qvel, torque, commands = (jnp.asarray(x, jnp.float32) for x in (qpos, qvel, torque, commands))
        robot = Remembered(qpos, qvel, jnp.zeros_like(qvel), torque)
        issued = jax.tree.map(lambda x: jnp.tile(x, (longest, 1)), before)
        return jax.lax.scan(control_period, (state, commands[0], robot, issued), commands[1:])[1]

    return run


# --- Parts that both share -----------------------------------------------------------------------------------


def standing_start(config: EnvConfig, world: World = LEVEL, machine: type[Machine] = Machine) -> Machine:
    """BP2 at rest on its feet at the origin: the keyframe `stand`, settled under the joint PD loop."""
    return _settled(config, world, machine, SETTLING_TIME).copy()


@functools.lru_cache(maxsize=16)
def _settled(config: EnvConfig, world: World, machine: type[Machine], seconds: float) -> Machine:
    settled = machine(config, world)
    settled.settle(seconds, SETTLING_DAMPING)
    return settled


@functools.lru_cache(maxsize=8)
def _compiled_mjx_run(
    policy: ActionFunction, config: EnvConfig, operator: HeadingHold, hardware: HardwareSpec
) -> Callable[..., Any]:
    return jax.jit(mjx_run(policy, config, operator, hardware))


def sampled_commands(schedule: Schedule) -> Float[np.ndarray, "K 3"]:
    """The scheduled command at every control step and at the end of the last."""
    steps = math.ceil(schedule.duration * specs.POLICY_RATE - 1e-9)
    return np.stack([schedule.command(k * specs.CONTROL_STEP) for k in range(steps + 1)])


@dataclasses.dataclass(frozen=True)
class Recording:
    """The samples of a run as they come in: arrays over physics steps."""

    qpos: np.ndarray
    qvel: np.ndarray
    torque: np.ndarray
    target: np.ndarray
    command: np.ndarray
    foot_force: np.ndarray

    @classmethod
    def empty(cls, *steps: int) -> "Recording":
        """Room for so many; with an axis in front, of so many robots."""
        sizes = (NQ,), (NV,), (NU,), (NU,), (3,), (4, 3)
        return cls(*(np.zeros((*steps, *size)) for size in sizes))

    def of(self, robot: int) -> "Recording":
        """Return the recording of one robot of several."""
        return Recording(*(array[robot] for array in vars(self).values()))

    def trajectory(
        self,
        length: int,
        fell: bool,
        schedule: Schedule,
        model: mujoco.MjModel,
        config: EnvConfig,
        name: str,
        backend: str,
    ) -> Trajectory:
        """The first `length` samples; `fell`: the next state was that of a fallen robot."""
        arrays = {field.name: getattr(self, field.name)[:length] for field in dataclasses.fields(self)}
        return Trajectory(
            time=np.arange(length) * DT,
            **arrays,
            dt=DT,
            steady_from=schedule.steady_from,
            fell_at=round(length * DT, 6) if fell else None,
            mass=float(np.sum(model.body_mass)),
            hardware=config.hardware,
            name=name,
            backend=backend,
        )
