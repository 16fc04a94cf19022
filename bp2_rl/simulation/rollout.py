"""Simulate runs of a policy: `rollout` makes one, `simulate` makes many `RunRequest`s
side by side.

The default simulator, C MuJoCo, is an independent implementation in float64 with a
converged solver, so that a policy cannot profit from the approximations of its
training.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import NoneType
from typing import Annotated

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError, require_kind, require_one_of
from bp2_rl.base.processes import keep_compiled
from bp2_rl.env.observations import layout_of
from bp2_rl.env.termination import fall
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.height import height_over_ground
from bp2_rl.robot.named import find_robot
from bp2_rl.robot.operator import HEADING_HOLD, HeadingHold
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.backend import TITLES, Backend
from bp2_rl.simulation.laws import SIZES
from bp2_rl.simulation.policy_runner import ActionFunction, PolicyRunner
from bp2_rl.simulation.schedule import Ramp, Schedule
from bp2_rl.simulation.simulator import (
    CONVERGED,
    DT,
    Numerics,
    RobotSetup,
    Simulator,
    settled,
)
from bp2_rl.simulation.trajectory import Trajectory, shapes_of
from bp2_rl.simulation.world import LEVEL, Draw, Push, World, sensed_pose

SIDE_BY_SIDE = SIZES[-1]
"""Largest number of robots simulated side by side: more cost as much each, and keep all
samples in memory."""

Watch = Callable[[Simulator, int, Float[np.ndarray, "12"]], bool]
"""Called after each millisecond with the simulator, a robot's index and its torques
(Nm); returns whether the run ends, and may change the robot's motors."""


@dataclasses.dataclass(frozen=True)
class RunRequest(Bounded):
    """A run to simulate: it ends with its schedule, at a fall, at the distance
    `finish`, or when `watch` returns True.

    Commands are those of the schedule: unlike in `rollout`, the controller's limits do
    not slow down a ramp, except by `Ramp.under`.

    Examples:
        >>> RunRequest(Ramp(10.0), world=World(pushes=(Push(6.0, 0.0, 1.0),)), noise_seed=0)
    """

    schedule: Schedule
    hardware: HardwareSpec | None = None
    """the robot that is simulated; by default the one that the controller assumes"""
    operator: HeadingHold = HEADING_HOLD
    world: World = LEVEL
    gyro_bias: float = 0.0
    """rad/s, bias of the gyro from which the operator integrates the heading"""
    noise_seed: int | None = None
    """seed of the sensor noise, whose strength is that of the policy's training; None:
    sensors without noise"""
    finish: Annotated[float, Within(0.0, infinite=True)] = math.inf
    """m, distance ahead at which the run ends"""
    numerics: Numerics = CONVERGED
    """settings of the physics; they change neither the rate of the samples, 1 kHz, nor
    the start"""
    watch: Watch | None = None
    name: str = "policy"
    drawn: Draw | None = None
    """random changes of the robot; None: the robot is as designed"""

    def robot(self, config: EnvConfig) -> RobotSetup:
        """Return the simulated robot of this run, for a policy trained in the
        environment `config`."""
        robot = RobotSetup.of(config, self.hardware)
        return dataclasses.replace(
            robot, world=self.world, numerics=self.numerics, drawn=self.drawn
        )


def rollout(
    policy: Policy | ActionFunction,
    schedule: Schedule,
    *,
    config: EnvConfig | None = None,
    hardware: HardwareSpec | Path | str | None = None,
    operator: HeadingHold = HEADING_HOLD,
    world: World = LEVEL,
    noise_seed: int | None = None,
    backend: Backend = "mujoco",
) -> Trajectory:
    """Run a policy once from a settled stand and return the trajectory, whose `metrics` are its numbers.

    A ramp rises within the limits of the policy's controller, so that its hold begins
    at the full speed. `policy`, `config` and `backend` are as `simulate` takes them,
    the others as `RunRequest` has them; `hardware` may be a robot's name, such as
    `ideal`, or its file.

    Raises:
        UserError: as `simulate` does, for a schedule that does not last, and where there is no such robot.

    Examples:
        >>> run = rollout(load_policy("built"), Ramp(10.0, hold=5.0), world=World(Terrain(slope=0.05)))
        >>> run.metrics.best_speed  # m/s
    """
    config = _config_of(policy, config)
    duration = getattr(schedule, "duration", None)
    if not isinstance(duration, float | int) or duration <= 0.0:
        raise UserError(
            f"rollout takes a schedule that lasts, such as Ramp(10.0), got {schedule!r}"
        )
    asked = schedule.under(config.control) if isinstance(schedule, Ramp) else schedule
    robot = find_robot(str(hardware)) if isinstance(hardware, str | Path) else hardware
    request = RunRequest(asked, robot, operator, world, noise_seed=noise_seed)
    [run] = simulate(policy, [request], config, backend=backend)
    return run


