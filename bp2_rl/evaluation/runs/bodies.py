"""Robots in MuJoCo, millisecond by millisecond, side by side: as `SwiftMachine`, for as many as there are."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Int

from bp2_rl.evaluation.runs.machine import OUTSIDE, STATE, TRIALS, Laws, LawsOfEach, mobility
from bp2_rl.robot import specs


class Bodies:
    """Robots whose laws are computed for all of them at once; MuJoCo takes its steps one by one.

    Args:
        models: each robot's.
        data: each robot's state, from which it goes on.
        torque: Nm, that their motors gave last.
        laws: of all of them, for the time between two computations of the motors' torques.
        throughout: whether their torques keep to the envelope at the end of that time, too.
        steps: of physics in that time.
    """

    def __init__(
        self,
        models: Sequence[mujoco.MjModel],
        data: Sequence[mujoco.MjData],
        torque: Float[np.ndarray, "N 12"],
        laws: Laws | LawsOfEach,
        *,
        throughout: bool,
        steps: int = 1,
    ):
        self.models, self.data, self.torque = models, data, torque
        self.qpos, self.qvel = np.stack([one.qpos for one in data]), np.stack([one.qvel for one in data])
        self.laws, self._trials, self._steps = laws, TRIALS if throughout else 0, steps
        self._start = np.empty((len(data), mujoco.mj_stateSize(models[0], STATE)))
        self._mobility = np.zeros((len(data), specs.NUM_MOTORS))

    def advance(
        self,
        position: Float[np.ndarray, "N 12"],
        velocity: Float[np.ndarray, "N 12"],
        robots: Int[np.ndarray, " M"],
    ) -> None:
        """Motors and physics of these robots, as `SwiftMachine.step`; the others stay as they are."""
        before, qpos, qvel = self.torque, self.qpos.copy(), self.qvel.copy()
        forces = self.laws.ask(before, qpos, qvel, position, velocity)
        for robot in robots if self._trials else ():
            mujoco.mj_getState(self.models[robot], self.data[robot], self._start[robot], STATE)
        tried = robots
        for _ in range(self._trials):
            self._step(tried, forces)
            for robot in tried:
                self._mobility[robot] = mobility(self.models[robot], self.data[robot])
            again = self.laws.correct(forces[:, :12], before, qpos, qvel, self.qvel, self._mobility)
            tried = tried[again[tried, -1] > OUTSIDE]
            if not len(tried):
                break
            forces = forces.copy()
            forces[tried] = again[tried, :-1]
            for robot in tried:
                mujoco.mj_setState(self.models[robot], self.data[robot], self._start[robot], STATE)
        self._step(tried, forces)
        self.torque = forces[:, :12]

    def _step(self, robots: Any, forces: Float[np.ndarray, "N 34"]) -> None:
        for robot in robots:
            one = self.data[robot]
            one.ctrl[:], one.qfrc_applied[:] = forces[robot, :12], forces[robot, 12:]
            mujoco.mj_step(self.models[robot], one, nstep=self._steps)
            self.qpos[robot], self.qvel[robot] = one.qpos, one.qvel
