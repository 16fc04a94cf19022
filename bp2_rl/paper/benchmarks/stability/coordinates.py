"""A robot's closed loop as a vector, on which its return map acts, and back.

Left out is what the loop does not depend on: place and, without an operator, heading.
In are the body (height, roll, pitch, joints, springs, and all velocities, in the frame
of the heading), and everything that remembers: the last action with the target that it
made, older targets on their way to the joints, the current loop's torque, the
operator's command. Angles of the trunk are those of yaw, then pitch, then roll.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.benchmarks.stability.group import GroupState
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig

BODY = 41  # height, roll, pitch, 16 joints; 3 + 3 + 16 velocities
STEERED = 3  # offset, heading, the operator's yaw rate
# m, rad, m/s, rad/s, Nm, actions: what counts as one for a coordinate that never moves
SMALLEST = 1e-6


@dataclasses.dataclass(frozen=True)
class Coordinates:
    """Which vector stands for a moment.

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
        """Return the coordinates of a policy on a robot whose latency spans `memory`
        control steps."""
        losses = hardware.losses
        has_bus = (
            losses.bus_power_out < 1e9
            or losses.bus_power_in < 1e9
            or losses.bus_sag > 0.0
        )
        remembers = (
            losses.current_lag > 0.0
            or has_bus
            or config.control.torque_rate < float("inf")
        )
        return cls(steered, remembers, max(memory - 1, 0), config.control.action_scale)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return BODY + 12 + 12 * self.torque + 12 * self.older + STEERED * self.steered

    def read(self, moment: GroupState) -> Float[np.ndarray, "N D"]:
        """Return the vectors of a group."""
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
        """Return a group in these states; the rest is as in `base`, a group of one, but
        at x = 0 and heading 0."""
        count = len(vectors)
        ends = np.cumsum([3, 16, 2, 20, 12, 12 * self.torque, 12 * self.older])
        trunk, joints, level, rates, action, torque, older, steered = np.split(
            vectors, ends, axis=1
        )
        moment = base.of(np.zeros(count, int))
        yaw = steered[:, 1] if self.steered else np.zeros(count)
        qpos, qvel, position = moment.qpos, moment.qvel, moment.position
        qpos[:, 0], qpos[:, 1] = 0.0, steered[:, 0] if self.steered else 0.0
        qpos[:, 2], qpos[:, 3:7], qpos[:, 7:] = (
            trunk[:, 0],
            quaternion_of(yaw, trunk[:, 2], trunk[:, 1]),
            joints,
        )
        cos, sin = np.cos(yaw), np.sin(yaw)
        qvel[:, 0], qvel[:, 1] = (
            cos * level[:, 0] - sin * level[:, 1],
            sin * level[:, 0] + cos * level[:, 1],
        )
        qvel[:, 2:] = rates
        if position.shape[1]:
            position[:, -1] += self.scale * (action - base.action)
            position[:, :-1] = older.reshape(count, -1, 12)
        command = moment.command
        if self.steered:
            command[:, 2] = steered[:, 2]
        return moment.replace(
            action=action,
            torque=torque if self.torque else moment.torque,
            command=command,
        )


def angles_of(
    quaternion: Float[np.ndarray, "N 4"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Yaw, pitch, roll of w-x-y-z quaternions, rad."""
    w, x, y, z = quaternion.T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return yaw, pitch, roll


def quaternion_of(
    yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray
) -> Float[np.ndarray, "N 4"]:
    """The w-x-y-z quaternions of these angles, rad."""
    (cy, sy), (cp, sp), (cr, sr) = (
        (np.cos(a / 2.0), np.sin(a / 2.0)) for a in (yaw, pitch, roll)
    )
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )
