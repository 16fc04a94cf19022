"""The samples of a run, one a physics step, and the windows that are measured."""

import dataclasses
import math
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from bp2_rl.robot.coordinates import (
    compression_rates,
    compressions,
    joint_positions,
    joint_velocities,
)
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import yaw_of

Run = TypeVar("Run", bound="Samples")


def shapes_of(hardware: HardwareSpec) -> dict[str, tuple[int, ...]]:
    """Return the shapes of one sample, by array, for a robot."""
    nq = hardware.anatomy.nq
    return {
        "time": (),
        "qpos": (nq,),
        "qvel": (nq - 1,),
        "torque": (12,),
        "target": (12,),
        "command": (3,),
        "foot_force": (4, 3),
    }


@dataclasses.dataclass(frozen=True)
class Samples:
    """The samples of one run, and the facts that its measures need.

    Sample k is the state at `time[k]`, with the torque, the target and the command that
    acted from there to the next sample and the ground's forces under that torque. A run
    ends with the last sample before a fall. Legs are FR, FL, RR, RL; motors abad, hip,
    knee of each; a leg's four joints in `qpos` end with its spring.
    """

    time: Float[np.ndarray, " N"]  # s, from 0 at the start of the command schedule
    # trunk position (m, world) and quaternion, then 4 x (3 joints rad, spring m)
    qpos: Float[np.ndarray, "N nq"]
    # trunk velocity (m/s, world) and rate (rad/s, body), then 4 x (3 rad/s, m/s)
    qvel: Float[np.ndarray, "N nv"]
    torque: Float[np.ndarray, "N 12"]  # Nm, applied at the joints
    target: Float[np.ndarray, "N 12"]  # rad, the policy's joint targets
    # m/s forward, m/s to the left, rad/s yaw, as the policy was told
    command: Float[np.ndarray, "N 3"]
    foot_force: Float[np.ndarray, "N 4 3"]  # N, world, from the ground on the robot
    dt: float  # s
    # s, when the schedule holds its last command; may lie after the end of a run that
    # fell
    steady_from: float
    fell_at: float | None  # s
    mass: float  # kg, of the robot that ran
    hardware: HardwareSpec
    name: str  # what ran, for titles
    backend: str  # the simulator, for titles

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together."""
        for field, shape in shapes_of(self.hardware).items():
            expected = (len(self.time), *shape)
            if getattr(self, field).shape != expected:
                raise ValueError(
                    f"trajectory.{field} has shape {getattr(self, field).shape}, expected {expected}"
                )
        if len(self.time) < 2:
            raise ValueError("a trajectory needs at least two samples")

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def joint_position(self) -> Float[np.ndarray, "N 12"]:
        """Motor angles, rad."""
        return joint_positions(self.qpos)

    @property
    def joint_velocity(self) -> Float[np.ndarray, "N 12"]:
        """Motor speeds at the joint, rad/s."""
        return joint_velocities(self.qvel)

    @property
    def spring_compression(self) -> Float[np.ndarray, "N 4"]:
        """How far each leg's spring is pressed in, m."""
        return compressions(self.qpos)

    @property
    def spring_velocity(self) -> Float[np.ndarray, "N 4"]:
        """How fast each leg's spring is pressed in, m/s."""
        return compression_rates(self.qvel)

    @property
    def heading(self) -> Float[np.ndarray, " N"]:
        """Yaw, rad, without jumps: where the trunk's x axis points on the ground."""
        return np.unwrap(yaw_of(self.qpos[:, 3:7]))

    @property
    def ground_velocity(self) -> Float[np.ndarray, "N 2"]:
        """Trunk velocity forward and to the left of its heading, m/s: what the command
        commands."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        vx, vy = self.qvel[:, 0], self.qvel[:, 1]
        return np.stack((cos * vx + sin * vy, cos * vy - sin * vx), axis=-1)

    def between(self: Run, start: float, stop: float) -> Run:
        """Return the samples with start <= time < stop (s); `fell_at` is kept only if
        it lies inside."""
        inside = slice(
            *np.searchsorted(self.time, (start - 0.5 * self.dt, stop - 0.5 * self.dt))
        )
        fell = (
            self.fell_at
            if self.fell_at is not None and start <= self.fell_at <= stop
            else None
        )
        samples = {
            field: getattr(self, field)[inside] for field in shapes_of(self.hardware)
        }
        return dataclasses.replace(self, fell_at=fell, **samples)


class BestWindow(NamedTuple):
    """The fastest stretch of a run."""

    start: float  # s
    speed: float  # m/s, its mean


def window_means(
    values: Float[np.ndarray, " N"], samples: int
) -> Float[np.ndarray, " M"]:
    """Return the means over every window of `samples` values, by its first sample."""
    sums = np.concatenate(([0.0], np.cumsum(values, dtype=np.float64)))
    return (sums[samples:] - sums[:-samples]) / samples


def best_window(run: Samples, length: float) -> BestWindow | None:
    """Return the window of `length` seconds with the highest mean forward speed; None
    where the run is shorter."""
    samples = round(length / run.dt)
    if len(run) < samples:
        return None
    means = window_means(run.ground_velocity[:, 0], samples)
    start = int(np.argmax(means))
    return BestWindow(start=float(run.time[start]), speed=float(means[start]))


def hold_phase(run: Run) -> Run | None:
    """Return the part under the schedule's last command, if it lasted for at least a
    second."""
    held = len(run) * run.dt - run.steady_from
    return (
        run.between(run.steady_from, math.inf) if held >= 1.0 - 0.5 * run.dt else None
    )


def steady_window(run: Run) -> Run:
    """Return the part that stands for steady running: the hold phase, or else the best
    second, or else all."""
    hold, best = hold_phase(run), best_window(run, 1.0)
    if hold is not None:
        return hold
    return run.between(best.start, best.start + 1.0) if best is not None else run
