"""The files of a bundle, read with care: bounded in size, sealed by their hashes, and
with numbers that can be.

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

FORMAT = 5
SETTINGS, NETWORK, REFERENCE, MANIFEST = (
    "deploy.json",
    "policy.onnx",
    "reference.npz",
    "manifest.json",
)
CODE, ROBOT_FOLDER, NEEDS = "onboard", "robots", "requirements.txt"
PARTS = (SETTINGS, NETWORK, REFERENCE, NEEDS, f"{CODE}/*.py", f"{ROBOT_FOLDER}/*.xml")
"""The files of a bundle, beside which other files may lie."""
LARGEST = 64 << 20
"""Bytes of the largest file that is read: ours are far smaller."""
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
}
"""Least, most and shape of the numbers in `deploy.json` that bear on joint targets, but
for those of `CommandLaw` and `WatchdogLimits`."""


@dataclasses.dataclass(frozen=True)
class WatchdogLimits(Bounded, path="watchdog."):
    """The limits of the watchdog, `watchdog` in `deploy.json`."""

    silence: Annotated[float, Within(0.01, 1.0)]
    """s without a new measurement, and s that a new one may be old"""
    ahead: Annotated[float, Within(0.0, 1.0)]
    """s, by which a measurement's time may be ahead of the controller's clock"""
    rate: Annotated[float, Within(1.0, 10.0)]
    """factor, by which the rate of the calls of `step` may differ from the policy's"""
    stand_time: Annotated[float, Within(0.01, 10.0)]
    """s, in which the joints are led to the standing pose"""
    braking: Annotated[float, Within(0.01, 100.0)]
    """m/s2, at which the command falls where the operator says nothing"""
    joint_margin: Annotated[float, Within(0.0, 3.2)]
    """rad, by which a joint may be beyond its range"""
    joint_speed: Annotated[float, Within(1.0, 1e4)]
    """rad/s, of a joint and of its target"""
    target_step: Annotated[float, Within(0.01, 10.0)]
    """rad, by which a target may change in a tick"""
    turning: Annotated[float, Within(1.0, 1e4)]
    """rad/s, of the trunk"""
    up_length: Annotated[float, Within(0.01, 0.9)]
    """by which the length of `up` may differ from 1"""
    tilt: Annotated[float, Within(0.1, math.pi)]
    """rad, between `up` and the trunk's z axis"""
    frozen: Annotated[float, Within(0.01, 10.0)]
    """s, for which a sensor may repeat its value with new stamps"""
    frozen_target: Annotated[float, Within(0.001, 10.0)]
    """rad, by which a joint's target moves before an encoder that repeats its value is
    frozen"""
    window: Annotated[float, Within(0.1, 10.0)]
    """s, over which speeds, changes and targets are compared"""
    mismatch: Annotated[float, Within(0.01, 1.0)]
    """of an integrated speed from the joint's change that it belongs to: share of the
    larger of both"""
    joint_noise: Annotated[float, Within(0.001, 10.0)]
    """rad, which is added to that share"""
    turned: Annotated[float, Within(0.001, 1.0)]
    """least standard deviation of the changes of `up` at which they are compared with
    the gyro"""
    unlike: Annotated[float, Within(0.01, 1.0)]
    """share of what `up`, or the gyro, turns by that the other may not have"""
    off_target: Annotated[float, Within(0.01, 10.0)]
    """rad, of a joint's mean from its targets' mean"""
    opposed: Annotated[float, Within(0.01, 1.0)]
    """correlation of a joint with its target, as a negative number's size"""
    swing: Annotated[float, Within(0.001, 10.0)]
    """rad, the least standard deviation of both for which a correlation counts"""
    still: Annotated[float, Within(0.001, 1.0)]
    """least standard deviation of a joint over that of its target, where the target's
    is 1.5 times `swing`"""


class BundleError(UserError):
    """A bundle that is missing, damaged, or holds what cannot be: one line that says
    what, and how to mend it."""


