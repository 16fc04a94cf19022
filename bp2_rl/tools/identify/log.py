"""Logs of a real robot: reading, checking and describing the recorded rows.

A log is a .csv or an .npz file, angles in rad, times in s. Columns of a .csv file:

    time               of each row
    q.JOINT            measured angle of each joint, by the joints' names
    q_target.JOINT     target of the joint's position loop, as it was applied
    qd_target.JOINT    optional: target of its rate; without it 0
    qd.JOINT           optional: measured rate
    up.x, .y, .z       optional: the world's upward direction in the trunk's axes
    omega.x, .y, .z    optional: the trunk's angular velocity in its own axes, rad/s
    acceleration.x ... optional: specific force at the trunk's origin in its axes, m/s2,
                       as an accelerometer gives it: (0, 0, 9.81) of a level trunk at rest
    contact.LEG        optional: 0 while the foot of FR, FL, RR or RL swings freely

An .npz file has the arrays `time`, `q`, `q_target`, `qd_target`, `qd` (rows, 12) with the twelve names
in `joint_names`, `up`, `omega`, `acceleration` (rows, 3) and `contact` (rows, 4). The joints' names are
the robot file's, whose signs and offsets then apply, or else bp2_rl's own (FR_abad).
Without `contact` the robot hangs, and every leg is free.
"""

import csv
import dataclasses
import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.files import read_bytes
from bp2_rl.base.metric import metric
from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.conventions import GRAVITY, LEGS, MOTOR_NAMES

LARGEST = 2**30  # bytes
LARGEST_ANGLE = 4.0 * np.pi
"""rad; a larger angle means that the log is in degrees."""
LEAST_ROWS = 200
STEPS = 2e-4, 5e-3  # s, between two rows: what can be fitted
GAP = 1.5
"""Times the usual time between rows: a longer one means that rows were lost."""
DELAYS = np.arange(0.0, 0.0201, 2.5e-4)  # s, of qd behind q, that are tried
ENDS: dict[str, Sequence[str]] = {
    "q": MOTOR_NAMES,
    "q_target": MOTOR_NAMES,
    "qd_target": MOTOR_NAMES,
    "qd": MOTOR_NAMES,
    "up": "xyz",
    "omega": "xyz",
    "acceleration": "xyz",
    "contact": LEGS,
}
"""Groups of columns, with the ends of their names: q.FR_abad, up.x."""
Columns = Mapping[str, Float[np.ndarray, " rows"]]


@dataclasses.dataclass(frozen=True)
class RobotLog:
    """Rows of a log, in the order, axes and signs of bp2_rl's joints."""

    time: Float[np.ndarray, " rows"]  # s
    q: Float[np.ndarray, "rows 12"]  # rad
    q_target: Float[np.ndarray, "rows 12"]  # rad
    qd_target: Float[np.ndarray, "rows 12"]  # rad/s
    qd: Float[np.ndarray, "rows 12"] | None  # rad/s
    up: Float[np.ndarray, "rows 3"]  # the world's z in the trunk's axes
    omega: Float[np.ndarray, "rows 3"]  # rad/s, of the trunk, in its axes
    acceleration: Float[np.ndarray, "rows 3"]  # m/s2, specific force, in its axes
    airborne: Bool[np.ndarray, "rows 4"]  # whether a leg's foot is free
    hanging: bool

    @property
    def step(self) -> float:
        """Usual time between two rows, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def whole(self) -> Bool[np.ndarray, " rows"]:
        """True at each row after which no row was lost."""
        return np.append(np.diff(self.time) < GAP * self.step, False)


@dataclasses.dataclass(frozen=True)
class LogQuality:
    """Properties of a log's recording, whatever the robot did."""

    rows: int = metric("Rows", form="d", meaning="of the log")
    step: float = metric("Time between rows", "ms", ".3f", "median")
    jitter: float = metric("Jitter", "ms", ".3f", "standard deviation of that time")
    lost: int = metric("Lost rows", form="d", meaning="by gaps in time")
    quantum: float = metric("Encoder quantum", "mrad", ".3f", "least change of angle")
    rate_delay: float | None = metric(
        "Delay of qd", "ms", ".1f", "behind the derivative of q", default=None
    )
    rate_gain: float | None = metric(
        "Gain of qd", "", ".2f", "over the derivative of q", default=None
    )


