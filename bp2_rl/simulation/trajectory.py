"""The trajectory of a run: its samples at each physics step, its file, and the time
windows that are measured."""

import dataclasses
import functools
import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import ArraySpec, parse_json, read_bytes, read_npz, write_npz
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.robot.coordinates import (
    compression_rates,
    compressions,
    joint_positions,
    joint_velocities,
)
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.metrics import RunMetrics

FORMAT = "bp2_rl.trajectory/1"


class TrajectoryError(UserError):
    """A file is missing, or holds no valid trajectory."""


def shapes_of(hardware: HardwareSpec) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a trajectory's arrays at a single sample, by name, for a
    robot."""
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunFacts:
    """The facts of a run, beside its samples, that its figures of merit need."""

    dt: float  # s
    # s, when the schedule holds its last command; may lie after the end of a run that
    # fell
    steady_from: float
    fell_at: float | None  # s
    mass: float  # kg, of the robot that ran
    hardware: HardwareSpec
    name: str  # what ran, for titles
    backend: str  # the simulator, for titles
    terrain: Terrain = Terrain()


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Trajectory(RunFacts):
    """The samples of a run at its physics steps, with their figures of merit.

    Sample k is the state at `time[k]`, with the torque, the target and the command that
    acted from there to the next sample and the ground's forces under that torque. A run
    ends with the last sample before a fall. Legs are FR, FL, RR, RL; motors abad, hip,
    knee of each; where shanks have springs, a leg's spring follows its knee in `qpos`.
    """

    time: Float[np.ndarray, " N"]  # s, from 0 at the start of the command schedule
    # trunk position (m, world) and quaternion, then 4 x (3 joints rad, any spring m)
    qpos: Float[np.ndarray, "N nq"]
    # trunk velocity (m/s, world) and rate (rad/s, body), then as `qpos`
    qvel: Float[np.ndarray, "N nv"]
    torque: Float[np.ndarray, "N 12"]  # Nm, applied at the joints
    target: Float[np.ndarray, "N 12"]  # rad, the policy's joint targets
    # m/s forward, m/s to the left, rad/s yaw, as the policy was told
    command: Float[np.ndarray, "N 3"]
    foot_force: Float[np.ndarray, "N 4 3"]  # N, world, from the ground on the robot

    def __post_init__(self) -> None:
        """Raise ValueError for arrays of wrong shapes or with fewer than two
        samples."""
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
        """Trunk velocity forward and to the left in the frame of its heading, m/s, as
        commands are given."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        vx, vy = self.qvel[:, 0], self.qvel[:, 1]
        return np.stack((cos * vx + sin * vy, cos * vy - sin * vx), axis=-1)

    @property
    def mean_speed(self) -> float:
        """Mean forward speed in the heading frame, m/s."""
        return float(np.mean(self.ground_velocity[:, 0]))

    def between(self, start: float, stop: float) -> "Trajectory":
        """Return the part of the run with start <= time < stop (s); `fell_at` is kept
        if it lies inside."""
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

    def __repr__(self) -> str:
        """Describe the run by its name, length and end, without the arrays."""
        end = "upright" if self.fell_at is None else f"fell at {self.fell_at:.2f} s"
        return f"Trajectory({self.name}, {self.time[-1]:.2f} s, {end})"

    @functools.cached_property
    def metrics(self) -> RunMetrics:
        """All figures of merit of the run, computed when they are first asked for."""
        from bp2_rl.simulation.measuring import run_metrics  # measures trajectories

        return run_metrics(self)

    def save(self, path: Path | str) -> None:
        """Write the trajectory to one .npz file without pickles; a failed write leaves
        no partial file."""
        facts = RunFacts(
            **{
                field.name: getattr(self, field.name)
                for field in dataclasses.fields(RunFacts)
            }
        )
        arrays = {field: getattr(self, field) for field in shapes_of(self.hardware)}
        write_npz(
            path,
            {
                "format": np.array(FORMAT),
                "facts": np.array(json.dumps(to_json(facts))),
                **arrays,
            },
        )

    @classmethod
    def load(cls, path: Path | str) -> "Trajectory":
        """Read a trajectory that `save` wrote; raise TrajectoryError for any other
        file."""
        if not Path(path).exists():
            raise TrajectoryError(f"no trajectory at {path}")
        try:
            content = read_bytes(path)
            text = ArraySpec(np.str_, ())
            header = read_npz(
                path,
                {"format": text, "facts": text},
                content=content,
                largest=len(content),
            )
            if str(header["format"]) != FORMAT:
                raise TrajectoryError(
                    f"{path} is of format {header['format']}, this version reads {FORMAT}"
                )
            facts = from_json(RunFacts, parse_json(str(header["facts"]), "facts"))
            specs = {
                field: ArraySpec(np.floating, ("N", *shape))
                for field, shape in shapes_of(facts.hardware).items()
            }
            arrays = read_npz(path, specs, content=content, largest=len(content))
            return cls(**arrays, **vars(facts))
        except TrajectoryError:
            raise
        except (
            ValueError
        ) as error:  # whatever is wrong with files, their arrays and their facts
            raise TrajectoryError(
                f"{path} is no trajectory, or not a whole one ({error})"
            ) from None


class BestWindow(NamedTuple):
    """The window of a run with the highest mean speed."""

    start: float  # s
    speed: float  # m/s, its mean


def window_means(
    values: Float[np.ndarray, " N"], samples: int
) -> Float[np.ndarray, " M"]:
    """Return the mean of every window of `samples` values, indexed by the window's
    first sample."""
    sums = np.concatenate(([0.0], np.cumsum(values, dtype=np.float64)))
    return (sums[samples:] - sums[:-samples]) / samples


def best_window(run: Trajectory, length: float) -> BestWindow | None:
    """Return the window of `length` seconds with the highest mean forward speed; None
    where the run is shorter."""
    samples = round(length / run.dt)
    if len(run) < samples:
        return None
    means = window_means(run.ground_velocity[:, 0], samples)
    start = int(np.argmax(means))
    return BestWindow(start=float(run.time[start]), speed=float(means[start]))


def hold_phase(run: Trajectory) -> Trajectory | None:
    """Return the part of a run under the schedule's last command; None if shorter than
    a second."""
    held = len(run) * run.dt - run.steady_from
    return (
        run.between(run.steady_from, math.inf) if held >= 1.0 - 0.5 * run.dt else None
    )


def steady_window(run: Trajectory) -> Trajectory:
    """Return the part of a run that represents steady running: the hold phase, else the
    fastest second, else the whole run."""
    hold = hold_phase(run)
    best = best_window(run, 1.0)
    if hold is not None:
        return hold
    return run.between(best.start, best.start + 1.0) if best is not None else run
