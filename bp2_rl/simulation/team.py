"""Different tries of one policy side by side in C MuJoCo: what `rollout_mujoco` does of one, for all of a benchmark.

Each robot has its own schedule, hardware, ground, operator and numerics. The controller and the laws of motors and
losses are computed for all of them at once, and MuJoCo takes its steps one by one, so that a robot of many costs a
small part of one alone. Compiled code rounds otherwise than NumPy, so two runs agree as those do that begin a hair's
breadth apart.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from bp2_rl.env.controller import Controller
from bp2_rl.env.termination import fall
from bp2_rl.robot import specs
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.model import MOTOR_QPOS, foot_forces
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.bodies import Bodies
from bp2_rl.simulation.driver import ActionFunction, control_step, control_steps_behind
from bp2_rl.simulation.laws import row_of
from bp2_rl.simulation.machine import DT, JUDGE, Machine, Numerics
from bp2_rl.simulation.operator import HEADING_HOLD, HeadingHold
from bp2_rl.simulation.rollout import (
    SETTLING_DAMPING,
    SETTLING_TIME,
    Recording,
    Watch,
    sampled_commands,
)
from bp2_rl.simulation.schedule import Schedule
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import LEVEL, World, sensed_pose

FEW, MOST = 4, 24
"""Robots side by side: more are hardly cheaper each, and all that they do is kept until the last is done."""
STAND = np.array(specs.STAND_JOINTS)
NOBODY = HeadingHold(limit=0.0)


@dataclasses.dataclass(frozen=True)
class RunRequest:
    """One run to simulate: the robot, its schedule and its surroundings; see the arguments of `rollout_mujoco`."""

    schedule: Schedule
    hardware: HardwareSpec
    operator: HeadingHold = HEADING_HOLD
    world: World = LEVEL
    gyro_bias: float = 0.0  # rad/s
    finish: float = math.inf  # m ahead, where the run ends
    numerics: Numerics = JUDGE
    watch: Watch | None = None
    name: str = "policy"


def rollout_team(policy: ActionFunction, config: EnvConfig, tries: Sequence[RunRequest]) -> Iterator[Trajectory]:
    """Run all of them, at most `MOST` at a time, and give their runs in order; on the CPU, as `rollout_mujoco`."""
    robots = [
        (dataclasses.replace(config, hardware=one.hardware), dataclasses.replace(one.world, pushes=())) for one in tries
    ]
    with jax.default_device(jax.devices("cpu")[0]):
        stands = {robot: machine for some in _parts(list(dict.fromkeys(robots))) for robot, machine in _standing(some)}
    for part in _parts(range(len(tries))):
        machines = [stands[robots[i]].copy() for i in part]
        with jax.default_device(jax.devices("cpu")[0]):
            runs = _Team(policy, config, [tries[i] for i in part], machines).run()
        yield from runs


class _Team:
    """Several runs side by side, from a stand to the end of the longest."""

    def __init__(
        self, policy: ActionFunction, config: EnvConfig, tries: Sequence[RunRequest], machines: Sequence[Machine]
    ):
        for machine, one in zip(machines, tries, strict=True):
            one.numerics.apply(machine.model)
        self._tries, self._machines, self._config, self._count = tries, machines, config, len(tries)
        self._fill = _filled(len(tries))
        self._bodies = Bodies.of([machines[i] for i in self._fill], [tries[i].numerics for i in self._fill])
        self._feet = [foot_forces(machine.data) for machine in machines]
        self._operators = {
            operator: [robot for robot, one in enumerate(tries) if one.operator == operator]
            for operator in {one.operator for one in tries}
        }
        self._behind = np.array([control_steps_behind(tries[i].hardware.losses.latency) for i in self._fill])
        schedules = [sampled_commands(one.schedule) for one in tries]
        self._ticks = np.array([len(commands) - 1 for commands in schedules])
        longest = int(np.max(self._ticks))
        self._told = np.stack(
            [commands[np.minimum(np.arange(longest + 1), len(commands) - 1)] for commands in schedules]
        )
        self._log = Recording.empty(len(tries), longest * specs.SUBSTEPS)
        self._control = _compiled(policy, config)
        start = Controller(config).init()
        self._state = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], len(self._fill), axis=0), start)

    def run(self) -> list[Trajectory]:
        """All runs, in the order of the tries."""
        count, bodies, finish = self._count, self._bodies, np.array([one.finish for one in self._tries])
        lasted, fell, ended = self._ticks * specs.SUBSTEPS, np.zeros(count, bool), self._ticks == 0
        depth, each, k = int(self._behind.max()) + 1, np.arange(len(self._fill)), 0
        issued = [(np.tile(STAND, (len(each), 1)), np.zeros((len(each), specs.NUM_MOTORS)))] * depth
        command = self._told[:, 0].astype(np.float32)
        while not ended.all():
            position, velocity, next_command = self._tick(k, command)
            issued = [*issued, (position, velocity)][-depth:]
            positions, velocities = (np.stack(kept) for kept in zip(*issued, strict=True))
            for substep in range(specs.SUBSTEPS):
                late = depth - 1 - self._behind[:, substep]
                step, there = k * specs.SUBSTEPS + substep, bodies.qpos[:count, 0] >= finish
                self._millisecond(step, positions[late, each], velocities[late, each], command, np.flatnonzero(~ended))
                down = fall(bodies.qpos[:count], bodies.qvel[:count], self._config.termination).happened
                over = ~ended & (down | there | self._seen_enough(step, ended))
                lasted[over], fell[over & down] = step + 1, True
                ended = ended | over
            command, k = next_command, k + 1
            ended = ended | (self._ticks <= k)
        return [self._trajectory(i, int(lasted[i]), bool(fell[i])) for i in range(count)]

    def _tick(self, k: int, command: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, ...]:
        """A control step: targets of joints (rad, rad/s) of all, and the command after it."""
        time, sensed = k * specs.CONTROL_STEP, self._bodies.qpos[: self._count].copy()
        for robot, one in enumerate(self._tries):
            sensed[robot] = sensed_pose(sensed[robot], one.world, one.gyro_bias, time)
        asked = self._told[:, k + 1].copy()
        for operator, mine in self._operators.items():
            asked[mine] = operator.steer(asked[mine], sensed[mine, 1], yaw_of(sensed[mine, 3:7]))
        given = (command, sensed, self._bodies.qvel[: self._count], asked)
        filled = (np.asarray(x, np.float32)[self._fill] for x in given)
        self._state, targets, _, told = self._control(self._state, *filled)
        position, velocity = (np.asarray(x, np.float64) for x in (targets.position, targets.velocity))
        return position, velocity, np.asarray(told)[: self._count]

    def _millisecond(
        self,
        step: int,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        command: Float[np.ndarray, "n 3"],
        up: Int[np.ndarray, " M"],
    ) -> None:
        """Record all and move those that are up, with these targets (rad, rad/s)."""
        bodies, log, count = self._bodies, self._log, self._count
        for robot in up.tolist():
            if self._tries[robot].world.pushes:
                self._tries[robot].world.push(self._machines[robot].data, step)
                bodies.look(robot)
        log.qpos[:, step], log.qvel[:, step] = bodies.qpos[:count], bodies.qvel[:count]
        log.target[:, step], log.command[:, step] = position[:count], command
        log.torque[:, step] = bodies.millisecond(position, velocity, up)[:count]
        for robot in up.tolist():
            log.foot_force[robot, step] = self._feet[robot]

    def _seen_enough(self, step: int, ended: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return which runs their `watch` functions end; a `watch` may change its robot's motors."""
        enough = np.zeros(self._count, bool)
        for robot, (one, machine) in enumerate(zip(self._tries, self._machines, strict=True)):
            if one.watch is not None and not ended[robot]:
                before = machine.motors
                enough[robot] = one.watch(machine, self._log.torque[robot, step])
                if machine.motors is not before:
                    self._bodies.renew(robot, row_of(machine.motors, machine.resistance, one.numerics.period))
        return enough

    def _trajectory(self, robot: int, length: int, fell: bool) -> Trajectory:
        one, model = self._tries[robot], self._machines[robot].model
        config = dataclasses.replace(self._config, hardware=one.hardware)
        return self._log.of(robot).trajectory(length, fell, one.schedule, model, config, one.name, "C MuJoCo")