def read_log(path: Path, anatomy: Anatomy) -> RobotLog:
    """Read a log of a robot.

    Raises:
        UserError: the file is no log, or a column is missing, misnamed or impossible.
    """
    if path.suffix not in (".npz", ".csv"):
        raise UserError(f"{path}: a log is an .npz or a .csv file")
    content = read_bytes(path, LARGEST)
    try:
        return _log(_columns(content, path.suffix), anatomy)
    except UserError as error:
        raise UserError(f"{path}: {one_line(str(error))}") from error
    except (
        OSError,
        ValueError,
        TypeError,
        EOFError,
        csv.Error,
        zipfile.BadZipFile,
    ) as error:
        raise UserError(
            f"{path}: cannot be read as a log: {one_line(str(error))}"
        ) from error


def _log(columns: Columns, anatomy: Anatomy) -> RobotLog:
    time = columns.get("time")
    if time is None:
        raise UserError(f"no column `time`; it has {_listed(columns)}")
    if len(time) < LEAST_ROWS:
        raise UserError(f"{len(time)} rows; at least {LEAST_ROWS} are needed")
    for name, values in columns.items():
        if not np.all(np.isfinite(values)):
            raise UserError(f"column {name} is not a number in every row")
    between = np.diff(time)
    if np.any(between <= 0.0):
        raise UserError("time does not rise from row to row")
    if not STEPS[0] <= np.median(between) <= STEPS[1]:
        raise UserError(
            f"rows are {np.median(between):g} s apart; {STEPS[0]:g} to {STEPS[1]:g} s can be fitted"
        )
    own = [joint.name for joint in anatomy.joints]
    names = own if f"q.{own[0]}" in columns else list(MOTOR_NAMES)
    signs = np.array([joint.sign for joint in anatomy.joints])
    offsets = np.array([joint.offset for joint in anatomy.joints])
    if names != own:
        signs, offsets = np.ones(12), np.zeros(12)
    angles = {what: _stacked(columns, what, names) for what in ("q", "q_target")}
    rates = {
        what: signs * _stacked(columns, what, names)
        for what in ("qd", "qd_target")
        if _given(columns, what)
    }
    for what in ("q", "q_target"):
        most = np.max(np.abs(angles[what]))
        if most > LARGEST_ANGLE:
            raise UserError(
                f"{what} is up to {most:.0f} rad: give radians, not degrees"
            )
    up, omega, acceleration, contact = (
        _stacked(columns, what, ENDS[what]) if _given(columns, what) else None
        for what in ("up", "omega", "acceleration", "contact")
    )
    if contact is not None and (up is None or omega is None):
        raise UserError(
            "it has `contact`, so the robot moved: give `up` and `omega`, too"
        )
    up = np.tile((0.0, 0.0, 1.0), (len(time), 1)) if up is None else up
    length = np.linalg.norm(up, axis=1, keepdims=True)
    if np.max(np.abs(length - 1.0)) > 0.05 or np.median(up[:, 2]) < 0.5:
        raise UserError(
            "`up` must be a vector of length 1 that points upwards: (0, 0, 1) of a level trunk"
        )
    if acceleration is None:
        acceleration = GRAVITY * up / length
    mean = np.mean(acceleration, axis=0)
    if not 0.5 * GRAVITY < mean[2] < 1.5 * GRAVITY:
        raise UserError(
            f"`acceleration` is {mean[2]:.1f} m/s2 along z on average: give the specific force, 9.81 of a level trunk at rest"
        )
    return RobotLog(
        time=time - time[0],
        q=signs * angles["q"] + offsets,
        q_target=signs * angles["q_target"] + offsets,
        qd_target=rates.get("qd_target", np.zeros_like(angles["q"])),
        qd=rates.get("qd"),
        up=up / length,
        omega=np.zeros((len(time), 3)) if omega is None else omega,
        acceleration=acceleration,
        airborne=np.ones((len(time), 4), bool) if contact is None else contact < 0.5,
        hanging=contact is None,
    )


