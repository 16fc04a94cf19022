"""Many robots side by side in C MuJoCo, as the judge computes them: what `rollout_mujoco` does of one, for a flock.

All robots have the same hardware and policy. The laws of motors and losses are computed for all of them at once, so
that a robot of a large flock costs a fifth of one alone; MuJoCo takes its millisecond one by one. A flock begins at any
moment of its robots, and goes on from where it is.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.env.controller import Controller, ControllerState, motors_of
from bp2_rl.env.termination import fall
from bp2_rl.robot import specs
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import NV, foot_forces, load_model
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation.bodies import Bodies
from bp2_rl.simulation.driver import ActionFunction, control_step, control_steps_behind
from bp2_rl.simulation.laws import row_of
from bp2_rl.simulation.machine import JUDGE
from bp2_rl.simulation.operator import HEADING_HOLD, HeadingHold
from bp2_rl.simulation.rollout import standing_start
from bp2_rl.simulation.trajectory import Trajectory

DT = specs.PHYSICS_STEP
STAND = np.array(specs.STAND_JOINTS)


@dataclasses.dataclass(frozen=True)
class FlockState:
    """Complete state of N robots between two control steps: a run can be continued from it."""

    qpos: Float[np.ndarray, "N 23"]
    qvel: Float[np.ndarray, "N 22"]
    torque: Float[np.ndarray, "N 12"]  # Nm, last applied
    warmstart: Float[np.ndarray, "N 22"]  # the solver's first guess: with a converged solver it decides nothing
    phase: Float[np.ndarray, " N"]  # cycles, of the controller's clock
    action: Float[np.ndarray, "N 12"]  # the last one
    seen: Float[np.ndarray, "N H 47"]  # what the controller remembers of its observations
    steps: Float[np.ndarray, " N"]  # control steps since the start
    command: Float[np.ndarray, "N 3"]  # m/s, m/s, rad/s: what the policy is told next
    position: Float[np.ndarray, "N D 12"]  # rad, targets of the last D control steps, newest last; D by the latency
    velocity: Float[np.ndarray, "N D 12"]  # rad/s, likewise

    def __len__(self) -> int:
        """Number of robots."""
        return len(self.qpos)

    def of(self, robots: Any) -> "FlockState":
        """These robots alone, or over again, by any index of NumPy's."""
        return FlockState(**{name: np.array(value[robots]) for name, value in vars(self).items()})

    def replace(self, **changes: Any) -> "FlockState":
        """Return this state with some fields replaced."""
        return dataclasses.replace(self, **changes)


def together(*moments: FlockState) -> FlockState:
    """All robots of several flocks as one."""
    return FlockState(**{name: np.concatenate([vars(moment)[name] for moment in moments]) for name in vars(moments[0])})


@dataclasses.dataclass(frozen=True)
class Recorded:
    """What a flock did, sampled each millisecond; samples after a robot's fall mean nothing."""

    qpos: Float[np.ndarray, "T N 23"]
    qvel: Float[np.ndarray, "T N 22"]
    torque: Float[np.ndarray, "T N 12"]
    target: Float[np.ndarray, "T N 12"]
    command: Float[np.ndarray, "T N 3"]
    foot_force: Float[np.ndarray, "T N 4 3"]
    clock: Float[np.ndarray, "T N"]  # cycles of the controller's clock, counted on and on
    lasted: Float[np.ndarray, " N"]  # ms until the fall; all of them where there was none

    def trajectory(self, robot: int, hardware: HardwareSpec, mass: float, steady_from: float) -> Trajectory:
        """One robot's run, to its fall."""
        length = int(self.lasted[robot])
        arrays = {
            field: getattr(self, field)[:length, robot]
            for field in ("qpos", "qvel", "torque", "target", "command", "foot_force")
        }
        return Trajectory(
            time=np.arange(length) * DT,
            **arrays,
            dt=DT,
            steady_from=steady_from,
            fell_at=round(length * DT, 6) if length < len(self.qpos) else None,
            mass=mass,
            hardware=hardware,
            name="flock",
            backend="C MuJoCo",
        )