def simulate(
    policy: Policy | ActionFunction,
    requests: Sequence[RunRequest],
    config: EnvConfig | None = None,
    *,
    backend: Backend = "mujoco",
) -> Iterator[Trajectory]:
    """Run a policy from a settled stand, many runs side by side; yield the trajectories
    in the order of the requests.

    Physics at 1 kHz in float64 with the motors' envelope applied at every step; the
    policy at 200 Hz in float32 on the CPU, as on the robot. Drake's dynamics and
    contact are available for comparison.

    Args:
        policy: a loaded policy, or a function from an observation to an action, for one
            robot.
        requests: the runs.
        config: the environment that the policy was trained in; that of a loaded
            policy's card by default.
        backend: the simulator.

    Raises:
        UserError: a policy without a card and without `config`, a policy that reads
            other observations than `config` gives, a request that Drake does not run,
            or Drake where it is not installed.
    """
    keep_compiled()
    config = _config_of(policy, config)
    require_one_of("backend", backend, TITLES)
    require_kind(
        "simulate",
        requests,
        Sequence,
        "several requests, such as [RunRequest(Ramp(10.0))]",
    )
    for request in requests:
        require_kind(
            "each request",
            request,
            RunRequest,
            "a RunRequest, such as RunRequest(Ramp(10.0))",
        )
    return _in_parts(policy, requests, config, _engine(backend))


def _config_of(policy: Policy | ActionFunction, config: EnvConfig | None) -> EnvConfig:
    """Return the environment settings for a policy; raise UserError if their
    observations are not the policy's."""
    require_kind(
        "config",
        config,
        (EnvConfig, NoneType),
        'settings, such as preset("imitation", "cpu").env',
    )
    if not callable(policy):
        raise UserError(
            f"a policy is run, and {policy!r} is none: pass load_policy({policy!r})"
        )
    if not isinstance(policy, Policy):
        if config is None:
            raise UserError(
                "a policy without a card runs only with a config: pass config=EnvConfig(...)"
            )
        return config
    config = config or policy.card.env
    wanted = policy.card.observation_layout
    given = layout_of(config)
    if wanted != given:
        entry, other = next(
            pair for pair in itertools.zip_longest(wanted, given) if pair[0] != pair[1]
        )
        raise UserError(
            f"the policy observes {entry or 'nothing more'} where this config gives {other or 'nothing more'}; pass "
            "no config, or one with the control of policy.card.env"
        )
    return config


def _in_parts(
    policy: ActionFunction,
    requests: Sequence[RunRequest],
    config: EnvConfig,
    engine: type[Simulator],
) -> Iterator[Trajectory]:
    """Simulate the requests, at most `SIDE_BY_SIDE` at a time; yield the trajectories
    in order."""
    parts = math.ceil(len(requests) / SIDE_BY_SIDE)
    for part in np.array_split(np.arange(len(requests)), parts) if parts else ():
        yield from _SideBySide(
            policy, config, [requests[i] for i in part], engine
        ).run()


def _engine(backend: Backend) -> type[Simulator]:
    if backend == "drake":
        from bp2_rl.simulation.drake import DrakeSimulator  # Drake is an extra

        return DrakeSimulator
    return Simulator


