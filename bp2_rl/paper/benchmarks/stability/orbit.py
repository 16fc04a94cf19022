"""A policy's gait as a map of the closed loop's state from one stride to the next.

The map takes a vector at the clock's phase 0 to the vector a cycle later.

Left out of the vector is what the loop does not depend on: place and, without an
operator, heading. In are the body (height, roll, pitch, joints, springs, and all
velocities, in the frame of the heading), and everything that remembers: the last action
with the target that it made, older targets on their way to the joints, the current
loop's torque, the operator's command. Angles of the trunk are those of yaw, then pitch,
then roll.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from bp2_rl.paper.benchmarks.stability.group import GroupState, RobotGroup
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.rollout import SIDE_BY_SIDE

BODY = 41  # height, roll, pitch, 16 joints; 3 + 3 + 16 velocities
STEERED = 3  # offset, heading, the operator's yaw rate
TICK = conventions.CONTROL_STEP
# m/s, by which a command may be lower to have a stride of whole control steps
REACH = 2.0
GRID = 0.05  # m/s, the slowest command that is looked at
POINTS = 81  # commands that are looked at, and then between two of them


def whole_strides(
    phase_rate: Callable[[Array], Array], speed: float
) -> tuple[float, int] | None:
    """Find the commanded speed nearest to `speed` whose stride has whole control steps.

    Returns the command, m/s, and the number of control steps.

    `phase_rate` is the clock's: cycles a second under a command (3). Only then is the
    closed loop periodic. None where there is none within `REACH`, as for a clock that
    stands still.
    """

    @jax.jit
    def ticks(commands: Array) -> Array:
        return 1.0 / (
            TICK
            * jax.vmap(phase_rate)(jnp.zeros((len(commands), 3)).at[:, 0].set(commands))
        )

    def found(commands: Float[np.ndarray, " N"]) -> list[tuple[float, float, int]]:
        """Return pairs of commands with a stride of whole control steps in between."""
        counts = np.asarray(ticks(jnp.asarray(commands, jnp.float32)), np.float64)
        ends = zip(
            itertools.pairwise(commands.tolist()),
            itertools.pairwise(counts.tolist()),
            strict=True,
        )
        return [
            (low, high, wanted)
            for (low, high), (first, last) in ends
            if first != last and math.isfinite(first) and math.isfinite(last)
            for wanted in range(
                math.ceil(min(first, last)), math.floor(max(first, last)) + 1
            )
        ]

    low, high, wanted = min(
        found(np.linspace(max(speed - REACH, GRID), speed + REACH, POINTS)),
        key=lambda one: abs(one[0] - speed),
        default=(0.0, 0.0, 0),
    )
    if wanted == 0:
        return None
    finer = [one for one in found(np.linspace(low, high, POINTS)) if one[2] == wanted]
    return (0.5 * (finer[0][0] + finer[0][1]) if finer else 0.5 * (low + high)), wanted


@dataclasses.dataclass(frozen=True)
class Coordinates:
    """Coordinates of the closed loop's state vector at one instant.

    Args:
        steered: an operator keeps the robot on its line.
        torque: the last torque matters, to a lag of the current or to a bus.
        older: how many targets are on their way besides the last.
        scale: rad, by which a unit of action moves a target.
    """

    steered: bool
    torque: bool
    older: int
    scale: float

    @classmethod
    def of(
        cls, config: EnvConfig, hardware: HardwareSpec, memory: int, steered: bool
    ) -> "Coordinates":
        """Return the state coordinates of a loop whose latency spans `memory` control
        steps."""
        losses = hardware.losses
        limited = min(losses.bus_power_out, losses.bus_power_in) < 1e9
        has_bus = limited or losses.bus_sag > 0.0
        is_slow = losses.current_lag > 0.0 or math.isfinite(config.control.torque_rate)
        return cls(
            steered, has_bus or is_slow, max(memory - 1, 0), config.control.action_scale
        )

    @property
    def size(self) -> int:
        """Length of the state vector."""
        return BODY + 12 + 12 * self.torque + 12 * self.older + STEERED * self.steered

    def read(self, moment: GroupState) -> Float[np.ndarray, "N D"]:
        """Return the state vectors of a group of robots."""
        yaw, pitch, roll = angles_of(moment.qpos[:, 3:7])
        cos, sin = np.cos(yaw), np.sin(yaw)
        vx, vy = moment.qvel[:, 0], moment.qvel[:, 1]
        parts = [
            np.stack([moment.qpos[:, 2], roll, pitch], axis=-1),
            moment.qpos[:, 7:],
            np.stack([cos * vx + sin * vy, cos * vy - sin * vx], axis=-1),
            moment.qvel[:, 2:],
            moment.action,
        ]
        if self.torque:
            parts.append(moment.torque)
        if self.older:
            parts.append(moment.position[:, :-1].reshape(len(moment), -1))
        if self.steered:
            parts.append(
                np.stack([moment.qpos[:, 1], yaw, moment.command[:, 2]], axis=-1)
            )
        return np.concatenate(parts, axis=-1)

    def write(self, vectors: Float[np.ndarray, "N D"], base: GroupState) -> GroupState:
        """Return robots at x = 0 with the given state vectors, and all else as in
        `base`."""
        count = len(vectors)
        ends = np.cumsum([3, 16, 2, 20, 12, 12 * self.torque, 12 * self.older])
        trunk, joints, level, rates, action, torque, older, steered = np.split(
            vectors, ends, axis=1
        )
        moment = base.of(np.zeros(count, int))
        yaw = steered[:, 1] if self.steered else np.zeros(count)
        qpos, qvel, position = moment.qpos, moment.qvel, moment.position
        qpos[:, 0] = 0.0
        qpos[:, 1] = steered[:, 0] if self.steered else 0.0
        qpos[:, 2] = trunk[:, 0]
        qpos[:, 7:] = joints
        qpos[:, 3:7] = quaternion_of(yaw, trunk[:, 2], trunk[:, 1])
        cos, sin = np.cos(yaw), np.sin(yaw)
        qvel[:, 0] = cos * level[:, 0] - sin * level[:, 1]
        qvel[:, 1] = sin * level[:, 0] + cos * level[:, 1]
        qvel[:, 2:] = rates
        if position.shape[1]:
            position[:, -1] += self.scale * (action - base.action)
            position[:, :-1] = older.reshape(count, -1, 12)
        command = moment.command
        if self.steered:
            command[:, 2] = steered[:, 2]
        return dataclasses.replace(
            moment,
            action=action,
            torque=torque if self.torque else moment.torque,
            command=command,
        )


def angles_of(quaternion: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "3 N"]:
    """Return yaw, pitch and roll of w-x-y-z quaternions, rad."""
    return Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_euler("ZYX").T


def quaternion_of(
    yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray
) -> Float[np.ndarray, "N 4"]:
    """Return the w-x-y-z quaternions of these angles, rad."""
    turn = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1))
    return turn.as_quat()[:, [3, 0, 1, 2]]


@dataclasses.dataclass(frozen=True)
class Orbit:
    """A policy's gait as a return map, from one phase 0 of the gait clock to the
    next."""

    group: RobotGroup  # without noise
    coordinates: Coordinates
    commands: Float[np.ndarray, "K 3"]  # of a stride
    base: GroupState  # one robot at phase 0; says all that coordinates leave out

    @property
    def at(self) -> Float[np.ndarray, " D"]:
        """State vector of the robot in `base`."""
        return self.coordinates.read(self.base)[0]

    def follow(
        self, states: Float[np.ndarray, "N D"], strides: int
    ) -> Float[np.ndarray, "S N D"]:
        """Return the state vectors at the start and after each stride; NaN after a
        fall."""
        chunks = (
            states[first : first + SIDE_BY_SIDE]
            for first in range(0, len(states), SIDE_BY_SIDE)
        )
        return np.concatenate(
            [self._follow(chunk, strides) for chunk in chunks], axis=1
        )

    def _follow(
        self, states: Float[np.ndarray, "N D"], strides: int
    ) -> Float[np.ndarray, "S N D"]:
        moment = self.coordinates.write(states, self.base)
        fallen = np.zeros(len(states), bool)
        passed = [states]
        commands = np.repeat(self.commands[:, None], len(states), axis=1)
        for _ in range(strides):
            moment, fell, _ = self.group.run(moment, commands)
            fallen |= fell
            reached = self.coordinates.read(moment)
            passed.append(np.where(fallen[:, None], np.nan, reached))
        return np.stack(passed)
