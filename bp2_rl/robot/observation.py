"""The terms of a policy's observation: each with its size, its mirror image and the
way it is read.

`OBSERVATION_TERMS` is the one list from which training (JAX) and the robot's own computer (NumPy)
make the observation, and networks learn what left and right are. The module imports
neither JAX nor jaxtyping.

A trot repeats itself after half a cycle with left and right exchanged. So the mirror
image of a robot under the mirrored command, seen half a cycle later, is that robot
again, and what is right for the one is right, mirrored, for the other.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from bp2_rl.base.arrays import Array
from bp2_rl.robot.conventions import MIRRORED

Source = TypeVar("Source")


class Mirror(NamedTuple):
    """A linear reflection: number i of the image is `sign[i]` times number `order[i]`.
    Its square is the identity."""

    order: tuple[int, ...]
    sign: tuple[int, ...]

    @classmethod
    def joined(cls, parts: Sequence["Mirror"]) -> "Mirror":
        """Return the mirror of a vector that joins parts with these mirrors."""
        order, sign = [], []
        for part in parts:
            order += [len(sign) + i for i in part.order]
            sign += part.sign
        return cls(tuple(order), tuple(sign))

    def parities(self) -> tuple[np.ndarray, np.ndarray]:
        """Return orthonormal bases of the vectors that the reflection keeps ("size
        even") and of those that it negates ("size odd")."""
        even, odd = [], []
        unit = np.eye(len(self.order))
        for i, (j, sign) in enumerate(zip(self.order, self.sign, strict=True)):
            if i == j:
                (even if sign > 0 else odd).append(unit[i])
            elif i < j:
                even.append((unit[i] + sign * unit[j]) / np.sqrt(2.0))
                odd.append((unit[i] - sign * unit[j]) / np.sqrt(2.0))
        size = len(self.order)
        return np.reshape(even, (-1, size)).T, np.reshape(odd, (-1, size)).T


def _signs(*sign: int) -> Mirror:
    return Mirror(tuple(range(len(sign))), sign)


def _by_leg(*sign: int) -> Mirror:
    """Return the mirror of an array with `len(sign)` numbers for each leg."""
    width = len(sign)
    return Mirror(
        tuple(width * leg + i for leg in MIRRORED for i in range(width)),
        sign * len(MIRRORED),
    )


VECTOR, ROTATION, COMMAND = _signs(1, -1, 1), _signs(-1, 1, -1), _signs(1, -1, -1)
SCALAR = _signs(1)
CLOCK = _signs(-1, -1)
LEG = _by_leg(1)
JOINTS = _by_leg(-1, 1, 1)
MOTORS = _by_leg(1, 1, 1)


@dataclasses.dataclass(frozen=True)
class ObservationTerm(Generic[Source]):
    """One named part of an observation vector."""

    name: str
    mirror: Mirror
    read: Callable[[Source], Array]
    """reads the part's numbers from the source of the observation"""

    @property
    def size(self) -> int:
        """Return the number of numbers in the part."""
        return len(self.mirror.sign)


class ObservationInputs(NamedTuple):
    """Inputs of a policy's observation at one control step."""

    command: Array  # (3) m/s, m/s, rad/s: the command that the policy observes
    clock: Array  # (2) sine and cosine of the phase, 0 at rest
    joint_position: Array  # (12) rad
    joint_velocity: Array  # (12) rad/s
    up: Array  # (3) the world's vertical in the body frame
    angular_velocity: Array  # (3) rad/s, body frame
    last_action: Array  # (12)
    stand: Array  # (12) rad, the standing pose


OBSERVATION_TERMS: tuple[ObservationTerm[ObservationInputs], ...] = (
    ObservationTerm("command", COMMAND, lambda now: now.command),
    ObservationTerm("phase", CLOCK, lambda now: now.clock),
    ObservationTerm(
        "joint_position", JOINTS, lambda now: now.joint_position - now.stand
    ),
    ObservationTerm("joint_velocity", JOINTS, lambda now: now.joint_velocity),
    ObservationTerm("up", VECTOR, lambda now: now.up),
    ObservationTerm("angular_velocity", ROTATION, lambda now: now.angular_velocity),
    ObservationTerm("last_action", JOINTS, lambda now: now.last_action),
)
"""The policy's observation, in order: what the paper lists (section RL training) plus
the last action."""
