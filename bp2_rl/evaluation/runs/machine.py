"""One robot in C MuJoCo, millisecond by millisecond: motors, losses and physics, converged, in float64."""

import copy
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.env.controller import motors_of
from bp2_rl.evaluation.runs.world import LEVEL, World
from bp2_rl.robot import losses, specs
from bp2_rl.robot.actuator import Actuator, bus_voltage, joint_torque, share_bus, stall_torque, torque_limits
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, NQ, NV, let_converge, load_model
from bp2_rl.settings.env import EnvConfig

DT = specs.PHYSICS_STEP
OUTSIDE = 0.1  # Nm, beyond the envelope at a step's end, that is not worth another trial
TRIALS = 12  # of a step, at most; two or three mostly do
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclasses.dataclass(frozen=True)
class Numerics:
    """How C MuJoCo computes a millisecond; the defaults are how a run is judged."""

    steps: int = 1  # physics steps
    motors_each_step: bool = False  # torques and their limits are computed anew at each of them, not held between
    iterations: int = 100  # of the constraint solver, at most
    line_search_iterations: int = 50  # likewise, in each of them
    tolerance: float = 1e-10  # scaled residual at which the solver is done

    def apply(self, model: mujoco.MjModel) -> None:
        """Set the model's options; the physics alone changes, not the robot."""
        model.opt.timestep = DT / self.steps
        let_converge(
            model, iterations=self.iterations, line_search=self.line_search_iterations, tolerance=self.tolerance
        )


JUDGE = Numerics()


class Machine:
    """A robot and its state: `model`, `data`, and the motors that move it, which may change as it runs.

    Its torque keeps to the envelope at the start of each step; of a robot whose hardware says so (`envelope`), at its
    end as well, and so all the time: a step whose torque leaves the envelope is taken again with less.
    """

    def __init__(self, config: EnvConfig, world: World = LEVEL):
        hardware = config.hardware
        self.model = load_model(hardware, visual=False, scene=world.scene())
        world.tilt(self.model)
        JUDGE.apply(self.model)
        self.data = mujoco.MjData(self.model)
        self.motors = motors_of(config)
        self.resistance = Resistance.from_hardware(hardware)
        self.throughout = hardware.envelope == "throughout"

    def millisecond(
        self,
        q_target: Float[np.ndarray, "12"],
        qd_target: Float[np.ndarray, "12"],
        numerics: Numerics = JUDGE,
    ) -> Float[np.ndarray, "12"]:
        """Motors and physics from one sample to the next; returns the torque applied at the beginning, Nm."""
        updates = numerics.steps if numerics.motors_each_step else 1
        torques = []
        for _ in range(updates):
            torques.append(self.step(q_target, qd_target, DT / updates, numerics.steps // updates))
        return torques[0]

    def step(
        self,
        q_target: Float[np.ndarray, "12"],
        qd_target: Float[np.ndarray, "12"],
        seconds: float = DT,
        steps: int = 1,
    ) -> Float[np.ndarray, "12"]:
        """The motors' torque, Nm, computed once and held for so many seconds and physics steps."""
        data = self.data
        q, qd = data.qpos[MOTOR_QPOS], data.qvel[MOTOR_QVEL].copy()
        before = data.ctrl.copy()
        torque = joint_torque(self.motors, before, q, qd, q_target, qd_target, seconds)
        if not self.throughout:
            self._advance(torque, steps)
            return torque
        voltage, start = bus_voltage(self.motors, before, qd), np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, data, start, STATE)
        limits = torque_limits(self.motors, qd, voltage)
        for _ in range(TRIALS):
            self._advance(torque, steps)
            beyond = _beyond(self.motors, torque, data.qvel[MOTOR_QVEL], voltage)
            if np.max(np.abs(beyond)) <= OUTSIDE:
                break
            response = _steepness(self.motors) * seconds * mobility(self.model, self.data)
            torque = _less(self.motors, torque, beyond, response, limits, qd)
            mujoco.mj_setState(self.model, data, start, STATE)
        else:
            self._advance(torque, steps)
        return torque

    def copy(self) -> "Machine":
        """Another robot like this one, in the state that this one is in."""
        twin = copy.copy(self)
        twin.model, twin.data = copy.copy(self.model), copy.copy(self.data)
        return twin

    def settle(self, seconds: float, damping: float) -> None:
        """Stand at the keyframe `stand` under the joint PD loop until still, then call that the origin.

        Args:
            seconds: how long.
            damping: on everything that moves meanwhile, 1/s.
        """
        data = self.data
        mujoco.mj_resetDataKeyframe(self.model, data, self.model.key("stand").id)
        stand, still = data.qpos[MOTOR_QPOS], np.zeros(specs.NUM_MOTORS)
        for _ in range(round(seconds / DT)):
            self.step(stand, still)
            data.qvel *= 1.0 - damping * DT
        data.qpos[:2] = 0.0
        data.qvel[:] = 0.0
        data.time = 0.0

    def _advance(self, torque: Float[np.ndarray, "12"], steps: int) -> None:
        data = self.data
        data.ctrl[:] = torque
        if self.resistance is not None:
            data.qfrc_applied[:] = losses.generalized(losses.loss(self.resistance, data.qpos, data.qvel, torque))
        mujoco.mj_step(self.model, data, nstep=steps)


class SwiftMachine(Machine):
    """The same robot twice as fast, for a judge in a hurry: the laws of motors and losses are compiled.

    Compiled code rounds otherwise, so two machines agree as two runs do that begin a hair's breadth apart. Its motors
    stay as they are: each others would be compiled anew.
    """

    def step(
        self,
        q_target: Float[np.ndarray, "12"],
        qd_target: Float[np.ndarray, "12"],
        seconds: float = DT,
        steps: int = 1,
    ) -> Float[np.ndarray, "12"]:
        """As `Machine.step`."""
        data = self.data
        laws = compiled_laws(self.motors, self.resistance, seconds)  # pyright: ignore[reportArgumentType]
        before, qpos, qvel = data.ctrl.copy(), data.qpos.copy(), data.qvel.copy()
        forces = laws.ask(before, qpos, qvel, q_target, qd_target)
        start = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, data, start, STATE)
        for _ in range(TRIALS if self.throughout else 0):
            self._apply(forces, steps)
            tried = laws.correct(forces[:12], before, qpos, qvel, data.qvel, mobility(self.model, self.data))
            if tried[-1] <= OUTSIDE:
                return forces[:12]
            forces = tried[:-1]
            mujoco.mj_setState(self.model, data, start, STATE)
        self._apply(forces, steps)
        return forces[:12]

    def _apply(self, forces: Float[np.ndarray, "34"], steps: int) -> None:
        self.data.ctrl[:], self.data.qfrc_applied[:] = forces[:12], forces[12:]
        mujoco.mj_step(self.model, self.data, nstep=steps)


