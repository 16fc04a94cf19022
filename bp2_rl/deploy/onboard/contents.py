"""Read a bundle's files with checks of their size, their hashes and the bounds of their
numbers.

A network with a flipped bit is still a network, which answers otherwise. So
`manifest.json` has the SHA-256 of every file, and nothing is loaded whose hash is
another. `python -m onboard.seal` writes the manifest anew.
"""

import contextlib
import dataclasses
import hashlib
import json
import math
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from bp2_rl.base.bounds import Bounded, Within, check_bounds
from bp2_rl.base.errors import UserError, one_line, require_one_of, shown
from bp2_rl.base.files import parse_json, read_bytes, write_text
from bp2_rl.robot.conventions import MOTOR_NAMES, POLICY_RATE
from bp2_rl.robot.operator import COMMAND_LIMITS, CommandLaw

FORMAT = 6
SETTINGS = "deploy.json"
NETWORK = "policy.onnx"
REFERENCE = "reference.npz"
MANIFEST = "manifest.json"
CODE, ROBOT_FOLDER, NEEDS = "onboard", "robots", "requirements.txt"
CPP = "cpp"
PARTS = (
    *(SETTINGS, NETWORK, REFERENCE, NEEDS),
    *(f"{CODE}/*.py", f"{ROBOT_FOLDER}/*.xml", f"{CPP}/*.hpp", f"{CPP}/*.bin"),
)
"""The files of a bundle, as glob patterns; other files may lie beside them."""
LARGEST = 64 << 20
"""Largest file that is read, bytes; a bundle's own files are far smaller."""
Settings = Mapping[str, Any]
"""The content of `deploy.json`, or of an object in it."""
NUMBERS = {
    "rates.policy": (POLICY_RATE, POLICY_RATE),
    "joint_range": (-10.0, 10.0, 12, 2),
    "model_joints.sign": (-1, 1, 12),
    "model_joints.offset": (-100.0, 100.0, 12),
    "control.action_scale": (0.001, 10.0),
    "control.action_limit": (0.001, 100.0),
    "control.feedforward": (-10.0, 10.0),
    "control.clock_at_rest": (0, 1),
    "control.stand": (-10.0, 10.0, 12),
    "gains.stiffness": (0.1, 1e5),
    "gains.damping": (0.0, 1e4),
    "command.least": (-1000.0, 0.0, 3),
    "command.most": (0.0, 1000.0, 3),
    "rehearsal.speed": (0.001, 1000.0),
    "rehearsal.hold": (0.001, 1000.0),
}
"""Bounds (least, most) and shape of each number in `deploy.json` that affects joint
targets and has no bounds elsewhere."""


@dataclasses.dataclass(frozen=True)
class WatchdogLimits(Bounded, path="watchdog."):
    """The limits at which the watchdog stops the policy, `watchdog` in
    `deploy.json`."""

    silence: Annotated[float, Within(0.01, 1.0)]
    """s, longest time without a new measurement, and greatest age of a new one"""
    ahead: Annotated[float, Within(0.0, 1.0)]
    """s, by which a measurement's time may be ahead of the controller's clock"""
    rate: Annotated[float, Within(1.0, 10.0)]
    """factor by which the rate of calls of `step` may differ from the policy's rate"""
    stand_time: Annotated[float, Within(0.01, 10.0)]
    """s, in which a stopped controller leads the joints to the standing pose"""
    braking: Annotated[float, Within(0.01, 100.0)]
    """m/s2, deceleration of the command where the operator is silent"""
    joint_margin: Annotated[float, Within(0.0, 3.2)]
    """rad, by which a joint may be beyond its range"""
    joint_speed: Annotated[float, Within(1.0, 1e4)]
    """rad/s, largest speed of a joint and of its target"""
    target_step: Annotated[float, Within(0.01, 10.0)]
    """rad, largest change of a joint target in a tick"""
    turning: Annotated[float, Within(1.0, 1e4)]
    """rad/s, largest angular velocity of the trunk about an axis"""
    up_length: Annotated[float, Within(0.01, 0.9)]
    """by which the length of `up` may differ from 1"""
    tilt: Annotated[float, Within(0.1, math.pi)]
    """rad, largest angle between `up` and the trunk's z axis"""
    frozen: Annotated[float, Within(0.01, 10.0)]
    """s, longest time for which a sensor may repeat its value with new time stamps"""
    frozen_target: Annotated[float, Within(0.001, 10.0)]
    """rad, change of a joint's target after which an encoder that repeats its value
    counts as frozen"""
    window: Annotated[float, Within(0.1, 10.0)]
    """s, over which speeds, changes and targets are compared"""
    mismatch: Annotated[float, Within(0.01, 1.0)]
    """largest difference between a joint's integrated speed and its change of angle, as
    a share of the larger"""
    joint_noise: Annotated[float, Within(0.001, 10.0)]
    """rad, allowed in addition to `mismatch` (root of the sum of squares)"""
    turned: Annotated[float, Within(0.001, 1.0)]
    """least standard deviation of the changes of `up` at which `up` and gyro are
    compared"""
    unlike: Annotated[float, Within(0.01, 1.0)]
    """largest share of the rotation seen by `up` or the gyro that the other does not
    see"""
    off_target: Annotated[float, Within(0.01, 10.0)]
    """rad, largest distance of a joint's mean angle from the mean of its targets"""
    opposed: Annotated[float, Within(0.01, 1.0)]
    """largest negative correlation of a joint with its target, given as a positive
    number"""
    swing: Annotated[float, Within(0.001, 10.0)]
    """rad, least standard deviation of joint and target at which their correlation
    counts"""
    still: Annotated[float, Within(0.001, 1.0)]
    """least ratio of a joint's standard deviation to its target's, where the target's
    is above 1.5 `swing`"""


