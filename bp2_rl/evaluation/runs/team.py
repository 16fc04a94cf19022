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
from bp2_rl.evaluation.runs.bodies import Bodies
from bp2_rl.evaluation.runs.driver import ActionFunction, control_step, control_steps_behind
from bp2_rl.evaluation.runs.machine import DT, JUDGE, LawsOfEach, Machine, Numerics
from bp2_rl.evaluation.runs.operator import HEADING_HOLD, HeadingHold
from bp2_rl.evaluation.runs.rollout import (
    SETTLING_DAMPING,
    SETTLING_TIME,
    Recording,
    Watch,
    foot_forces,
    sampled_commands,
)
from bp2_rl.evaluation.runs.schedule import Schedule
from bp2_rl.evaluation.runs.trajectory import Trajectory, yaw_of
from bp2_rl.evaluation.runs.world import LEVEL, World, sensed_pose
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.model import MOTOR_QPOS
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.env import EnvConfig

MOST = 24
"""Robots side by side: more are hardly cheaper each, and all that they do is kept until the last is done."""
STAND = np.array(specs.STAND_JOINTS)
NOBODY = HeadingHold(limit=0.0)


@dataclasses.dataclass(frozen=True)
class Try:
    """What a robot is to do, and what it is; the arguments of `rollout_mujoco`."""

    schedule: Schedule
    hardware: HardwareSpec
    operator: HeadingHold = HEADING_HOLD
    world: World = LEVEL
    gyro_bias: float = 0.0  # rad/s
    finish: float = math.inf  # m ahead, where the run ends
    numerics: Numerics = JUDGE
    watch: Watch | None = None
    name: str = "policy"


def rollout_team(policy: ActionFunction, config: EnvConfig, tries: Sequence[Try]) -> Iterator[Trajectory]:
    """Run all of them, at most `MOST` at a time, and give their runs in order; on the CPU, as `rollout_mujoco`."""
    if not tries:
        return
    robots = [
        (dataclasses.replace(config, hardware=one.hardware), dataclasses.replace(one.world, pushes=())) for one in tries
    ]
    with jax.default_device(jax.devices("cpu")[0]):
        stands = _standing(list(dict.fromkeys(robots)))
    size = math.ceil(len(tries) / math.ceil(len(tries) / MOST))
    for first in range(0, len(tries), size):
        chosen = slice(first, first + size)
        machines = [stands[robot].copy() for robot in robots[chosen]]
        with jax.default_device(jax.devices("cpu")[0]):
            runs = _Team(policy, config, tries[chosen], machines, size).run()
        yield from runs