def mobility(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "12"]:
    """Acceleration of each joint per torque on it, rad/s2/Nm, at the state that the last step began with."""
    answer = np.empty_like(_UNIT)
    mujoco.mj_solveM(model, data, answer, _UNIT)
    return answer[_EACH, MOTOR_QVEL]


_EACH = np.arange(specs.NUM_MOTORS)
_UNIT = np.zeros((specs.NUM_MOTORS, NV))
_UNIT[_EACH, MOTOR_QVEL] = 1.0


# --- What is done about the envelope at a step's end --------------------------------------------------------------


def _steepness(motors: Actuator) -> Any:
    """Of the envelope's falling line, Nm s/rad."""
    return stall_torque(motors.peak_torque, motors.corner_speed, motors.no_load_speed) / motors.no_load_speed


def _beyond(motors: Actuator, torque: Any, qd: Any, voltage: Any) -> Float[Any, "12"]:
    """How far a torque is outside the limits at the joint speeds at a step's end, Nm."""
    lower, upper = torque_limits(motors, qd, voltage)
    return torque - qd.__array_namespace__().clip(torque, lower, upper)


def _less(motors: Actuator, torque: Any, beyond: Any, response: Any, limits: tuple[Any, Any], qd: Any) -> Any:
    """The torque to try next, Nm.

    Less torque changes the speed at the end, too, and the limit with it: Newton's step, joint by joint. `response` is
    by how much a limit at the end moves with the torque.
    """
    return share_bus(motors, torque - beyond / (1.0 + response), limits, qd)  # with less torque more flows back


@dataclasses.dataclass(frozen=True)
class Laws:
    """Compiled in float64, from arrays to one array: the motors' torque (12), then the losses' forces (22).

    Arrays may have an axis of robots in front.
    """

    ask: Callable[..., Float[np.ndarray, "... _"]]  # what is asked for
    correct: Callable[..., Float[np.ndarray, "... _"]]  # what to try next, and how far the torque was outside


@functools.lru_cache(maxsize=8)
def compiled_laws(motors: Actuator, resistance: Resistance | None, seconds: float) -> Laws:
    """The laws of motors and losses for steps of so many seconds, of one robot or of many alike."""

    def compiled(law: Law) -> Callable[..., Float[np.ndarray, "... _"]]:
        packed = _packed(law)
        one = jax.jit(functools.partial(packed, motors, resistance, seconds))
        many = jax.jit(jax.vmap(functools.partial(packed, motors, resistance, seconds)))

        def call(*arrays: Float[np.ndarray, "... _"]) -> Float[np.ndarray, "... _"]:
            values = np.concatenate(arrays, axis=-1)
            with jax.enable_x64(True):
                return np.asarray((one if values.ndim == 1 else many)(values))

        return call

    return Laws(compiled(_ASK), compiled(_CORRECT))


