"""The simulator: robots in C MuJoCo side by side, millisecond by millisecond, with the
laws of motors and losses.

The physics is float64 with a converged solver. The laws are compiled once for all
robots, and MuJoCo steps each robot by itself, so that robots may differ in hardware,
ground and numerics. Compiled laws round otherwise than NumPy's.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np
from jaxtyping import Float, Int

from bp2_rl.env.controller import motors_of
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.coordinates import joint_positions, motor_indices
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import foot_forces, let_converge, load_model
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation import laws
from bp2_rl.simulation.backend import Backend, DrakeContact
from bp2_rl.simulation.world import LEVEL, Draw, World

DT = conventions.PHYSICS_STEP
SETTLING_TIME = 4.0  # s of standing before the clock starts
# 1/s, on everything that moves meanwhile: BP2's own sway takes half a minute to die
# away
SETTLING_DAMPING = 10.0
# Nm, beyond the envelope at a step's end, that is not worth another trial
OUTSIDE = 0.1
TRIALS = 12  # of a step, at most; two or three mostly do
STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclasses.dataclass(frozen=True)
class Numerics:
    """The numerical settings of C MuJoCo's physics, by default as in all benchmarks."""

    # physics steps, at least; Drake takes more where its contact needs them
    steps: int = 1
    # torques and their limits are computed anew at each of them, not held between
    motors_each_step: bool = False
    iterations: int = 100  # of the constraint solver, at most
    line_search_iterations: int = 50  # of the line search in each iteration, at most
    tolerance: float = 1e-10  # scaled residual at which the solver is done
    drake: DrakeContact = DrakeContact()  # contact, where Drake takes MuJoCo's place

    @property
    def updates(self) -> int:
        """Number of torque updates in each millisecond."""
        return self.steps if self.motors_each_step else 1

    @property
    def period(self) -> float:
        """Time from one computation of the torques to the next, s."""
        return DT / self.updates

    def apply(self, model: mujoco.MjModel) -> None:
        """Set the time step and the solver options of a MuJoCo model."""
        model.opt.timestep = DT / self.steps
        let_converge(
            model,
            iterations=self.iterations,
            line_search=self.line_search_iterations,
            tolerance=self.tolerance,
        )


CONVERGED = Numerics()


@dataclasses.dataclass(frozen=True)
class RobotSetup:
    """A robot to simulate: its hardware and gains, its ground, and how its physics is
    computed."""

    config: EnvConfig
    world: World = LEVEL
    numerics: Numerics = CONVERGED
    drawn: Draw | None = None  # what chance makes of the hardware

    @classmethod
    def of(cls, config: EnvConfig, hardware: HardwareSpec | None) -> "RobotSetup":
        """Return the setup of a policy's robot in its environment, with other hardware
        if given."""
        return cls(dataclasses.replace(config, hardware=hardware or config.hardware))

    def model(self) -> mujoco.MjModel:
        """Return the robot's MuJoCo model, which reports the forces on its feet."""
        model = load_model(
            self.config.hardware, visual=False, weighed=True, scene=self.world.lay
        )
        self.numerics.apply(model)
        if self.drawn:
            self.drawn.change_model(model, self.config.hardware)
        return model

    def motors(self) -> Actuator:
        """Return the robot's motor model, randomised if the robot is."""
        motors = motors_of(self.config)
        return self.drawn.motors(motors, self.config.hardware) if self.drawn else motors

    def resistance(self) -> Resistance | None:
        """Return the model of the robot's losses, such as friction and air; None
        without losses."""
        resistance = Resistance.from_hardware(self.config.hardware)
        return (
            self.drawn.resistance(resistance, self.config.hardware)
            if self.drawn and resistance
            else resistance
        )

    @property
    def latency(self) -> float:
        """Delay between an observation and the joint target computed from it, s."""
        hardware = self.config.hardware
        return (
            float(self.drawn.values(hardware).latency)
            if self.drawn
            else hardware.losses.latency
        )