class _Team:
    """Some tries, from a stand to the end of the last; filled up to `size` with robots that are not run."""

    def __init__(
        self,
        policy: ActionFunction,
        config: EnvConfig,
        tries: Sequence[Try],
        machines: Sequence[Machine],
        size: int,
    ):
        self._tries, self._machines, self._config, self._size = tries, machines, config, size
        for machine, one in zip(machines, tries, strict=True):
            one.numerics.apply(machine.model)
        self._bodies = _Mixed(machines, [one.numerics for one in tries])
        self._told = [sampled_commands(one.schedule) for one in tries]
        self._recordings = [Recording.empty((len(told) - 1) * specs.SUBSTEPS) for told in self._told]
        self._behind = np.array([control_steps_behind(one.hardware.losses.latency) for one in tries])  # by try and ms
        self._finish = np.array([one.finish for one in tries])
        self._control = _compiled(policy, config)
        start = Controller(config).init()
        self._state = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[None], size, axis=0), start)

    def run(self) -> list[Trajectory]:
        """All runs, in the order of the tries."""
        count, bodies = len(self._tries), self._bodies
        ticks = np.array([len(told) - 1 for told in self._told])
        lasted, fell, ended = ticks * specs.SUBSTEPS, np.zeros(count, bool), ticks == 0
        depth, each, k = int(self._behind.max()) + 1, np.arange(count), 0
        issued = [(np.tile(STAND, (count, 1)), np.zeros((count, specs.NUM_MOTORS)))] * depth
        command = np.stack([told[0] for told in self._told]).astype(np.float32)
        while not ended.all():
            position, velocity, next_command = self._tick(k, command)
            issued = [*issued, (position, velocity)][-depth:]
            positions, velocities = (np.stack(kept) for kept in zip(*issued, strict=True))
            for substep in range(specs.SUBSTEPS):
                late = depth - 1 - self._behind[:, substep]
                wanted, up = (positions[late, each], velocities[late, each]), np.flatnonzero(~ended)
                step, there = k * specs.SUBSTEPS + substep, bodies.qpos[:, 0] >= self._finish
                torque = self._millisecond(step, *wanted, command, up)
                down = fall(bodies.qpos, bodies.qvel, self._config.termination).happened
                over = ~ended & (down | there | self._seen_enough(up, torque))
                lasted[over], fell[over & down] = step + 1, True
                ended = ended | over
            command, k = next_command, k + 1
            ended = ended | (ticks <= k)
        return [self._trajectory(i, int(lasted[i]), bool(fell[i])) for i in range(count)]

    def _tick(self, k: int, command: Float[np.ndarray, "N 3"]) -> tuple[np.ndarray, ...]:
        """A control step: targets of joints (rad, rad/s), and the command after it."""
        time = k * specs.CONTROL_STEP
        sensed = [
            sensed_pose(qpos, one.world, one.gyro_bias, time)
            for qpos, one in zip(self._bodies.qpos, self._tries, strict=True)
        ]
        asked = [
            one.operator.steer(told[min(k + 1, len(told) - 1)], qpos[1], yaw_of(qpos[3:7]))
            for one, told, qpos in zip(self._tries, self._told, sensed, strict=True)
        ]
        given = (command, np.stack(sensed), self._bodies.qvel, np.stack(asked))
        filled = (self._filled(np.asarray(x, np.float32)) for x in given)
        self._state, targets, _, told = self._control(self._state, *filled)
        count = len(self._tries)
        position, velocity = (np.asarray(x, np.float64)[:count] for x in (targets.position, targets.velocity))
        return position, velocity, np.asarray(told)[:count]

    def _millisecond(
        self,
        step: int,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        command: Float[np.ndarray, "N 3"],
        up: Int[np.ndarray, " M"],
    ) -> Float[np.ndarray, "N 12"]:
        """Record and move those that are up, with these targets (rad, rad/s); the torque applied, Nm."""
        bodies = self._bodies
        for robot in up.tolist():
            if self._tries[robot].world.pushes:
                self._tries[robot].world.push(self._machines[robot].data, step)
                bodies.look(robot)
        qpos, qvel = bodies.qpos, bodies.qvel
        torque = bodies.millisecond(position, velocity, up)
        for robot in up.tolist():
            recording, machine = self._recordings[robot], self._machines[robot]
            recording.qpos[step], recording.qvel[step] = qpos[robot], qvel[robot]
            recording.target[step], recording.command[step] = position[robot], command[robot]
            recording.torque[step] = torque[robot]
            recording.foot_force[step] = foot_forces(machine.model, machine.data)
        return torque

    def _seen_enough(self, up: Int[np.ndarray, " M"], torque: Float[np.ndarray, "N 12"]) -> Bool[np.ndarray, " N"]:
        """What those who watch say, who may change a robot's motors."""
        enough = np.zeros(len(self._tries), bool)
        for robot in up.tolist():
            if (watch := self._tries[robot].watch) is not None:
                machine = self._machines[robot]
                before = machine.motors
                enough[robot] = watch(machine, torque[robot])
                if machine.motors is not before:
                    self._bodies.renew(robot, machine.motors)
        return enough

    def _trajectory(self, robot: int, length: int, fell: bool) -> Trajectory:
        one, model = self._tries[robot], self._machines[robot].model
        config = dataclasses.replace(self._config, hardware=one.hardware)
        return self._recordings[robot].trajectory(length, fell, one.schedule, model, config, one.name, "C MuJoCo")

    def _filled(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, np.repeat(x[:1], self._size - len(x), axis=0)])


