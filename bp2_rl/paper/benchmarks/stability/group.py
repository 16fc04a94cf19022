"""Robots in C MuJoCo whose complete state can be read, changed and continued from."""

import dataclasses
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from bp2_rl.env.controller import ControllerState
from bp2_rl.env.termination import fall
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HEADING_HOLD, HeadingHold
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation.policy_runner import (
    ActionFunction,
    PolicyRunner,
    control_steps_behind,
)
from bp2_rl.simulation.rollout import Recording, RunRequest
from bp2_rl.simulation.schedule import Course
from bp2_rl.simulation.simulator import RobotSetup, Simulator, settled
from bp2_rl.simulation.trajectory import Trajectory


@dataclasses.dataclass(frozen=True)
class GroupState:
    """Complete state of N robots between two control steps, to continue a run from."""

    qpos: Float[np.ndarray, "N 23"]
    qvel: Float[np.ndarray, "N 22"]
    torque: Float[np.ndarray, "N 12"]  # Nm, last applied
    # the solver's first guess: with a converged solver it decides nothing
    warmstart: Float[np.ndarray, "N 22"]
    phase: Float[np.ndarray, " N"]  # cycles, of the controller's clock
    action: Float[np.ndarray, "N 12"]  # the last one
    # what the controller remembers of its observations
    seen: Float[np.ndarray, "N H 47"]
    steps: Float[np.ndarray, " N"]  # control steps since the start
    command: Float[np.ndarray, "N 3"]  # m/s, m/s, rad/s: what the policy is told next
    # rad, targets of the last D control steps, newest last; D by the latency
    position: Float[np.ndarray, "N D 12"]
    velocity: Float[np.ndarray, "N D 12"]  # rad/s, rates of these targets

    def __len__(self) -> int:
        """Number of robots."""
        return len(self.qpos)

    def of(self, robots: Sequence[int] | Int[np.ndarray, " M"]) -> "GroupState":
        """Return the state of the robots with these indices, which may repeat."""
        return GroupState(
            **{name: np.array(value[robots]) for name, value in vars(self).items()}
        )


def join(*states: GroupState) -> GroupState:
    """Return the states of several groups of robots as a single group's state."""
    return GroupState(
        **{
            name: np.concatenate([vars(state)[name] for state in states])
            for name in vars(states[0])
        }
    )


@dataclasses.dataclass(frozen=True)
class GroupRecording:
    """Samples of a group's run, one each millisecond, until each robot's fall."""

    samples: Recording  # (N, T, ...)
    # cycles of the controller's clock, counted on and on
    clock: Float[np.ndarray, "N T"]
    # ms until the fall; all of them where there was none
    lasted: Float[np.ndarray, " N"]
    config: EnvConfig
    mass: float  # kg, of each robot

    def trajectory(self, robot: int) -> Trajectory:
        """Return one robot's run, to its fall."""
        length = int(self.lasted[robot])
        return self.samples.of(robot).trajectory(
            RunRequest(Course(), name="group"),
            self.config,
            "mujoco",
            length=length,
            fell=length < self.clock.shape[1],
            mass=self.mass,
        )


