"""Left and right: what observations and actions become for the robot's mirror image,
half a cycle on.

A trot repeats itself after half a cycle with left and right exchanged. So the mirror
image of BP2 under the mirrored command, seen half a cycle later, is BP2 again, and what
is right for the one is right, mirrored, for the other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.env.observations import Entry
from bp2_rl.robot.conventions import MIRRORED


class Mirror(NamedTuple):
    """A linear reflection: entry i of the image is `sign[i]` times entry `order[i]`.
    Its square is the identity."""

    order: tuple[int, ...]
    sign: tuple[int, ...]

    def parities(
        self,
    ) -> tuple[Float[np.ndarray, "size even"], Float[np.ndarray, "size odd"]]:
        """Return orthonormal bases of what the reflection keeps, and of what it turns
        into its opposite."""
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
    """Return the mirror of an array that has `len(sign)` numbers a leg."""
    width = len(sign)
    return Mirror(
        tuple(width * leg + i for leg in MIRRORED for i in range(width)),
        sign * len(MIRRORED),
    )


VECTOR, ROTATION, COMMAND = _signs(1, -1, 1), _signs(-1, 1, -1), _signs(1, -1, -1)
SCALAR, PHASE, LEG, JOINTS, MOTORS = (
    _signs(1),
    _signs(-1, -1),
    _by_leg(1),
    _by_leg(-1, 1, 1),
    _by_leg(1, 1, 1),
)

ACTION = JOINTS
_ENTRIES = {
    "command": COMMAND,
    "phase": PHASE,
    "joint_position": JOINTS,
    "joint_velocity": JOINTS,
    "up": VECTOR,
    "angular_velocity": ROTATION,
    "last_action": ACTION,
    "velocity": VECTOR,
    "height": SCALAR,
    "spring_compression": LEG,
    "spring_velocity": LEG,
    "foot_contact": LEG,
    "target_command": COMMAND,
    "friction": SCALAR,
    "trunk_mass": SCALAR,
    "com_offset": VECTOR,
    "strength": MOTORS,
    "latency": SCALAR,
    "tracking_error": COMMAND,
}
"""The mirror of every entry of an observation."""


def mirror_of(layout: Sequence[Entry]) -> Mirror:
    """Return the reflection of the observation that a layout describes."""
    order, sign = [], []
    for entry in layout:
        part = _ENTRIES[entry.name.partition("@")[0]]
        order += [len(sign) + i for i in part.order]
        sign += part.sign
    return Mirror(tuple(order), tuple(sign))