class _Mixed:
    """Robots that differ in which laws they have, in groups of those that do not."""

    def __init__(self, machines: Sequence[Machine], numerics: Sequence[Numerics]):
        kinds: dict[Any, list[int]] = {}
        for robot, (machine, how) in enumerate(zip(machines, numerics, strict=True)):
            laws = jax.tree.structure((machine.motors, machine.resistance))
            updates = how.steps if how.motors_each_step else 1
            kinds.setdefault((laws, machine.throughout, how.steps, updates), []).append(robot)
        self._groups = [
            (np.array(robots), _bodies([machines[i] for i in robots], throughout, steps, updates), updates)
            for (_, throughout, steps, updates), robots in kinds.items()
        ]
        self._place = {robot: (bodies, i) for robots, bodies, _ in self._groups for i, robot in enumerate(robots)}
        self._count = len(machines)

    @property
    def qpos(self) -> Float[np.ndarray, "N 23"]:
        """All robots' states now."""
        return self._gather(lambda bodies: bodies.qpos)

    @property
    def qvel(self) -> Float[np.ndarray, "N 22"]:
        """Likewise their rates."""
        return self._gather(lambda bodies: bodies.qvel)

    def look(self, robot: int) -> None:
        """See a state that somebody has changed."""
        bodies, i = self._place[robot]
        bodies.qpos[i], bodies.qvel[i] = bodies.data[i].qpos, bodies.data[i].qvel

    def renew(self, robot: int, motors: Actuator) -> None:
        """From now on a robot has these motors."""
        bodies, i = self._place[robot]
        assert isinstance(bodies.laws, LawsOfEach)
        bodies.laws.renew(i, motors)

    def millisecond(
        self, position: Float[np.ndarray, "N 12"], velocity: Float[np.ndarray, "N 12"], up: np.ndarray
    ) -> Float[np.ndarray, "N 12"]:
        """Motors and physics of those that are up; the torque applied at the beginning, Nm."""
        torque = np.zeros((self._count, specs.NUM_MOTORS))
        for robots, bodies, updates in self._groups:
            mine = np.flatnonzero(np.isin(robots, up))
            for update in range(updates if len(mine) else 0):
                bodies.advance(position[robots], velocity[robots], mine)
                if update == 0:
                    torque[robots] = bodies.torque
        return torque

    def _gather(self, part: Callable[[Bodies], np.ndarray]) -> np.ndarray:
        gathered = [part(bodies) for _, bodies, _ in self._groups]
        values = np.empty((self._count, gathered[0].shape[1]))
        for (robots, *_), mine in zip(self._groups, gathered, strict=True):
            values[robots] = mine
        return values


def _bodies(machines: Sequence[Machine], throughout: bool, steps: int, updates: int) -> Bodies:
    laws = LawsOfEach([one.motors for one in machines], [one.resistance for one in machines], DT / updates)
    models, data = [one.model for one in machines], [one.data for one in machines]
    torque = np.stack([one.ctrl for one in data])
    return Bodies(models, data, torque, laws, throughout=throughout, steps=steps // updates)


def _standing(robots: Sequence[tuple[EnvConfig, World]]) -> dict[tuple[EnvConfig, World], Machine]:
    """Robots at rest at the origin, as `standing_start`."""
    machines = [Machine(*robot) for robot in robots]
    for machine in machines:
        mujoco.mj_resetDataKeyframe(machine.model, machine.data, machine.model.key("stand").id)
    bodies = _Mixed(machines, [JUDGE] * len(machines))
    stand = np.stack([machine.data.qpos[MOTOR_QPOS] for machine in machines])
    everyone = np.arange(len(machines))
    for _ in range(round(SETTLING_TIME / DT)):
        bodies.millisecond(stand, np.zeros_like(stand), everyone)
        for robot, machine in enumerate(machines):
            machine.data.qvel *= 1.0 - SETTLING_DAMPING * DT
            bodies.look(robot)
    for machine in machines:
        machine.data.qpos[:2], machine.data.qvel[:], machine.data.time = 0.0, 0.0, 0.0
    return dict(zip(robots, machines, strict=True))


@functools.lru_cache(maxsize=8)
def _compiled(policy: ActionFunction, config: EnvConfig) -> Callable[..., Any]:
    """A control step of all robots, which are steered already."""
    # With the reference, though nobody asks for it: without it XLA rounds the targets otherwise.
    return jax.jit(jax.vmap(control_step(policy, config, NOBODY)))