class RobotGroup:
    """A group of equal robots under one policy, simulated side by side.

    Args:
        policy: observation -> action, for one robot.
        config: the policy's environment.
        hardware: the robots; those that the policy and its controller take them for by
            default.
        operator: steers each of them.
        noise: the deviations of the sensors' noise; None for sensors without noise.
    """

    def __init__(
        self,
        policy: ActionFunction,
        config: EnvConfig,
        *,
        hardware: HardwareSpec | None = None,
        operator: HeadingHold = HEADING_HOLD,
        noise: RandomizationConfig | None = None,
    ):
        self.robot = RobotSetup.of(config, hardware)
        self.memory = max(
            control_steps_behind(self.robot.config.hardware.losses.latency)
        )
        """number of control steps whose targets are still on their way to the joints"""
        self._policy = policy
        self._config = config
        self._operator = operator
        self._noise = noise
        self._model = self.robot.model()

    def standing(self, robots: int, command: Float[np.ndarray, "3"]) -> GroupState:
        """Return the state of robots that stand still, and whose policy observes
        `command` next."""
        runner = self._runner(np.asarray(command, np.float64)[None])
        return self._state(settled([self.robot]), runner).of(np.zeros(robots, int))

    def run(
        self,
        state: GroupState,
        commands: Float[np.ndarray, "K N 3"],
        *,
        seed: int = 0,
        noisy: Float[np.ndarray, " N"] | None = None,
        until: Callable[[int, GroupState], None] | None = None,
    ) -> tuple[GroupState, Bool[np.ndarray, " N"], GroupRecording]:
        """Simulate K control steps from a state; return the last state, who fell, and a
        recording.

        Robots that fell stay as they are.

        Args:
            state: where the robots begin.
            commands: scheduled at the ends of the control steps, m/s and rad/s.
            seed: of the noise.
            noisy: each robot's share of the noise, 1 by default.
            until: is shown the number of each control step and the state after it.
        """
        count = len(state)
        steps = len(commands)
        simulator, runner = self._continued(state)
        samples = conventions.SUBSTEPS * steps
        recording = GroupRecording(
            Recording.empty(self.robot.config.hardware, count, samples),
            clock=np.zeros((count, samples)),
            lasted=np.full(count, float(samples)),
            config=self.robot.config,
            mass=simulator.mass(0),
        )
        into = recording.samples
        fell = np.zeros(count, bool)
        drawn = [()] * steps
        if self._noise is not None:
            keys = jax.random.split(jax.random.PRNGKey(seed), (steps, count))
            share = np.ones(count) if noisy is None else noisy
            drawn = [(key, share) for key in np.asarray(keys)]
        cycles = state.phase
        for k, scheduled in enumerate(commands):
            before = runner.phase
            targets = runner.tick(simulator.qpos, simulator.qvel, scheduled, *drawn[k])
            rate = (runner.phase - before) % 1.0 / conventions.SUBSTEPS
            for i, (position, velocity) in enumerate(targets, k * conventions.SUBSTEPS):
                into.qpos[:, i], into.qvel[:, i] = simulator.qpos, simulator.qvel
                into.target[:, i] = position
                into.command[:, i] = runner.command
                recording.clock[:, i] = cycles
                simulator.millisecond(position, velocity, np.flatnonzero(~fell))
                into.torque[:, i] = simulator.torque
                into.foot_force[:, i] = simulator.foot_force
                now = simulator.qpos, simulator.qvel
                down = fall(*now, self._config.termination).happened & ~fell
                recording.lasted[down] = i + 1
                fell = fell | down
                cycles = cycles + rate
            if until is not None:
                until(k, self._state(simulator, runner))
            if fell.all():
                break
        return self._state(simulator, runner), fell, recording

    def _continued(self, state: GroupState) -> tuple[Simulator, PolicyRunner]:
        """Return a simulator and a policy runner that continue from `state`."""
        simulator = Simulator([self.robot] * len(state), [self._model] * len(state))
        simulator.begin(state.qpos, state.qvel, state.torque, state.warmstart)
        runner = self._runner(state.command)
        remembered = state.phase, state.action, state.seen, state.steps
        with jax.default_device(jax.devices("cpu")[0]):
            runner.state = ControllerState(
                *(jnp.asarray(x, jnp.float32) for x in remembered)
            )
        runner.position[:, 1:], runner.velocity[:, 1:] = state.position, state.velocity
        return simulator, runner

    def _runner(self, commands: Float[np.ndarray, "N 3"]) -> PolicyRunner:
        count = len(commands)
        return PolicyRunner(
            self._policy,
            self._config,
            operators=[self._operator] * count,
            latencies=[self.robot.config.hardware.losses.latency] * count,
            commands=commands,
            noise=self._noise,
        )

    @staticmethod
    def _state(simulator: Simulator, runner: PolicyRunner) -> GroupState:
        remembered = jax.tree.map(lambda x: np.asarray(x, np.float64), runner.state)
        return GroupState(
            qpos=simulator.qpos.copy(),
            qvel=simulator.qvel.copy(),
            torque=simulator.torque.copy(),
            warmstart=simulator.warmstart.copy(),
            phase=remembered.phase,
            action=remembered.last_action,
            seen=remembered.past_frames,
            steps=remembered.steps,
            command=np.asarray(runner.next_command, np.float64),
            position=runner.position[:, 1:].copy(),
            velocity=runner.velocity[:, 1:].copy(),
        )
