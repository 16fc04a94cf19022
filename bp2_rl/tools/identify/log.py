"""Logs of a real robot: reading, checking and describing the recorded rows.

A log is an .npz or a .csv file with these columns, angles in rad, times in s:

    time               of each row
    q.JOINT            measured angle of each joint, by the joints' names
    q_target.JOINT     target of the joint's position loop, as it was applied
    qd.JOINT           optional: measured rate
    up.x, .y, .z       optional: the world's upward direction in the trunk's axes
    omega.x, .y, .z    optional: the trunk's angular velocity in its own axes, rad/s
    contact.LEG        optional: 1 while the foot of FR, FL, RR or RL may touch the ground

In an .npz file `q`, `q_target` and `qd` may also be arrays (rows, 12), with the names in
`joint_names`, and `up`, `omega` (rows, 3) and `contact` (rows, 4) arrays likewise. A
joint's name is the robot file's, whose sign and offset then apply, or one of bp2_rl's
own (FR_abad). Without `contact` the robot hangs: every leg is free, and the trunk rests.
"""

import csv
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.conventions import LEGS, MOTOR_NAMES

LARGEST_ANGLE = 4.0 * np.pi
"""rad; a larger angle means that the log is in degrees."""
LEAST_ROWS = 100
GAP = 1.5
"""Times the usual time between rows: a longer one means that rows were lost."""
Columns = Mapping[str, Float[np.ndarray, " rows"]]


@dataclasses.dataclass(frozen=True)
class Log:
    """Rows of a log, in the order, axes and signs of bp2_rl's joints."""

    time: Float[np.ndarray, " rows"]  # s
    q: Float[np.ndarray, "rows 12"]  # rad
    q_target: Float[np.ndarray, "rows 12"]  # rad
    qd: Float[np.ndarray, "rows 12"] | None  # rad/s
    up: Float[np.ndarray, "rows 3"]  # the world's z in the trunk's axes
    omega: Float[np.ndarray, "rows 3"]  # rad/s, of the trunk, in its axes
    airborne: Bool[np.ndarray, "rows 4"]  # whether a leg's foot is free
    hanging: bool

    @property
    def step(self) -> float:
        """Usual time between two rows, s."""
        return float(np.median(np.diff(self.time)))

    def between(self, first: int, last: int) -> "Log":
        """Return the rows from `first` up to `last`."""
        arrays = {
            field.name: value[first:last]
            for field in dataclasses.fields(self)
            if isinstance(value := getattr(self, field.name), np.ndarray)
        }
        return dataclasses.replace(self, **arrays)

    @property
    def whole(self) -> Bool[np.ndarray, " rows"]:
        """Whether no row was lost between each row and the next one."""
        return np.append(np.diff(self.time) < GAP * self.step, False)


@dataclasses.dataclass(frozen=True)
class LogQuality:
    """Properties of a log's recording, whatever the robot did."""

    rows: int = metric("Rows", form="d", meaning="of the log")
    step: float = metric("Time between rows", "ms", ".3f", "median")
    jitter: float = metric("Jitter", "ms", ".3f", "standard deviation of that time")
    lost: int = metric("Lost rows", form="d", meaning="by gaps in time")
    quantum: float = metric(
        "Encoder quantum", "mrad", ".3f", "least change of an angle"
    )
    rate_delay: float | None = metric(
        "Delay of qd", "ms", ".1f", "behind the derivative of q", default=None
    )
    rate_gain: float | None = metric(
        "Gain of qd", "", ".2f", "over the derivative of q", default=None
    )


def read_log(path: Path, anatomy: Anatomy) -> Log:
    """Read a log of a robot.

    Raises:
        UserError: the file is no log, a column is missing, named wrongly or impossible.
    """
    columns = _columns(path)
    if "time" not in columns:
        raise UserError(f"{path}: no column `time`; it has {_listed(columns)}")
    time = columns["time"]
    if len(time) < LEAST_ROWS:
        raise UserError(f"{path}: {len(time)} rows; at least {LEAST_ROWS} are needed")
    for name, values in columns.items():
        if not np.all(np.isfinite(values)):
            raise UserError(f"{path}: column {name} is not a number in every row")
    if np.any(np.diff(time) <= 0.0):
        raise UserError(f"{path}: time does not rise from row to row")
    q = _joints(path, columns, "q", anatomy)
    q_target = _joints(path, columns, "q_target", anatomy)
    if q is None or q_target is None:
        missing = "q" if q is None else "q_target"
        raise UserError(f"{path}: no columns {missing}.{MOTOR_NAMES[0]} and so on")
    for name, angles in (("q", q), ("q_target", q_target)):
        if np.max(np.abs(angles)) > LARGEST_ANGLE:
            raise UserError(
                f"{path}: {name} is up to {np.max(np.abs(angles)):.0f} rad: give radians, not degrees"
            )
    contact = _vectors(path, columns, "contact", LEGS)
    up = _vectors(path, columns, "up", "xyz")
    omega = _vectors(path, columns, "omega", "xyz")
    if contact is not None and (up is None or omega is None):
        raise UserError(
            f"{path}: has `contact`, so the robot moved: give `up` and `omega`, too"
        )
    rows = len(time)
    return Log(
        time=time - time[0],
        q=q,
        q_target=q_target,
        qd=_joints(path, columns, "qd", anatomy, rates=True),
        up=np.tile((0.0, 0.0, 1.0), (rows, 1)) if up is None else up,
        omega=np.zeros((rows, 3)) if omega is None else omega,
        airborne=np.ones((rows, 4), bool) if contact is None else contact < 0.5,
        hanging=contact is None,
    )


