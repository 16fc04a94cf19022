"""The file format of motion libraries: trots over a range of speeds, found by
`bp2_rl.optimiser`, in one .npz.

This module alone reads and writes such files. What it knows nothing of is how a library
was found: that is in the provenance, a JSON object, which it passes on as it is.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import ArrayT
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import (
    ArraySpec,
    BadFileError,
    parse_json,
    read_bytes,
    read_npz,
    write_npz,
)
from bp2_rl.settings.reference import REMEDY

FORMAT = 1
LARGEST = 1e6
"""Largest number in a library, SI units: BP2's is an acceleration of 2,258 rad/s2."""
SHORTEST = 1e-4
"""Shortest segment in a library, s: BP2's lasts 9 ms."""

TRUNK, COORDINATES = 3, 15  # x, z, pitch; these and hip, knee and spring of each leg
PERIODIC = 1e-4  # m or rad, by which segments may fail to join
ARRAYS = {
    "speeds": ArraySpec(np.floating, ("speeds",)),
    "durations": ArraySpec(np.floating, ("speeds", 2)),
    "q": ArraySpec(np.floating, ("speeds", 2, "points", COORDINATES)),
    "v": ArraySpec(np.floating, ("speeds", 2, "points", COORDINATES)),
    "a": ArraySpec(np.floating, ("speeds", 2, "points", COORDINATES)),
    "tau": ArraySpec(np.floating, ("speeds", 2, "points", 8)),
    "force": ArraySpec(np.floating, ("speeds", 2, "points", 8)),
    "impulse": ArraySpec(np.floating, ("speeds", 2, 8)),
}
"""Types and shapes of the arrays in a library's file; the fields of `MotionLibrary`
explain them."""


@dataclasses.dataclass(frozen=True, eq=False)
class MotionLibrary:
    """Trajectories of S speeds, each of two segments (stance of FL and RR, flight) of K
    points equally spaced in time.

    Coordinates: x, z and pitch of the trunk, then hip, knee and spring (zero of a rigid
    shank) of each leg. Where velocities jump, a segment's first point is after the
    impact and its last one before the next.
    """

    speeds: Float[np.ndarray, " S"]  # m/s, ascending
    durations: Float[np.ndarray, "S 2"]  # s; they add up to half a period
    q: Float[np.ndarray, "S 2 K 15"]  # m, rad
    v: Float[np.ndarray, "S 2 K 15"]  # m/s, rad/s
    a: Float[np.ndarray, "S 2 K 15"]  # m/s2, rad/s2
    tau: Float[np.ndarray, "S 2 K 8"]  # Nm, hip and knee of each leg
    force: Float[np.ndarray, "S 2 K 8"]  # N, (x, z) under each foot
    impulse: Float[np.ndarray, "S 2 8"]  # N s, as each segment begins
    provenance: dict[str, Any]  # problem, versions and what was verified

    @property
    def robot(self) -> str:
        """Name of the robot that moves; BP2 where the file does not say."""
        return str(self.provenance.get("robot", "BP2"))

    @property
    def arrays(self) -> dict[str, Float[np.ndarray, "..."]]:
        """Return all arrays but the provenance, by name."""
        return {name: getattr(self, name) for name in ARRAYS}


def save_library(path: Path, library: MotionLibrary) -> None:
    """Write a library to `path`, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    provenance = np.asarray(json.dumps(library.provenance))
    arrays = {"format": np.asarray(FORMAT), **library.arrays, "provenance": provenance}
    write_npz(path, arrays, compressed=True)


def load_library(path: Path) -> MotionLibrary:
    """Read and check the library that `save_library` wrote to `path`.

    Raises:
        UserError: there is no such file, it is broken or of another format, or its
            trajectories are no periodic trot.
    """
    try:
        content = read_bytes(path)
        version = read_npz(
            path, {"format": ArraySpec(np.integer, ())}, content=content
        )["format"]
        if version != FORMAT:
            raise broken(path, f"has format {version}, this version reads {FORMAT}")
        contents = read_npz(
            path, ARRAYS | {"provenance": ArraySpec(np.str_, ())}, content=content
        )
    except BadFileError as error:
        raise UserError(f"motion library {error}: {REMEDY}") from error
    try:
        provenance = parse_json(str(contents.pop("provenance")), "its provenance")
    except BadFileError as error:
        raise broken(path, "holds a provenance that is not JSON") from error
    if not isinstance(provenance, dict):
        raise broken(path, "holds a provenance that is not a JSON object")
    if min(contents["speeds"].size, contents["q"].shape[2]) < 2:
        sizes = f"{contents['speeds'].size} and {contents['q'].shape[2]}"
        raise broken(path, f"needs two speeds and two points a segment, has {sizes}")
    for name, array in contents.items():
        if not (np.abs(array) <= LARGEST).all():
            raise broken(
                path,
                f"holds numbers in {name} that are not finite, or beyond {LARGEST:g}",
            )
    library = MotionLibrary(**contents, provenance=provenance)
    if fault := _fault(library):
        raise broken(path, fault)
    return library


def broken(path: Path, fault: str) -> UserError:
    """Return the error that names a fault of a motion library, in one line."""
    return UserError(f"motion library {path} {fault}: {REMEDY}")


def by_leg(coordinates: ArrayT) -> ArrayT:
    """Return coordinates (..., 12) reshaped by leg, (..., 4, 3)."""
    return coordinates.reshape(*coordinates.shape[:-1], 4, 3)


def mirror(legs: ArrayT) -> ArrayT:
    """Return the legs' numbers (..., 4, n) with left and right legs exchanged."""
    xp = legs.__array_namespace__()
    pairs = legs.reshape(*legs.shape[:-2], 2, 2, legs.shape[-1])
    return xp.flip(pairs, axis=-2).reshape(legs.shape)


def _fault(library: MotionLibrary) -> str:
    """Return, in words, what keeps trajectories from being periodic trots of ascending
    speeds; empty if nothing does."""
    speeds, durations, q = library.speeds, library.durations, library.q
    if not (speeds[0] > 0 and np.all(np.diff(speeds) > 0)):
        return "holds speeds that do not ascend from above 0"
    if not np.all(durations >= SHORTEST):
        return f"holds durations that are not above {SHORTEST:g} s"
    again = np.concatenate(
        [q[:, 0, 0, :TRUNK], mirror(by_leg(q[:, 0, 0, TRUNK:])).reshape(-1, 12)],
        axis=-1,
    )
    again[:, 0] += speeds * durations.sum(axis=1)
    for where, gap in (
        ("at lift-off", q[:, 1, 0] - q[:, 0, -1]),
        ("after half a cycle", q[:, 1, -1] - again),
    ):
        worst = np.abs(gap).max(axis=1)
        if worst.max() > PERIODIC:
            return f"holds a motion at {speeds[worst.argmax()]:g} m/s whose ends do not meet {where}"
    return ""