class Simulator:
    """N robots in C MuJoCo and their states; each starts at its keyframe `stand`.

    A robot's torque keeps to the motors' envelope at the start of each step. Where the
    hardware says so (`envelope`), it keeps to the envelope at the step's end as well,
    and so all the time: MuJoCo takes a step whose torque leaves the envelope again with
    less.

    Args:
        robots: what is simulated.
        models: the robots' models, where they are at hand; robots may share one.

    Attributes:
        models: each robot's model.
        data: each robot's state in MuJoCo; call `read` after a change.
        qpos: (N, nq), the robots' positions.
        qvel: (N, nv), the robots' velocities.
        torque: (N, 12), Nm, last applied.
        foot_force: (N, 4, 3), N, the ground's forces in the last physics step, world
            frame; 0 before it.
        motors: each robot's motors; `set_motors` changes them.
    """

    backend: ClassVar[Backend] = "mujoco"
    takes_again: ClassVar[bool] = True
    """whether a step can be taken again with less torque"""

    def __init__(
        self,
        robots: Sequence[RobotSetup],
        models: Sequence[mujoco.MjModel] | None = None,
    ):
        self.models = (
            [robot.model() for robot in robots] if models is None else list(models)
        )
        self.data = [mujoco.MjData(model) for model in self.models]
        self.motors = [robot.motors() for robot in robots]
        self._resistance = [robot.resistance() for robot in robots]
        self._periods = [robot.numerics.period for robot in robots]
        self._updates = np.array([robot.numerics.updates for robot in robots])
        self._steps = [
            robot.numerics.steps // robot.numerics.updates for robot in robots
        ]
        self._most_updates = int(np.max(self._updates))
        self._throughout = np.array(
            [
                self.takes_again and robot.config.hardware.envelope == "throughout"
                for robot in robots
            ]
        )
        self._rows = None
        for model, data in zip(self.models, self.data, strict=True):
            mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        # Looking an array up in MuJoCo's data takes longer than writing it.
        self._inputs = [(data.ctrl, data.qfrc_applied) for data in self.data]
        self._outputs = [
            (data.qpos, data.qvel, foot_forces(data)) for data in self.data
        ]
        self._start = np.empty(
            (len(robots), mujoco.mj_stateSize(self.models[0], STATE))
        )
        self._mobility = np.zeros((len(robots), conventions.NUM_MOTORS))
        self._everyone = np.arange(len(robots))
        self.qpos, self.qvel, self.foot_force = (
            np.stack(values) for values in zip(*self._outputs, strict=True)
        )
        self.torque = np.zeros((len(robots), conventions.NUM_MOTORS))

    def __len__(self) -> int:
        """Number of robots."""
        return len(self.data)

    def mass(self, robot: int) -> float:
        """Return a robot's mass, kg."""
        return float(np.sum(self.models[robot].body_mass))

    def read(self, robot: int) -> None:
        """Update a robot's state in the simulator after a change of its `data` from
        outside."""
        self._copy(robot)
        self.torque = self.torque.copy()  # a millisecond has returned it
        self.torque[robot] = self.data[robot].ctrl

    def _copy(self, robot: int) -> None:
        qpos, qvel, foot_force = self._outputs[robot]
        self.qpos[robot] = qpos
        self.qvel[robot] = qvel
        self.foot_force[robot] = foot_force

    def state(self, robot: int) -> Float[np.ndarray, " S"]:
        """Return the full integration state of a robot, in MuJoCo's order."""
        state = np.empty(self._start.shape[1])
        mujoco.mj_getState(self.models[robot], self.data[robot], state, STATE)
        return state

    def set_state(self, robot: int, state: Float[np.ndarray, " S"]) -> None:
        """Set a robot to a state returned by `state`."""
        mujoco.mj_setState(self.models[robot], self.data[robot], state, STATE)
        self.data[robot].sensordata[:] = 0.0  # no step has been taken from here
        self.read(robot)

    def set_motors(self, robot: int, motors: Actuator) -> None:
        """Give a robot other motors from the next millisecond on."""
        self.motors[robot] = motors
        self._rows = None

    def settle(self) -> None:
        """Let all robots stand under the joint PD loop until they are at rest, then
        move them to the origin.

        The robots' sway is damped meanwhile.
        """
        stand = joint_positions(self.qpos).copy()
        still = np.zeros_like(stand)
        for _ in range(round(SETTLING_TIME / DT)):
            self.millisecond(stand, still)
            for robot, data in enumerate(self.data):
                data.qvel *= 1.0 - SETTLING_DAMPING * DT
                self.qvel[robot] = data.qvel
        for robot, data in enumerate(self.data):
            data.qpos[:2] = 0.0
            data.qvel[:] = 0.0
            data.time = 0.0
            self.read(robot)

    def millisecond(
        self,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        robots: Int[np.ndarray, " M"] | None = None,
    ) -> Float[np.ndarray, "N 12"]:
        """Advance motors and physics by a millisecond; return the torques applied at
        its beginning, Nm.

        Args:
            position: the joints' targets, rad.
            velocity: the targets' rates, rad/s.
            robots: indices of those that move, all by default; the others stay as they
                are.
        """
        robots = self._everyone if robots is None else robots
        self._update(position, velocity, robots)
        torque = self.torque  # each update makes an array of its own
        for update in range(1, self._most_updates):
            self._update(position, velocity, robots[self._updates[robots] > update])
        return torque

    def _update(
        self,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        robots: Int[np.ndarray, " M"],
    ) -> None:
        """Compute the motor torques once, and advance the physics until the next torque
        update."""
        if not len(robots):
            return
        if self._rows is None:
            parts = zip(self.motors, self._resistance, self._periods, strict=True)
            self._rows = laws.stacked([laws.numbers_of(*part) for part in parts])
        before = self.torque
        qpos = self.qpos.copy()
        qvel = self.qvel.copy()
        forces = laws.forces(self._rows, before, qpos, qvel, position, velocity)
        throughout = self._throughout[robots]
        tried = robots[throughout]
        for robot in tried.tolist():
            mujoco.mj_getState(
                self.models[robot], self.data[robot], self._start[robot], STATE
            )
        for trial in range(TRIALS if len(tried) else 0):
            self._step(tried, forces)
            # of the step's start, which all trials share
            for robot in tried.tolist() if trial == 0 else ():
                self._mobility[robot] = self._mobilities(robot)
            again = laws.correct(
                self._rows,
                forces[:, :12],
                before,
                qpos,
                qvel,
                self.qvel,
                self._mobility,
            )
            tried = tried[again[tried, -1] > OUTSIDE]
            if not len(tried):
                break
            forces = forces.copy()
            forces[tried] = again[tried, :-1]
            for robot in tried.tolist():
                mujoco.mj_setState(
                    self.models[robot], self.data[robot], self._start[robot], STATE
                )
        self._step(tried, forces)
        self._step(robots[~throughout], forces)
        self.torque = before.copy()
        self.torque[robots] = forces[robots, :12]

    def _step(
        self, robots: Int[np.ndarray, " M"], forces: Float[np.ndarray, "N _"]
    ) -> None:
        for robot in robots.tolist():
            torque, force = self._inputs[robot]
            torque[:] = forces[robot, :12]
            force[:] = forces[robot, 12:]
            self._advance(robot)
            self._copy(robot)

    def _advance(self, robot: int) -> None:
        """Take the physics steps of a torque update; `data` then holds the new state
        and foot forces."""
        mujoco.mj_step(self.models[robot], self.data[robot], nstep=self._steps[robot])

    def _mobilities(self, robot: int) -> Float[np.ndarray, "12"]:
        """Return each joint's acceleration per unit torque at the start of the last
        step, rad/s2/Nm."""
        unit = _unit(self.models[robot].nv)
        answer = np.empty_like(unit)
        mujoco.mj_solveM(self.models[robot], self.data[robot], answer, unit)
        return answer[unit > 0.0]


def settled(
    robots: Sequence[RobotSetup], engine: type[Simulator] = Simulator
) -> Simulator:
    """Return a simulator whose robots stand at rest on their feet at the origin.

    Each kind of robot is settled once in a process, by C MuJoCo with the usual
    numerics, as it was designed; `engine` then takes it over. Grounds that differ in
    their seeds alone are alike around the start.
    """
    kinds = [
        (
            RobotSetup(
                one.config, World(dataclasses.replace(one.world.terrain, seed=0))
            ),
            SETTLING_TIME,
        )
        for one in robots
    ]
    new = [kind for kind in dict.fromkeys(kinds) if kind not in _stands]
    if new:
        settling = Simulator([robot for robot, _ in new])
        settling.settle()
        _stands.update({kind: settling.state(i) for i, kind in enumerate(new)})
    simulator = engine(robots)
    for robot, kind in enumerate(kinds):
        simulator.set_state(robot, _stands[kind])
    return simulator


_stands: dict[tuple[RobotSetup, float], np.ndarray] = {}


@functools.cache
def _unit(nv: int) -> Float[np.ndarray, "12 _"]:
    """Return a unit generalised force on each motor's joint, a row for each motor."""
    return np.eye(nv)[motor_indices(nv)]
