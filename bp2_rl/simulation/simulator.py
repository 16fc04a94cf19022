"""The simulator: robots in C MuJoCo side by side, millisecond by millisecond, with the
laws of motors and losses.

The physics is float64 with a converged solver. The laws are compiled once for all
robots. MuJoCo steps robots whose data have one layout in a batch; robots may differ in
hardware, ground and numerics. Compiled laws round otherwise than NumPy's.
"""

import dataclasses
import functools
import operator
from collections.abc import Iterator, Sequence
from typing import ClassVar

import mujoco
import numpy as np
from jaxtyping import Float, Int
from mujoco.batch import MODEL_FIELDS, Batch

from bp2_rl.env.controller import motors_of
from bp2_rl.env.randomization import randomize_actuator, randomize_resistance
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.coordinates import joint_positions, motor_indices
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import let_converge, load_model
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation import laws
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.world import LEVEL, Draw, Push, World, shove

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

    steps: int = 1  # physics steps
    # torques and their limits are recomputed at each of them, not held between
    motors_each_step: bool = False
    iterations: int = 100  # of the constraint solver, at most
    line_search_iterations: int = 50  # of the line search in each iteration, at most
    tolerance: float = 1e-10  # scaled residual at which the solver is done

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
    drawn: Draw | None = None  # random changes of the hardware

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
        if self.drawn is None:
            return motors
        return randomize_actuator(motors, self.drawn.values(self.config.hardware))

    def resistance(self) -> Resistance | None:
        """Return the model of the robot's losses, such as friction and air; None
        without losses."""
        resistance = Resistance.from_hardware(self.config.hardware)
        if self.drawn is None or resistance is None:
            return resistance
        return randomize_resistance(resistance, self.drawn.values(self.config.hardware))

    @property
    def latency(self) -> float:
        """Delay between an observation and the joint target computed from it, s."""
        hardware = self.config.hardware
        return (
            float(self.drawn.values(hardware).latency)
            if self.drawn
            else hardware.losses.latency
        )


