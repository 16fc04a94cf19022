"""Reference motions played back without JAX: which joint angles and speeds belong to a command and a phase.

The laws are those of training. All their numbers come from `reference.npz` and `deploy.json`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bp2_rl.reference.library_law import LibraryLaw
from bp2_rl.reference.trot_law import TrotLaw
from bp2_rl.robot.anatomy import LegGeometry

from .complex_step import differentiate


class Pose(NamedTuple):
    """Joint angles, speeds and torques of the reference motion: FR, FL, RR, RL x abad, hip, knee."""

    position: np.ndarray  # (12) rad
    velocity: np.ndarray  # (12) rad/s
    torque: np.ndarray  # (12) Nm


def load_motion(settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> "Trot | Stand":
    """The motion that `deploy.json` describes in `reference`, of the arrays in `reference.npz`.

    Raises:
        ValueError: a motion of another kind.
    """
    kinds = {"collocation": Trot, "kinematic": Trot, "none": Stand}
    if settings["kind"] not in kinds:
        raise ValueError(f"reference motion {settings['kind']!r}: this controller plays {', '.join(kinds)}")
    return kinds[settings["kind"]](settings, arrays)


class Stand:
    """No gait: one pose, and a phase that goes round at one rate."""

    def __init__(self, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]):
        self._rate = float(settings["phase_rate"])
        self._pose = Pose(arrays["pose"].astype(float), np.zeros(12), np.zeros(12))

    def phase_rate(self, command: Sequence[float]) -> float:
        """Cycles per second."""
        return self._rate

    def stepping(self, command: Sequence[float]) -> float:
        """Return 1 for every command, as `bp2_rl.reference.standing` does."""
        return 1.0

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """Return the standing pose."""
        return self._pose


class Trot:
    """A trot of a library (`library_law`), or the kinematic one (`trot_law`).

    Args:
        settings: `reference` of `deploy.json`: the law's numbers.
        arrays: the law's arrays, and those of `LegGeometry`.
    """

    def __init__(self, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]):
        numbers: dict[str, Any] = {name: array.astype(float) for name, array in arrays.items()}
        legs = LegGeometry(**{name: numbers.pop(name) for name in LegGeometry._fields})
        numbers |= {name: value for name, value in settings.items() if name != "kind"}
        self._law = (LibraryLaw if settings["kind"] == "collocation" else TrotLaw)(legs=legs, **numbers)

    def phase_rate(self, command: Sequence[float]) -> float:
        """Cycles per second at this command (m/s forward, m/s to the left, rad/s)."""
        return float(self._law.phase_rate(np.array(command)))

    def stepping(self, command: Sequence[float]) -> float:
        """0 when standing, 1 on the move."""
        return float(self._law.stepping(np.array(command)))

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """The joints at this command and phase (cycles); the kinematic law knows no torques."""
        cycle, torque = np.array(phase - math.floor(phase)), np.zeros((4, 3))
        if isinstance(self._law, LibraryLaw):
            motion = self._law.motion(np.array(command), cycle, differentiate)
            q, qd, torque[:, 1:] = motion.joints, motion.joint_rates, motion.torque
        else:
            q, qd, _, _ = self._law.joints(np.array(command), cycle, differentiate)
        return Pose(q.reshape(12), qd.reshape(12), torque.reshape(12))