def describe_log(log: Log) -> LogQuality:
    """Measure jitter, lost rows, the encoders' quantum, and how late `qd` is."""
    between = np.diff(log.time)
    kept = between[between < GAP * log.step]
    changes = np.abs(np.diff(log.q, axis=0))
    delay, gain = (None, None) if log.qd is None else _lateness(log)
    return LogQuality(
        rows=len(log.time),
        step=log.step,
        jitter=float(np.std(kept)),
        lost=int(np.sum(np.round(between / log.step) - 1)),
        quantum=float(np.min(changes[changes > 1e-6]))
        if np.any(changes > 1e-6)
        else 0.0,
        rate_delay=delay,
        rate_gain=gain,
    )


def _lateness(log: Log) -> tuple[float, float]:
    """Return the delay (s) and the gain at which the derivative of q fits qd best."""
    rate = np.gradient(log.q, log.time, axis=0)
    delays = np.arange(0.0, 0.0201, 2.5e-4)
    fits: list[tuple[float, float, float]] = []
    for delay in delays:
        late = np.stack(
            [np.interp(log.time - delay, log.time, joint) for joint in rate.T], axis=1
        )
        gain = float(np.sum(late * log.qd) / np.sum(late * late))
        fits.append((float(np.sum((log.qd - gain * late) ** 2)), float(delay), gain))
    _, delay, gain = min(fits)
    return delay, gain


def _columns(path: Path) -> Columns:
    """Return the columns of a log by name."""
    if path.suffix not in (".npz", ".csv"):
        raise UserError(f"{path}: a log is an .npz or a .csv file")
    try:
        return _of_npz(path) if path.suffix == ".npz" else _of_csv(path)
    except (OSError, ValueError, KeyError) as error:
        raise UserError(f"{path}: cannot be read as a log: {error}") from error


def _of_npz(path: Path) -> Columns:
    with np.load(path, allow_pickle=False) as arrays:
        names = (
            [str(name) for name in arrays["joint_names"]]
            if "joint_names" in arrays
            else list(MOTOR_NAMES)
        )
        ends = {
            "q": names,
            "q_target": names,
            "qd": names,
            "up": "xyz",
            "omega": "xyz",
            "contact": LEGS,
        }
        columns: dict[str, np.ndarray] = {}
        for name in arrays.files:
            array = arrays[name]
            if name in ends and array.ndim == 2 and array.shape[1] == len(ends[name]):
                columns |= {
                    f"{name}.{end}": column
                    for end, column in zip(ends[name], array.T, strict=True)
                }
            elif array.ndim == 1 and array.dtype.kind in "biuf":
                columns[name] = array
        rows = len(columns["time"])
        return {
            name: column.astype(float)
            for name, column in columns.items()
            if len(column) == rows
        }


def _of_csv(path: Path) -> Columns:
    with path.open(newline="", encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    values = np.array([[float(cell) for cell in line] for line in lines if line])
    return {name.strip(): column for name, column in zip(head, values.T, strict=True)}


def _joints(
    path: Path, columns: Columns, what: str, anatomy: Anatomy, *, rates: bool = False
) -> Float[np.ndarray, "rows 12"] | None:
    """Return the columns of all joints in bp2_rl's order and signs; None without any."""
    given = {
        name.partition(".")[2]: column
        for name, column in columns.items()
        if name.startswith(f"{what}.")
    }
    if not given:
        return None
    found: list[np.ndarray] = []
    for own, joint in zip(MOTOR_NAMES, anatomy.joints, strict=True):
        if joint.name in given:
            found.append(
                joint.sign * given[joint.name] + (0.0 if rates else joint.offset)
            )
        elif own in given:
            found.append(given[own])
        else:
            raise UserError(
                f"{path}: no column {what}.{joint.name}; it has {_listed(given)}"
            )
    return np.stack(found, axis=1)


def _vectors(
    path: Path,
    columns: Columns,
    what: str,
    ends: Annotated[str | tuple[str, ...], "names"],
) -> np.ndarray | None:
    """Return the columns of a vector as one array; None where there are none."""
    found = [columns.get(f"{what}.{end}") for end in ends]
    kept = [column for column in found if column is not None]
    if kept and len(kept) < len(found):
        raise UserError(
            f"{path}: {what} needs {', '.join(f'{what}.{end}' for end in ends)}"
        )
    return np.stack(kept, axis=1) if kept else None


def _listed(names: Mapping[str, object]) -> str:
    shown = list(names)[:6]
    return ", ".join(shown) + (" ..." if len(names) > len(shown) else "")