class RobotBatch:
    """Robots whose MuJoCo data have one layout, and that take as many physics steps at
    a time: one batch of MuJoCo's.

    Args:
        robots: their indices in the simulator.
        models: each robot's model.
        steps: physics steps in each torque update.

    Attributes:
        state: (M, S), the robots' integration states in MuJoCo's order; a change of it,
            or of the views below, is the robot's state from then on.
        qpos, qvel, ctrl, qfrc_applied, warmstart: views of `state`.
        sensed: (M, 12), N, the ground's forces on the feet in the last step.
    """

    def __init__(
        self,
        robots: Int[np.ndarray, " M"],
        models: Sequence[mujoco.MjModel],
        steps: int,
    ):
        self.robots, self.steps = robots, steps
        self.batch = Batch(models[0], len(models), nthread=1, persistent=False)
        _set_models(self.batch, models)
        stands = [model.key("stand").id for model in models]
        self.batch.reset(keyframe=stands, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        self.state = self.batch.state
        self.qpos, self.qvel, self.ctrl, self.qfrc_applied, self.warmstart = map(
            self.batch.bind, ("qpos", "qvel", "ctrl", "qfrc_applied", "qacc_warmstart")
        )
        self.sensed = self.batch.bind("sensordata")
        # of the mass matrix, at the start of the last step
        self._factors = self.batch.bind("qLD"), self.batch.bind("qLDiagInv")
        self._model, self._into = models[0], mujoco.MjData(models[0])

    def solve(
        self, at: Int[np.ndarray, " M"], forces: Float[np.ndarray, "R nv"]
    ) -> Float[np.ndarray, "M R nv"]:
        """Return the accelerations that generalised forces give the robots at these
        places, by their mass matrices at the start of the last step."""
        answers = np.empty((len(at), *forces.shape))
        into, (factors, inverses) = self._into, self._factors
        for i, place in enumerate(at.tolist()):
            into.qLD[:], into.qLDiagInv[:] = factors[place], inverses[place]
            mujoco.mj_solveM(self._model, into, answers[i], forces)
        return answers


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
        motors: each robot's motors; `set_motors` changes them.
        foot_force: (N, 4, 3), N, the ground's forces in the last physics step, world
            frame; 0 before it.
    """

    backend: ClassVar[Backend] = "mujoco"

    def __init__(
        self,
        robots: Sequence[RobotSetup],
        models: Sequence[mujoco.MjModel] | None = None,
    ):
        self.models = (
            [robot.model() for robot in robots] if models is None else list(models)
        )
        self.motors = [robot.motors() for robot in robots]
        self._resistance = [robot.resistance() for robot in robots]
        self._periods = [robot.numerics.period for robot in robots]
        self._updates = np.array([robot.numerics.updates for robot in robots])
        self._most_updates = int(np.max(self._updates))
        self._throughout = np.array(
            [robot.config.hardware.envelope == "throughout" for robot in robots]
        )
        self._rows = None
        kinds = [
            (robot.numerics.steps // robot.numerics.updates, _layout(model))
            for robot, model in zip(robots, self.models, strict=True)
        ]
        self._batches: list[RobotBatch] = []
        self._kind, self._place = np.zeros((2, len(robots)), int)
        for kind in dict.fromkeys(kinds):
            members = [i for i, its in enumerate(kinds) if its == kind]
            self._kind[members] = len(self._batches)
            self._place[members] = np.arange(len(members))
            models = [self.models[i] for i in members]
            self._batches.append(RobotBatch(np.array(members), models, kind[0]))
        self._data: list[mujoco.MjData] = []
        self._everyone = np.arange(len(robots))
        self._mobility = np.zeros((len(robots), conventions.NUM_MOTORS))
        self.foot_force = np.zeros((len(robots), 4, 3))

    def __len__(self) -> int:
        """Number of robots."""
        return len(self.models)

    @property
    def qpos(self) -> Float[np.ndarray, "N nq"]:
        """The robots' positions now."""
        return self._now("qpos")

    @property
    def qvel(self) -> Float[np.ndarray, "N nv"]:
        """The robots' velocities now."""
        return self._now("qvel")

    @property
    def torque(self) -> Float[np.ndarray, "N 12"]:
        """The torques applied last, Nm."""
        return self._now("ctrl")

    @property
    def warmstart(self) -> Float[np.ndarray, "N nv"]:
        """The accelerations from which the solver begins the robots' next step."""
        return self._now("warmstart")

    def _now(self, name: str) -> Float[np.ndarray, "N _"]:
        """Return a part of all robots' states, which a step may change: copy to keep."""
        parts = [getattr(batch, name) for batch in self._batches]
        if not parts[1:]:
            return parts[0]
        values = np.empty((len(self), parts[0].shape[1]))
        for batch, part in zip(self._batches, parts, strict=True):
            values[batch.robots] = part
        return values

    def mass(self, robot: int) -> float:
        """Return a robot's mass, kg."""
        return float(np.sum(self.models[robot].body_mass))

    @property
    def data(self) -> list[mujoco.MjData]:
        """Each robot's state in MuJoCo, up to date from the first call on, which takes
        time; call `read` after a change."""
        if not self._data:
            self._data = [mujoco.MjData(model) for model in self.models]
            self._update_data(self._everyone)
        return self._data

    def _update_data(self, robots: Int[np.ndarray, " M"]) -> None:
        for robot in robots.tolist() if self._data else ():
            batch = self._batches[self._kind[robot]].batch
            batch.get_data(int(self._place[robot]), self._data[robot])
            self._data[robot].sensordata[:] = self.foot_force[robot].ravel()

    def read(self, robot: int) -> None:
        """Update a robot's state in the simulator after a change of its `data` from
        outside."""
        row = self._row("state", robot)
        mujoco.mj_getState(self.models[robot], self.data[robot], row, STATE)

    def _row(self, name: str, robot: int) -> Float[np.ndarray, " _"]:
        """Return a view of a part of a robot's state; writing to the view changes the
        state."""
        return getattr(self._batches[self._kind[robot]], name)[self._place[robot]]

    def state(self, robot: int) -> Float[np.ndarray, " S"]:
        """Return the full integration state of a robot, in MuJoCo's order."""
        return self._row("state", robot).copy()

    def set_state(self, robot: int, state: Float[np.ndarray, " S"]) -> None:
        """Set a robot to a state returned by `state`."""
        self._row("state", robot)[:] = state
        self.foot_force[robot] = 0.0  # no step has been taken from here
        self._update_data(np.array([robot]))

    def begin(
        self,
        qpos: Float[np.ndarray, "N nq"],
        qvel: Float[np.ndarray, "N nv"],
        torque: Float[np.ndarray, "N 12"],
        warmstart: Float[np.ndarray, "N nv"],
    ) -> None:
        """Put all robots into these states."""
        for batch in self._batches:
            its = batch.robots
            batch.qpos[:], batch.qvel[:] = qpos[its], qvel[its]
            batch.ctrl[:], batch.warmstart[:] = torque[its], warmstart[its]

    def set_motors(self, robot: int, motors: Actuator) -> None:
        """Give a robot other motors from the next millisecond on."""
        self.motors[robot] = motors
        self._rows = None

    def push(self, robot: int, push: Push) -> None:
        """Push a robot: its velocity jumps."""
        at, moving = self._row("qpos", robot), self._row("qvel", robot)
        shove(at, moving, push.forward, push.left, push.turn)

    def settle(self) -> None:
        """Let all robots stand under the joint PD loop until they are at rest, then
        move them to the origin.

        The robots' sway is damped meanwhile.
        """
        stand = joint_positions(self.qpos).copy()
        still = np.zeros_like(stand)
        for _ in range(round(SETTLING_TIME / DT)):
            self.millisecond(stand, still)
            for batch in self._batches:
                batch.qvel *= 1.0 - SETTLING_DAMPING * DT
        for batch in self._batches:
            batch.qpos[:, :2] = 0.0
            batch.qvel[:] = 0.0
            batch.batch.time = 0.0

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
        torque = self.torque.copy()
        for update in range(1, self._most_updates):
            self._update(position, velocity, robots[self._updates[robots] > update])
        self._update_data(robots)
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
        before, qpos, qvel = self.torque.copy(), self.qpos.copy(), self.qvel.copy()
        forces = laws.apply(
            laws.forces, self._rows, before, qpos, qvel, position, velocity
        )
        tried = robots[self._throughout[robots]]
        starts = [batch.state.copy() for batch in self._batches] if len(tried) else []
        self._step(robots, forces)
        for trial in range(TRIALS if len(tried) else 0):
            # of the step's start, which all trials share
            for batch, at, its in self._by_batch(tried) if trial == 0 else ():
                self._mobility[its] = self._mobilities(batch, at, its)
            again = laws.apply(
                laws.correct,
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
            for batch, at, _ in self._by_batch(tried):
                batch.state[at] = starts[self._batches.index(batch)][at]
            self._step(tried, forces)

    def _step(
        self, robots: Int[np.ndarray, " M"], forces: Float[np.ndarray, "N _"]
    ) -> None:
        for batch, at, its in self._by_batch(robots):
            batch.ctrl[at] = forces[its, :12]
            batch.qfrc_applied[at] = forces[its, 12:]
            self.foot_force[its] = self._advance(batch, at, its).reshape(-1, 4, 3)

    def _by_batch(
        self, robots: Int[np.ndarray, " M"]
    ) -> Iterator[tuple[RobotBatch, Int[np.ndarray, " K"], Int[np.ndarray, " K"]]]:
        """Yield these robots batch by batch: the batch, their places in it, and their
        indices."""
        for kind, batch in enumerate(self._batches):
            its = robots[self._kind[robots] == kind] if self._batches[1:] else robots
            if len(its):
                yield batch, self._place[its], its

    def _advance(
        self,
        batch: RobotBatch,
        at: Int[np.ndarray, " K"],
        robots: Int[np.ndarray, " K"],
    ) -> Float[np.ndarray, "K _"]:
        """Take the physics steps of a torque update of a batch's robots, whose `state`
        then is the new one; return the forces on their feet, N."""
        # MuJoCo's batch checks indices for longer than it steps a robot
        batch.batch.step(at if len(at) < len(batch.state) else None, batch.steps)
        return batch.sensed[at]

    def _mobilities(
        self,
        batch: RobotBatch,
        at: Int[np.ndarray, " K"],
        robots: Int[np.ndarray, " K"],
    ) -> Float[np.ndarray, "K 12"]:
        """Return each joint's acceleration per unit torque at the start of the last
        step of a batch's robots, rad/s2/Nm."""
        unit = _unit(self.models[0].nv)
        return batch.solve(at, unit)[:, unit > 0.0]


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
                request.config,
                World(dataclasses.replace(request.world.terrain, seed=0)),
            ),
            SETTLING_TIME,
        )
        for request in robots
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


def _layout(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the sizes of a model; MuJoCo's data of two models with the same sizes have
    one layout."""
    sizes = (getattr(model, name) for name in dir(model) if name.startswith("n"))
    return tuple(size for size in sizes if isinstance(size, int))


def _set_models(batch: Batch, models: Sequence[mujoco.MjModel]) -> None:
    """Let a batch simulate these models: one model with the values in which they
    differ, where it can be, as whole models crowd each other out of a processor's
    cache."""
    first = models[0]
    names = [
        name for name in dir(first) if isinstance(getattr(first, name), np.ndarray)
    ]
    names += [f"opt.{name}" for name in dir(first.opt) if name[0] != "_"]
    read = {name: operator.attrgetter(name) for name in names}
    differ = [
        name
        for name, value in read.items()
        if any(not np.array_equal(value(first), value(model)) for model in models[1:])
    ]
    if differ and MODEL_FIELDS.issuperset(differ):
        for name in differ:
            batch.expand(name)[:] = [read[name](model) for model in models]
    else:
        batch.set_models(models)
