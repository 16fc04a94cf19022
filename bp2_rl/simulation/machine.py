"""One robot in C MuJoCo, millisecond by millisecond: motors, losses and physics, converged, in float64."""

import copy
import dataclasses
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.env.controller import motors_of
from bp2_rl.robot import losses, specs
from bp2_rl.robot.actuator import Actuator, bus_voltage, joint_torque, share_bus, stall_torque, torque_limits
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, NV, let_converge, load_model
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.world import LEVEL, World

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
    line_search_iterations: int = 50  # of the line search in each iteration, at most
    tolerance: float = 1e-10  # scaled residual at which the solver is done

    @property
    def updates(self) -> int:
        """How often torques are computed."""
        return self.steps if self.motors_each_step else 1

    @property
    def period(self) -> float:
        """From one time to the next, s."""
        return DT / self.updates

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
        self.model = load_model(hardware, visual=False, weighed=True, scene=world.scene())
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
        steps = numerics.steps // numerics.updates
        first, *_ = [self._step(q_target, qd_target, numerics.period, steps) for _ in range(numerics.updates)]
        return first

    def _step(
        self, q_target: Float[np.ndarray, "12"], qd_target: Float[np.ndarray, "12"], seconds: float, steps: int
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
            outside = beyond(self.motors, torque, data.qvel[MOTOR_QVEL], voltage)
            if np.max(np.abs(outside)) <= OUTSIDE:
                break
            response = steepness(self.motors) * seconds * mobility(self.model, self.data)
            torque = less(self.motors, torque, outside, response, limits, qd)
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
            self.millisecond(stand, still)
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


def mobility(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "12"]:
    """Acceleration of each joint per torque on it, rad/s2/Nm, at the state that the last step began with."""
    answer = np.empty_like(_UNIT)
    mujoco.mj_solveM(model, data, answer, _UNIT)
    return answer[_EACH, MOTOR_QVEL]


_EACH = np.arange(specs.NUM_MOTORS)
_UNIT = np.zeros((specs.NUM_MOTORS, NV))
_UNIT[_EACH, MOTOR_QVEL] = 1.0


# --- What is done about the envelope at a step's end --------------------------------------------------------------


def steepness(motors: Actuator) -> Any:
    """Return the slope of the envelope's falling line, Nm s/rad."""
    return stall_torque(motors.peak_torque, motors.corner_speed, motors.no_load_speed) / motors.no_load_speed


def beyond(motors: Actuator, torque: Any, qd: Any, voltage: Any) -> Float[Any, "12"]:
    """How far a torque is outside the limits at the joint speeds at a step's end, Nm."""
    lower, upper = torque_limits(motors, qd, voltage)
    return torque - qd.__array_namespace__().clip(torque, lower, upper)


def less(motors: Actuator, torque: Any, outside: Any, response: Any, limits: tuple[Any, Any], qd: Any) -> Any:
    """The torque to try next, Nm.

    Less torque changes the speed at the end, too, and the limit with it: Newton's step, joint by joint. `response` is
    by how much a limit at the end moves with the torque.
    """
    return share_bus(motors, torque - outside / (1.0 + response), limits, qd)  # with less torque more flows back