class _SideBySide:
    """Make many runs in one simulator, under one policy, and record them."""

    def __init__(
        self,
        policy: ActionFunction,
        config: EnvConfig,
        requests: Sequence[RunRequest],
        engine: type[Simulator],
    ):
        self._config = config
        self._requests = requests
        robots = [request.robot(config) for request in requests]
        self._simulator = settled(robots, engine)
        schedules = [sampled_commands(request.schedule) for request in requests]
        self._ticks = np.array([len(commands) - 1 for commands in schedules])
        self._longest = int(np.max(self._ticks))
        # (N, T + 1, 3): a run that is over holds its last command
        self._commands = np.stack(
            [
                commands[np.minimum(np.arange(self._longest + 1), len(commands) - 1)]
                for commands in schedules
            ]
        )
        self._noise = draw_sensor_noise(requests, self._longest)
        self._runner = PolicyRunner(
            policy,
            config,
            operators=[request.operator for request in requests],
            latencies=[robot.latency for robot in robots],
            commands=self._commands[:, 0],
            noise=config.randomization if self._noise else None,
        )
        self._recording = Recording.empty(
            config.hardware, len(requests), self._longest * conventions.SUBSTEPS
        )
        self._finish = np.array(
            [min(request.finish, request.world.end) for request in requests]
        )
        self._grounds = {
            i: _data_on_ground(self._simulator.models[i])
            for i, one in enumerate(requests)
            if one.world.ground
        }
        self._pushes: dict[int, list[tuple[int, Push]]] = {}
        for i, one in enumerate(requests):
            for push in one.world.pushes:
                self._pushes.setdefault(push.step, []).append((i, push))
        self._watched = [i for i, one in enumerate(requests) if one.watch]
        self._lasted = self._ticks * conventions.SUBSTEPS  # ms
        self._fell = np.zeros(len(requests), bool)
        self._ended = self._ticks == 0

    def run(self) -> Iterator[Trajectory]:
        """Simulate all runs to their ends; yield what was recorded, run by run, as the
        copies take as much memory as the recording."""
        for tick in range(self._longest):
            self._control_step(tick)
            if self._ended.all():
                break
        for i, request in enumerate(self._requests):
            yield self._recording.of(i).trajectory(
                request,
                self._config,
                self._simulator.backend,
                length=int(self._lasted[i]),
                fell=bool(self._fell[i]),
                mass=self._simulator.mass(i),
            )

    def _control_step(self, tick: int) -> None:
        """Compute the joints' targets by the policy, and simulate one control step."""
        time = tick * conventions.CONTROL_STEP
        poses = zip(self._requests, self._simulator.qpos, strict=True)
        sensed = [
            sensed_pose(x, request.world, request.gyro_bias, time)
            for request, x in poses
        ]
        targets = self._runner.tick(
            np.stack(sensed),
            self._simulator.qvel,
            self._commands[:, tick + 1],
            *(drawn[:, tick] for drawn in self._noise),
        )
        first = tick * conventions.SUBSTEPS
        moving = np.flatnonzero(~self._ended)
        enough = [
            self._millisecond(step, moving, *target)
            for step, target in enumerate(targets, first)
        ]
        self._end(first, np.stack(enough, axis=1))
        self._ended |= self._ticks <= tick + 1

    def _millisecond(
        self,
        step: int,
        moving: Int[np.ndarray, " M"],
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
    ) -> Bool[np.ndarray, " N"]:
        """Simulate and record a millisecond of the unfinished runs; return which runs
        have reached their `finish`, or end by their `watch`."""
        simulator, recording = self._simulator, self._recording
        for robot, push in self._pushes.get(step, ()):
            if not self._ended[robot]:
                simulator.push(robot, push)
        recording.qpos[:, step] = simulator.qpos
        recording.qvel[:, step] = simulator.qvel
        recording.target[:, step] = position
        recording.command[:, step] = self._runner.command
        enough = simulator.qpos[:, 0] >= self._finish
        torque = simulator.millisecond(position, velocity, moving)
        recording.torque[:, step] = torque
        recording.foot_force[:, step] = simulator.foot_force
        for robot in self._watched:
            watch = self._requests[robot].watch
            if watch and not self._ended[robot]:
                enough[robot] |= watch(simulator, robot, recording.torque[robot, step])
        return enough

    def _end(self, first: int, enough: Bool[np.ndarray, "N K"]) -> None:
        """End the runs that fell in the control step from millisecond `first` on, or in
        which it is `enough`."""
        simulator, recording = self._simulator, self._recording
        later = slice(first + 1, first + enough.shape[1])
        qpos, qvel = (
            np.concatenate([before[:, later], now[:, None]], axis=1)
            for before, now in (
                (recording.qpos, simulator.qpos),
                (recording.qvel, simulator.qvel),
            )
        )
        for robot, ground in self._grounds.items():
            for pose in qpos[robot]:
                ground.qpos[:] = pose
                pose[2] = height_over_ground(simulator.models[robot], ground)
        down = fall(qpos, qvel, self._config.termination).happened
        over = (down | enough) & ~self._ended[:, None]
        runs, at = np.any(over, axis=1), np.argmax(over, axis=1)
        self._lasted[runs] = first + 1 + at[runs]
        self._fell[runs] = down[runs, at[runs]]
        self._ended |= runs