class BundleError(UserError):
    """A bundle is missing, damaged or holds impossible values; the message says how to
    mend it, in one line."""


@contextlib.contextmanager
def loading(folder: Path | str) -> Generator[None]:
    """Raise a `BundleError` for any error that a bundle's files cause in the block.

    Files that are damaged and sealed again fail in NumPy, onnxruntime or MuJoCo, each
    with errors of its own.
    """
    try:
        yield
    except (BundleError, ImportError):
        raise
    except Exception as error:
        line = one_line(str(error) if isinstance(error, UserError) else repr(error))[
            :300
        ]
        raise BundleError(
            f"bundle {folder} cannot be used: {line}; else export it anew"
        ) from error


def read_bundle(folder: Path | str) -> tuple[Settings, dict[str, bytes]]:
    """Return the content of a bundle's `deploy.json`, and all its files as bytes by
    name.

    Raises:
        BundleError: the folder is no bundle of this format, a file is not as it was
            sealed, or a number is out of its bounds.
    """
    with loading(folder):
        path = Path(folder)
        if not (path / SETTINGS).is_file():
            raise BundleError(f"no bundle in {folder}: it has no {SETTINGS}")
        files = _read(path)
        settings = parse_json(files[SETTINGS], str(path / SETTINGS))
        found = dict(settings).get("format")
        if found != FORMAT:
            raise BundleError(
                f"{path / SETTINGS} has format {found}, this controller reads {FORMAT}: export it anew"
            )
        sealed = parse_json(read_bytes(path / MANIFEST, LARGEST), str(path / MANIFEST))
        there = _hashes(files)
        changed = [
            name
            for name in sorted({*sealed, *there})
            if sealed.get(name) != there.get(name)
        ]
        if changed:
            raise BundleError(
                f"{path / changed[0]} is not as it was sealed: if you edited it, run `python -m onboard.seal` in the "
                "bundle's folder; else export the bundle anew"
            )
        _check(settings, path / SETTINGS)
        return settings, files


def seal(folder: Path) -> list[str]:
    """Write the hashes of a bundle's files into its manifest; return the names of the
    changed files.

    Raises:
        BundleError: a file cannot be read or written.
    """
    with loading(folder):
        path = folder / MANIFEST
        # which may be damaged
        before = read_bytes(path, LARGEST) if path.is_file() else b""
        hashes = _hashes(_read(folder))
        write_text(path, json.dumps(hashes, indent=1) + "\n")
        return [name for name, value in hashes.items() if value.encode() not in before]