class LawsOfEach:
    """Likewise of robots that differ in their numbers, but not in which losses they have at all; as `Laws`."""

    def __init__(self, motors: Sequence[Actuator], resistances: Sequence[Resistance | None], seconds: float):
        self._motors, self._resistances, self._seconds = list(motors), list(resistances), seconds
        self._numbers: Any = None

    def renew(self, robot: int, motors: Actuator) -> None:
        """From now on a robot has these motors."""
        self._motors[robot], self._numbers = motors, None

    def ask(self, *arrays: Float[np.ndarray, "N _"]) -> Float[np.ndarray, "N _"]:
        """What is asked for."""
        return self._call(_ASK, arrays)

    def correct(self, *arrays: Float[np.ndarray, "N _"]) -> Float[np.ndarray, "N _"]:
        """What to try next, and how far the torque was outside."""
        return self._call(_CORRECT, arrays)

    def _call(self, law: "Law", arrays: Sequence[np.ndarray]) -> np.ndarray:
        with jax.enable_x64(True):
            if self._numbers is None:
                each = zip(map(_by_joint, self._motors), self._resistances, strict=True)
                self._numbers = jax.tree.map(lambda *values: jnp.array(np.stack(values)), *each)
            return np.asarray(_each(law, self._seconds)(*self._numbers, np.concatenate(arrays, axis=-1)))


def _by_joint(motors: Actuator) -> Actuator:
    """The same with a number for each joint, as warm ones have."""
    joints = jax.tree.map(lambda x: np.broadcast_to(np.float64(x), specs.NUM_MOTORS), motors.replace(bus=None))
    return joints.replace(bus=motors.bus)


@functools.lru_cache(maxsize=8)
def _each(law: "Law", seconds: float) -> Callable[..., Any]:
    packed = _packed(law)
    return jax.jit(jax.vmap(lambda motors, resistance, values: packed(motors, resistance, seconds, values)))


@dataclasses.dataclass(frozen=True)
class Law:
    """A law of the motors, and the sizes of the arrays that it takes."""

    of: Callable[..., tuple[Array, ...]]  # (motors, resistance, seconds, *arrays)
    sizes: tuple[int, ...]


def _packed(law: Law) -> Callable[..., Array]:
    """The law as one program from one array to one: half of the time of a call is its arrays."""
    at = np.cumsum(law.sizes)[:-1].tolist()

    def packed(motors: Actuator, resistance: Resistance | None, seconds: float, values: Array) -> Array:
        return jnp.concatenate(law.of(motors, resistance, seconds, *jnp.split(values, at)))

    return packed


def _with_losses(resistance: Resistance | None, qpos: Array, qvel: Array, torque: Array) -> tuple[Array, ...]:
    if resistance is None:
        return torque, jnp.zeros_like(qvel)
    return torque, losses.generalized(losses.loss(resistance, qpos, qvel, torque))


def _ask(
    motors: Any, resistance: Any, seconds: float, before: Array, qpos: Array, qvel: Array, q_target: Array,
    qd_target: Array,
) -> tuple[Array, ...]:  # fmt: skip
    q, qd = _of_motors(qpos[7:]), _of_motors(qvel[6:])
    torque = joint_torque(motors, before, q, qd, q_target, qd_target, seconds)
    return _with_losses(resistance, qpos, qvel, torque)


def _correct(
    motors: Any, resistance: Any, seconds: float, torque: Array, before: Array, qpos: Array, qvel: Array,
    qvel_after: Array, mobility: Array,
) -> tuple[Array, ...]:  # fmt: skip
    qd = _of_motors(qvel[6:])
    voltage = bus_voltage(motors, before, qd)
    beyond = _beyond(motors, torque, _of_motors(qvel_after[6:]), voltage)
    limits = torque_limits(motors, qd, voltage)
    less = _less(motors, torque, beyond, _steepness(motors) * seconds * mobility, limits, qd)
    return *_with_losses(resistance, qpos, qvel, less), jnp.max(jnp.abs(beyond), keepdims=True)


_ASK, _CORRECT = Law(_ask, (12, NQ, NV, 12, 12)), Law(_correct, (12, 12, NQ, NV, NV, 12))


def _of_motors(coordinates: Float[Array, "16"]) -> Float[Array, "12"]:
    """The motors' of the legs' coordinates."""
    return coordinates.reshape(4, 4)[:, :3].reshape(12)