def _data_on_ground(model: mujoco.MjModel) -> mujoco.MjData:
    """Return MuJoCo's data with the ground in its place."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def draw_sensor_noise(
    requests: Sequence[RunRequest], ticks: int
) -> tuple[np.ndarray, ...]:
    """Return the random keys and noise shares that `control_step` takes; nothing if no
    robot has noisy sensors.

    Otherwise a random key for every robot and control step (N, T, 2), and that robot's
    share of the noise (N, T): 1 or 0.
    """
    seeds = [request.noise_seed for request in requests]
    if all(seed is None for seed in seeds):
        return ()
    of_steps = jax.vmap(jax.random.fold_in, (None, 0))
    with jax.default_device(jax.devices("cpu")[0]):
        keys = [
            np.asarray(of_steps(jax.random.PRNGKey(seed or 0), np.arange(ticks)))
            for seed in seeds
        ]
    return np.stack(keys), np.array(
        [[float(seed is not None)] * ticks for seed in seeds]
    )


def sampled_commands(schedule: Schedule) -> Float[np.ndarray, "K 3"]:
    """Return the scheduled command at every control step and at the end of the last."""
    steps = math.ceil(schedule.duration * conventions.POLICY_RATE - 1e-9)
    return np.stack(
        [schedule.command(k * conventions.CONTROL_STEP) for k in range(steps + 1)]
    )


@dataclasses.dataclass(frozen=True)
class Recording:
    """The samples of several runs while they are simulated: arrays over runs and
    milliseconds."""

    qpos: np.ndarray
    qvel: np.ndarray
    torque: np.ndarray
    target: np.ndarray
    command: np.ndarray
    foot_force: np.ndarray

    @classmethod
    def empty(cls, hardware: HardwareSpec, *shape: int) -> "Recording":
        """Allocate the sample arrays for many runs of robots with this hardware."""
        sizes = {name: size for name, size in shapes_of(hardware).items() if size}
        return cls(**{name: np.zeros((*shape, *size)) for name, size in sizes.items()})

    def of(self, run: int) -> "Recording":
        """Return the recording of the run with this index."""
        return Recording(**{name: array[run] for name, array in vars(self).items()})

    def trajectory(
        self,
        request: RunRequest,
        config: EnvConfig,
        backend: Backend,
        *,
        length: int,
        fell: bool,
        mass: float,
    ) -> Trajectory:
        """Return the trajectory of a run: its first `length` milliseconds, with the
        facts of the run.

        Args:
            request: the run.
            config: the policy's environment.
            backend: the simulator.
            length: ms.
            fell: whether the next state was that of a fallen robot.
            mass: of the robot, kg.
        """
        return Trajectory(
            time=np.arange(length) * DT,
            # not the whole batch
            **{name: array[:length].copy() for name, array in vars(self).items()},
            dt=DT,
            steady_from=request.schedule.steady_from,
            fell_at=round(length * DT, 6) if fell else None,
            mass=mass,
            hardware=request.robot(config).config.hardware,
            terrain=request.world.terrain,
            name=request.name,
            backend=TITLES[backend],
        )