@contextlib.contextmanager
def loading(folder: Path | str) -> Generator[None]:
    """Turn whatever a bundle's files make of the code in the block into a
    `BundleError`.

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
    """Return the content of `deploy.json`, and the bundle's files by name.

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
        sealed, there = (
            parse_json(read_bytes(path / MANIFEST, LARGEST), str(path / MANIFEST)),
            _hashes(files),
        )
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
    """Write the manifest of a bundle's files as they are now; return the names of the
    files that have changed.

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


def describe(settings: Settings) -> str:
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
    """Refuse settings with a number that is none or out of its bounds, or a stand
    beyond the joints' ranges."""
    json.dumps(settings, allow_nan=False)
    describe(settings)
    for name, (least, most, *shape) in NUMBERS.items():
        value = _find(settings, name)
        numbers = np.asarray(value)
        right = numbers.dtype.kind in "biuf" and list(numbers.shape) == shape
        if not (right and np.all((numbers >= least) & (numbers <= most))):
            raise BundleError(
                f"{path}: {name} must be from {least:g} to {most:g}, got {shown(value)}; mend and seal it"
            )
    check_bounds(command_law(settings), "control.")
    WatchdogLimits(**settings["watchdog"])
    low, high = np.transpose(settings["joint_range"])
    stand, signs = settings["control"]["stand"], _find(settings, "model_joints.sign")
    if np.any(low > stand) or np.any(stand > high) or not {*signs} <= {-1, 1}:
        raise BundleError(
            f"{path}: control.stand is beyond joint_range, or a sign is neither 1 nor -1; export it anew"
        )


def with_infinity(values: Settings) -> dict[str, Any]:
    """Return limits by name, with infinity where `deploy.json` has null, because JSON
    has no infinity.

    A limit is a number, or an array of twelve where joints differ.
    """

    def number(value: Any) -> Any:
        if isinstance(value, list):
            return np.array([number(one) for one in value])
        return math.inf if value is None else value

    return {name: number(value) for name, value in values.items()}


def command_law(settings: Settings) -> CommandLaw:
    """Return the limits of `deploy.json` on the forward command that the policy is
    told."""
    control = settings["control"]
    return CommandLaw(**with_infinity({name: control[name] for name in COMMAND_LIMITS}))


def _find(settings: Settings, name: str) -> Any:
    """Return the value with a dotted name; from a list of objects, a list of their
    values."""
    value: Any = settings
    for part in name.split("."):
        value = [one[part] for one in value] if isinstance(value, list) else value[part]
    return value


Convention = Literal["bundle", "model"]
"""Whose signs and zeros joint angles have: the bundle's, or those of the robot's own
model."""


@dataclasses.dataclass(frozen=True)
class JointFrame:
    """The signs and zeros that a caller's joint angles have: the bundle's angle is sign
    x the caller's + offset."""

    names: Sequence[str]
    sign: np.ndarray  # (12)
    offset: np.ndarray  # (2 12), of angles (rad) and of speeds, which have none

    @classmethod
    def of(cls, settings: Settings, convention: Convention) -> "JointFrame":
        """Return the frame of a convention, by the content of `deploy.json`.

        Raises:
            UserError: there is no such convention.
        """
        require_one_of("convention", convention, ("bundle", "model"))
        if convention == "bundle":
            return cls(MOTOR_NAMES, np.ones(12), np.zeros((2, 12)))
        names, sign, offset = (
            _find(settings, f"model_joints.{key}") for key in ("name", "sign", "offset")
        )
        return cls(names, np.array(sign), np.stack((offset, np.zeros(12))))

    def inward(self, joints: np.ndarray) -> np.ndarray:
        """Return a caller's joint angles and speeds (2 12) as the bundle has them."""
        return self.sign * joints + self.offset

    def outward(self, joints: np.ndarray) -> np.ndarray:
        """Return the bundle's joint angles and speeds (2 12) as the caller has them."""
        return self.sign * (joints - self.offset)