def describe_bundle(settings: Settings) -> str:
    """Describe the bundle in one line: stage, date, weights and robots of its
    policy."""
    policy, robots = settings["policy"], ", ".join(dict(settings["robots"]))
    return f"{policy['stage']} policy of {policy['created']}, weights {policy['weights_sha256'][:12]}, for {robots}"


def _read(folder: Path) -> dict[str, bytes]:
    paths = (path for part in PARTS for path in sorted(folder.glob(part)))
    return {
        path.relative_to(folder).as_posix(): read_bytes(path, LARGEST) for path in paths
    }


def _hashes(files: Mapping[str, bytes]) -> dict[str, str]:
    return {
        name: hashlib.sha256(content).hexdigest() for name, content in files.items()
    }


def _check(settings: Settings, path: Path) -> None:
    """Raise BundleError for a number that is missing or out of bounds, or a stand
    outside the joint ranges."""
    json.dumps(settings, allow_nan=False)
    describe_bundle(settings)
    for name, (least, most, *shape) in NUMBERS.items():
        numbers = _numbers(settings, name)
        right = numbers.dtype.kind in "biuf" and list(numbers.shape) == shape
        if not (right and np.all((numbers >= least) & (numbers <= most))):
            raise BundleError(
                f"{path}: {name} must be from {least:g} to {most:g}, got {shown(numbers.tolist())}; mend and seal it"
            )
    check_bounds(command_law(settings), "control.")
    WatchdogLimits(**settings["watchdog"])
    low, high = np.transpose(settings["joint_range"])
    stand = settings["control"]["stand"]
    signs = _numbers(settings, "model_joints.sign").tolist()
    if np.any(low > stand) or np.any(stand > high) or not {*signs} <= {-1, 1}:
        raise BundleError(
            f"{path}: control.stand is beyond joint_range, or a sign is neither 1 nor -1; export it anew"
        )


def with_infinity(values: Settings) -> dict[str, np.float64 | np.ndarray]:
    """Return limits by name, with infinity in the place of JSON's null.

    A limit is a number, or an array of twelve where joints differ.
    """
    # NumPy reads null as NaN; the bounds were checked before
    return {
        name: np.nan_to_num(np.array(value, float), nan=math.inf, posinf=math.inf)
        for name, value in values.items()
    }


def command_law(settings: Settings) -> CommandLaw:
    """Return the limits on the forward command that the policy observes, from
    `deploy.json`."""
    limits = {name: settings["control"][name] for name in COMMAND_LIMITS}
    return CommandLaw(
        **{name: math.inf if x is None else x for name, x in limits.items()}
    )


def _numbers(settings: Settings, name: str) -> np.ndarray:
    """Return the value at a dotted name in the settings as an array; an array of values
    where there is a list of objects."""
    value = settings
    for part in name.split("."):
        value = (
            [entry[part] for entry in value] if isinstance(value, list) else value[part]
        )
    return np.asarray(value)


Convention = Literal["bundle", "model"]
"""Whose signs and zeros joint angles have: the bundle's, or those of the robot's own
model."""


@dataclasses.dataclass(frozen=True)
class JointFrame:
    """Conversion between a caller's joint angles and the bundle's: bundle = sign x
    caller + offset."""

    names: Sequence[str]
    sign: np.ndarray  # (12)
    offset: np.ndarray  # (2 12), of angles (rad) and of speeds, which have none

    @classmethod
    def of(cls, settings: Settings, convention: Convention) -> "JointFrame":
        """Return the joint frame of a convention, from the content of `deploy.json`.

        Raises:
            UserError: there is no such convention.
        """
        require_one_of("convention", convention, ("bundle", "model"))
        if convention == "bundle":
            return cls(MOTOR_NAMES, np.ones(12), np.zeros((2, 12)))
        names, sign, offset = (
            _numbers(settings, f"model_joints.{key}")
            for key in ("name", "sign", "offset")
        )
        return cls(names.tolist(), sign, np.stack((offset, np.zeros(12))))

    def inward(self, joints: np.ndarray) -> np.ndarray:
        """Convert a caller's joint angles and speeds (2 12) to the bundle's signs and
        zeros."""
        return self.sign * joints + self.offset

    def outward(self, joints: np.ndarray) -> np.ndarray:
        """Convert the bundle's joint angles and speeds (2 12) to the caller's signs and
        zeros."""
        return self.sign * (joints - self.offset)