def describe_log(log: RobotLog) -> LogQuality:
    """Measure jitter, lost rows, the encoders' quantum, and how late `qd` is."""
    between = np.diff(log.time)
    changes = np.abs(np.diff(log.q, axis=0))
    moved = changes[changes > 1e-6]
    delay, gain = _lateness(log)
    return LogQuality(
        rows=len(log.time),
        step=log.step,
        jitter=float(np.std(between[between < GAP * log.step])),
        lost=int(np.sum(np.maximum(np.round(between / log.step) - 1.0, 0.0))),
        quantum=float(np.min(moved)) if len(moved) else 0.0,
        rate_delay=delay,
        rate_gain=gain,
    )


def _lateness(log: RobotLog) -> tuple[float | None, float | None]:
    """Return the delay (s) and the gain at which the derivative of q fits qd best."""
    rate, qd = np.gradient(log.q, log.time, axis=0), log.qd
    if qd is None or not np.any(rate):
        return None, None
    fits: list[tuple[float, float, float]] = []
    for delay in DELAYS:
        late = [np.interp(log.time - delay, log.time, joint) for joint in rate.T]
        given = np.stack(late, axis=1)
        gain = float(np.sum(given * qd) / np.sum(given * given))
        fits.append((float(np.sum((qd - gain * given) ** 2)), float(delay), gain))
    return min(fits)[1:]


def _columns(content: bytes, suffix: str) -> Columns:
    """Return the columns of a log by name."""
    return (
        _of_npz(content) if suffix == ".npz" else _of_csv(content.decode("utf-8-sig"))
    )


def _of_npz(content: bytes) -> Columns:
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    names = arrays.pop("joint_names", np.array(MOTOR_NAMES))
    if "time" not in arrays or arrays["time"].ndim != 1:
        raise UserError(f"no array `time`; it has {_listed(arrays)}")
    columns = {"time": arrays.pop("time").astype(float)}
    for name, ends in ENDS.items():
        array = arrays.pop(name, None)
        if array is None:
            continue
        shape = len(columns["time"]), len(ends)
        if array.shape != shape:
            raise UserError(f"{name} has the shape {array.shape}; it must be {shape}")
        own = [str(joint) for joint in names] if len(ends) == 12 else ends
        columns |= {
            f"{name}.{end}": x.astype(float)
            for end, x in zip(own, array.T, strict=True)
        }
    return columns


def _of_csv(text: str) -> Columns:
    head, *lines = csv.reader(io.StringIO(text))
    values = np.array([[float(cell) for cell in line] for line in lines if line])
    names = [name.strip() for name in head]
    for name in names:
        what, _, end = name.partition(".")
        if what in ENDS and len(ENDS[what]) < 12 and end not in ENDS[what]:
            raise UserError(
                f"column {name}: the ends of {what} are {', '.join(ENDS[what])}"
            )
    return dict(zip(names, values.T, strict=True))


def _given(columns: Columns, what: str) -> bool:
    return any(name.startswith(f"{what}.") for name in columns)


def _stacked(columns: Columns, what: str, ends: Sequence[str]) -> np.ndarray:
    """Return columns that go together as one array (rows, ends)."""
    names = [f"{what}.{end}" for end in ends]
    missing = [name for name in names if name not in columns]
    if missing:
        raise UserError(f"no column {missing[0]}; it has {_listed(columns)}")
    return np.stack([columns[name] for name in names], axis=1)


def _listed(names: Mapping[str, object]) -> str:
    shown = list(names)[:6]
    return ", ".join(shown) + (" ..." if len(names) > len(shown) else "")