class Flock:
    """Robots of one kind under one policy.

    Args:
        policy: observation -> action, for one robot.
        config: the policy's environment.
        hardware: the robots, if not those that the policy and its controller take them for.
        operator: who steers each of them.
        noise: deviations of the sensors' noise; None: there is none.
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
        self.config = dataclasses.replace(config, hardware=hardware or config.hardware)
        self.hardware = self.config.hardware
        self.model = load_model(self.hardware, visual=False, weighed=True)
        JUDGE.apply(self.model)
        self.mass = float(np.sum(self.model.body_mass))
        self._motors = row_of(motors_of(self.config), Resistance.from_hardware(self.hardware), DT)
        self._behind = control_steps_behind(self.hardware.losses.latency)
        self._noise = noise
        self._init = Controller(config).init()
        self._control = _compiled(policy, config, operator, noise)
        self._data: list[mujoco.MjData] = []

    @property
    def memory(self) -> int:
        """Number of control steps whose targets are still on their way to the joints."""
        return max(self._behind)

    def standing(self, robots: int, command: Float[np.ndarray, "3"]) -> FlockState:
        """Return the state of settled robots at rest whose next command is `command`."""
        data = standing_start(self.config).data
        depth = self.memory

        def each(values: Any) -> np.ndarray:
            return np.repeat(np.asarray(values, np.float64)[None], robots, axis=0)

        return FlockState(
            qpos=each(data.qpos),
            qvel=each(data.qvel),
            torque=each(data.ctrl),
            warmstart=each(data.qacc_warmstart),
            phase=each(self._init.phase),
            action=each(self._init.last_action),
            seen=each(self._init.seen),
            steps=each(self._init.steps),
            command=each(np.asarray(command, np.float32)),
            position=each(np.tile(STAND, (depth, 1))),
            velocity=each(np.zeros((depth, specs.NUM_MOTORS))),
        )

    def run(
        self,
        moment: FlockState,
        commands: Float[np.ndarray, "K N 3"],
        *,
        seed: int = 0,
        noisy: Float[np.ndarray, " N"] | None = None,
        record: bool = False,
        until: Callable[[int, FlockState], None] | None = None,
    ) -> tuple[FlockState, Bool[np.ndarray, " N"], Recorded | None]:
        """Go on from a moment for K control steps; (the moment then, who fell, what they did on the way).

        Robots that fell stay as they are. `commands` are those scheduled at the ends of the control steps; `noisy` is
        each robot's share of the noise, drawn from `seed`. `until` is shown the moment after every control step.
        """
        count, steps = len(moment), len(commands)
        self._data += [mujoco.MjData(self.model) for _ in range(count - len(self._data))]
        data = self._data[:count]
        for one, qpos, qvel, torque, warm in zip(
            data, moment.qpos, moment.qvel, moment.torque, moment.warmstart, strict=True
        ):
            mujoco.mj_resetData(self.model, one)
            one.qpos[:], one.qvel[:], one.ctrl[:], one.qacc_warmstart[:] = qpos, qvel, torque, warm
        body = Bodies(
            [self.model] * count,
            data,
            [self._motors] * count,
            throughout=[self.hardware.envelope == "throughout"] * count,
            numerics=[JUDGE] * count,
        )
        fell, log = np.zeros(count, bool), _log(count, specs.SUBSTEPS * steps if record else 0)
        state = ControllerState(
            phase=jnp.asarray(moment.phase, jnp.float32),
            last_action=jnp.asarray(moment.action, jnp.float32),
            seen=jnp.asarray(moment.seen, jnp.float32),
            steps=jnp.asarray(moment.steps, jnp.float32),
        )
        command, turns = np.asarray(moment.command, np.float32), np.zeros(count)
        position, velocity = list(moment.position.swapaxes(0, 1)), list(moment.velocity.swapaxes(0, 1))
        noise = () if self._noise is None else (np.ones(count) if noisy is None else noisy,)
        keys = np.asarray(jax.random.split(jax.random.PRNGKey(seed), (steps, count))) if noise else ()
        before = np.asarray(moment.phase)
        for k, scheduled in enumerate(commands):
            extra = (keys[k], *noise) if noise else ()
            state, target, next_command = self._control(state, command, body.qpos, body.qvel, scheduled, *extra)
            position.append(np.asarray(target.position, np.float64))
            velocity.append(np.asarray(target.velocity, np.float64))
            after = np.asarray(state.phase, np.float64)
            rate = (after - before) % 1.0 / specs.SUBSTEPS
            for substep, late in enumerate(self._behind):
                wanted, wanted_rate = position[-1 - late], velocity[-1 - late]
                if record:
                    i = k * specs.SUBSTEPS + substep
                    log.qpos[i], log.qvel[i], log.target[i], log.command[i] = body.qpos, body.qvel, wanted, command
                    log.clock[i] = moment.phase + turns + substep * rate
                up = np.flatnonzero(~fell)
                body.millisecond(wanted, wanted_rate, up)
                if record:
                    log.torque[i] = body.torque
                    for robot in up:
                        log.foot_force[i, robot] = foot_forces(data[robot])
                down = fall(body.qpos, body.qvel, self.config.termination).happened & ~fell
                log.lasted[down] = k * specs.SUBSTEPS + substep + 1
                fell = fell | down
            before, turns = after, turns + specs.SUBSTEPS * rate
            command = np.asarray(next_command)
            del position[: -self.memory or None], velocity[: -self.memory or None]
            if until is not None:
                until(k, self._moment(body, state, command, position, velocity))
            if fell.all():
                break
        return self._moment(body, state, command, position, velocity), fell, log if record else None

    def _moment(
        self, body: Bodies, state: ControllerState, command: np.ndarray, position: list, velocity: list
    ) -> FlockState:
        count = len(body.data)

        def history(issued: list[np.ndarray]) -> np.ndarray:
            return np.stack(issued, axis=1) if issued else np.zeros((count, 0, specs.NUM_MOTORS))

        return FlockState(
            qpos=body.qpos.copy(),
            qvel=body.qvel.copy(),
            torque=body.torque.copy(),
            warmstart=np.stack([one.qacc_warmstart for one in body.data]),
            phase=np.asarray(state.phase, np.float64),
            action=np.asarray(state.last_action, np.float64),
            seen=np.asarray(state.seen, np.float64),
            steps=np.asarray(state.steps, np.float64),
            command=np.asarray(command, np.float64),
            position=history(position),
            velocity=history(velocity),
        )


def _log(count: int, samples: int) -> Recorded:
    sizes = {
        "qpos": (23,),
        "qvel": (NV,),
        "torque": (12,),
        "target": (12,),
        "command": (3,),
        "foot_force": (4, 3),
        "clock": (),
    }
    arrays = {name: np.zeros((samples, count, *size)) for name, size in sizes.items()}
    return Recorded(**arrays, lasted=np.full(count, float(samples)))


@functools.lru_cache(maxsize=8)
def _compiled(
    policy: ActionFunction, config: EnvConfig, operator: HeadingHold, noise: RandomizationConfig | None
) -> Callable[..., Any]:
    control = control_step(policy, config, operator, noise)

    def without_reference(*arguments):
        state, targets, _, command = control(*arguments)
        return state, targets, command

    return jax.jit(jax.vmap(without_reference))
