"""Robots in MuJoCo, millisecond by millisecond, side by side: as `Machine`, for as many as there are."""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float, Int

from bp2_rl.robot import specs
from bp2_rl.robot.actuator import Actuator
from bp2_rl.simulation import laws
from bp2_rl.simulation.machine import JUDGE, OUTSIDE, STATE, TRIALS, Machine, Numerics, mobility


class Bodies:
    """Robots whose laws are computed for all of them at once; MuJoCo takes its steps one by one.

    Compiled laws round otherwise than NumPy's, so two runs agree as those do that begin a hair's breadth apart.

    Args:
        models: each robot's.
        data: each robot's state, from which it goes on, and which moves with it.
        motors: each robot's row of numbers, `laws.row_of`, for the time between two computations of its torques.
        throughout: whether its torques keep to the envelope at the end of that time, too.
        numerics: how each is computed, as its model has been told.
    """

    def __init__(
        self,
        models: Sequence[mujoco.MjModel],
        data: Sequence[mujoco.MjData],
        motors: Sequence[laws.Row],
        *,
        throughout: Sequence[bool],
        numerics: Sequence[Numerics],
    ):
        self.qpos, self.qvel = np.stack([one.qpos for one in data]), np.stack([one.qvel for one in data])
        self.torque = np.stack([one.ctrl for one in data])
        self.data, self._models, self._motors = data, models, list(motors)
        self._rows = None
        self._throughout, self._all_throughout = np.array(throughout), all(throughout)
        self._updates = np.array([how.updates for how in numerics])
        self._most_updates = int(np.max(self._updates))
        self._steps = [how.steps // how.updates for how in numerics]
        # To look these up anew would take longer than to write them.
        self._inputs = [(one.ctrl, one.qfrc_applied) for one in data]
        self._outputs = [(one.qpos, one.qvel) for one in data]
        self._start = np.empty((len(data), mujoco.mj_stateSize(models[0], STATE)))
        self._mobility = np.zeros((len(data), specs.NUM_MOTORS))

    @classmethod
    def of(cls, machines: Sequence[Machine], numerics: Sequence[Numerics] = ()) -> "Bodies":
        """Make `Bodies` of machines; without `numerics` they are computed with the verifier's settings."""
        hows = numerics or [JUDGE] * len(machines)
        motors = [laws.row_of(one.motors, one.resistance, how.period) for one, how in zip(machines, hows, strict=True)]
        models, data = [one.model for one in machines], [one.data for one in machines]
        return cls(models, data, motors, throughout=[one.throughout for one in machines], numerics=hows)

    def look(self, robot: int) -> None:
        """Read the state of a robot again after it was changed from outside."""
        self.qpos[robot], self.qvel[robot] = self._outputs[robot]

    def renew(self, robot: int, motors: laws.Row) -> None:
        """From now on a robot has these motors."""
        self._motors[robot], self._rows = motors, None

    def millisecond(
        self,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        robots: Int[np.ndarray, " M"],
    ) -> Float[np.ndarray, "N 12"]:
        """Motors and physics of these robots, as `Machine.millisecond`; the others stay as they are."""
        self._advance(position, velocity, robots)
        torque = self.torque.copy()
        for update in range(1, self._most_updates):
            self._advance(position, velocity, robots[self._updates[robots] > update])
        return torque

    def _advance(
        self,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        robots: Int[np.ndarray, " M"],
    ) -> None:
        """As `Machine._step`."""
        if not len(robots):
            return
        if self._rows is None:
            self._rows = laws.rows_of(self._motors)
        before, qpos, qvel = self.torque, self.qpos.copy(), self.qvel.copy()
        forces = laws.ask(self._rows, before, qpos, qvel, position, velocity)
        tried = robots if self._all_throughout else robots[self._throughout[robots]]
        for robot in tried.tolist():
            mujoco.mj_getState(self._models[robot], self.data[robot], self._start[robot], STATE)
        for trial in range(TRIALS if len(tried) else 0):
            self._step(tried, forces)
            for robot in tried.tolist() if trial == 0 else ():  # of the start, so the same in all trials
                self._mobility[robot] = mobility(self._models[robot], self.data[robot])
            again = laws.correct(self._rows, forces[:, :12], before, qpos, qvel, self.qvel, self._mobility)
            tried = tried[again[tried, -1] > OUTSIDE]
            if not len(tried):
                break
            forces = forces.copy()
            forces[tried] = again[tried, :-1]
            for robot in tried.tolist():
                mujoco.mj_setState(self._models[robot], self.data[robot], self._start[robot], STATE)
        self._step(tried, forces)
        if not self._all_throughout:
            self._step(robots[~self._throughout[robots]], forces)
        self.torque = before.copy()
        self.torque[robots] = forces[robots, :12]

    def _step(self, robots: Int[np.ndarray, " M"], forces: Float[np.ndarray, "N 34"]) -> None:
        for robot in robots.tolist():
            (torque, force), (qpos, qvel) = self._inputs[robot], self._outputs[robot]
            torque[:], force[:] = forces[robot, :12], forces[robot, 12:]
            mujoco.mj_step(self._models[robot], self.data[robot], nstep=self._steps[robot])
            self.qpos[robot], self.qvel[robot] = qpos, qvel


class SwiftMachine(Machine):
    """One robot twice as fast, for a judge in a hurry: the laws of motors and losses are compiled, as in `Bodies`."""

    _bodies: Bodies | None = None
    _made_for: tuple[Actuator, Numerics] | None = None

    def copy(self) -> "SwiftMachine":
        """As `Machine.copy`."""
        twin = super().copy()
        assert isinstance(twin, SwiftMachine)
        twin._bodies = None
        return twin

    def millisecond(
        self,
        q_target: Float[np.ndarray, "12"],
        qd_target: Float[np.ndarray, "12"],
        numerics: Numerics = JUDGE,
    ) -> Float[np.ndarray, "12"]:
        """As `Machine.millisecond`."""
        bodies, made_for = self._bodies, self._made_for
        if bodies is None or made_for is None or made_for[0] is not self.motors or made_for[1] != numerics:
            bodies = self._bodies = Bodies.of([self], [numerics])
            self._made_for = self.motors, numerics
        bodies.look(0)
        bodies.torque[0] = self.data.ctrl
        return bodies.millisecond(q_target[None], qd_target[None], _ALONE)[0]


_ALONE = np.zeros(1, int)
