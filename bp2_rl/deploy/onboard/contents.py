"""The files of a bundle, read with care: bounded in size, sealed by their hashes, and
with numbers that can be.

A network with a flipped bit is still a network, which answers otherwise. So
`manifest.json` has the SHA-256 of every file, and nothing is loaded whose hash is
another. `python -m onboard.seal` writes the manifest anew.
"""

import contextlib
import hashlib
import json
import math
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bp2_rl.base.errors import UserError, one_line, shown
from bp2_rl.base.files import parse_json, read_bytes, write_text
from bp2_rl.robot.conventions import POLICY_RATE

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
    "control.braking": (0.1, math.inf),
    "control.stopping_time": (0.0, 1000.0),
    "control.launching": (0.1, math.inf),
    "control.launching_speed": (0.1, math.inf),
    "control.stand": (-10.0, 10.0, 12),
    "gains.stiffness": (0.1, 1e5),
    "gains.damping": (0.0, 1e4),
    "command.least": (-1000.0, 0.0, 3),
    "command.most": (0.0, 1000.0, 3),
    "watchdog.silence": (0.01, 1.0),
    "watchdog.ahead": (0.0, 1.0),
    "watchdog.rate": (1.0, 10.0),
    "watchdog.stand_time": (0.01, 10.0),
    "watchdog.braking": (0.01, 100.0),
    "watchdog.joint_margin": (0.0, 3.2),
    "watchdog.joint_speed": (1.0, 1e4),
    "watchdog.target_step": (0.01, 10.0),
    "watchdog.turning": (1.0, 1e4),
    "watchdog.up_length": (0.01, 0.9),
    "watchdog.tilt": (0.1, math.pi),
    "watchdog.frozen": (0.01, 10.0),
    "watchdog.frozen_target": (0.001, 10.0),
    "watchdog.window": (0.1, 10.0),
    "watchdog.mismatch": (0.01, 1.0),
    "watchdog.joint_noise": (0.001, 10.0),
    "watchdog.turned": (0.001, 1.0),
    "watchdog.unlike": (0.01, 1.0),
    "watchdog.off_target": (0.01, 10.0),
    "watchdog.opposed": (0.01, 1.0),
    "watchdog.swing": (0.001, 10.0),
    "watchdog.still": (0.001, 1.0),
    "rehearsal.speed": (0.001, 1000.0),
}
"""Least, most and shape of the numbers in `deploy.json` that bear on joint targets.

Where `most` is infinite, null stands for infinity, which JSON does not have.
"""


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


def read_bundle(folder: Path | str) -> tuple[dict[str, Any], dict[str, bytes]]:
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
        numbers = np.asarray(most if value is None and most == math.inf else value)
        right = numbers.dtype.kind in "biuf" and list(numbers.shape) == shape
        if not (right and np.all((numbers >= least) & (numbers <= most))):
            raise BundleError(
                f"{path}: {name} must be from {least:g} to {most:g}, got {shown(value)}; mend and seal it"
            )
    (low, high), stand = (
        np.transpose(settings["joint_range"]),
        settings["control"]["stand"],
    )
    if (
        np.any(low > stand)
        or np.any(stand > high)
        or not {*_find(settings, "model_joints.sign")} <= {-1, 1}
    ):
        raise BundleError(
            f"{path}: control.stand is beyond joint_range, or a sign is neither 1 nor -1; export it anew"
        )


def _find(settings: Settings, name: str) -> Any:
    """Return the value with a dotted name; from a list of objects, a list of their
    values."""
    value: Any = settings
    for part in name.split("."):
        value = [one[part] for one in value] if isinstance(value, list) else value[part]
    return value