def _standing(robots: Sequence[tuple[EnvConfig, World]]) -> Iterator[tuple[tuple[EnvConfig, World], Machine]]:
    """Each with itself at rest at the origin, as `standing_start`."""
    machines = [Machine(*robot) for robot in robots]
    for machine in machines:
        mujoco.mj_resetDataKeyframe(machine.model, machine.data, machine.model.key("stand").id)
    bodies = Bodies.of([machines[i] for i in _filled(len(machines))])
    stand, everyone = bodies.qpos[:, MOTOR_QPOS], np.arange(len(machines))
    for _ in range(round(SETTLING_TIME / DT)):
        bodies.millisecond(stand, np.zeros_like(stand), everyone)
        for robot, machine in enumerate(machines):
            machine.data.qvel *= 1.0 - SETTLING_DAMPING * DT
            bodies.look(robot)
    for machine in machines:
        machine.data.qpos[:2], machine.data.qvel[:], machine.data.time = 0.0, 0.0, 0.0
    return zip(robots, machines, strict=True)


def _parts(things: Sequence[Any]) -> Iterator[Sequence[Any]]:
    """As many as fit side by side at a time, about equally many."""
    size = math.ceil(len(things) / max(math.ceil(len(things) / MOST), 1)) or 1
    return (things[first : first + size] for first in range(0, len(things), size))


def _filled(robots: int) -> Int[np.ndarray, " N"]:
    """Filled up with robots that are not run, as programs are compiled for a few sizes: of which one each is a copy."""
    return np.minimum(np.arange(FEW if robots <= FEW else MOST), robots - 1)


@functools.lru_cache(maxsize=8)
def _compiled(policy: ActionFunction, config: EnvConfig) -> Callable[..., Any]:
    """A control step of all robots, which are steered already."""
    # With the reference, though nobody asks for it: without it XLA rounds the targets otherwise.
    return jax.jit(jax.vmap(control_step(policy, config, NOBODY)))
