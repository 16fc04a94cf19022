"""Joint angles with the signs and zeros of a bundle, and with those of the robot's own
model."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from bp2_rl.base.errors import require_one_of
from bp2_rl.robot.conventions import MOTOR_NAMES

from .contents import Settings


@dataclasses.dataclass(frozen=True)
class JointFrame:
    """The signs and zeros that a caller's joint angles have: the bundle's angle is sign
    x the caller's + offset."""

    names: Sequence[str]
    sign: np.ndarray  # (12)
    offset: np.ndarray  # (2 12), of angles (rad) and of speeds, which have none

    @classmethod
    def of(cls, settings: Settings, convention: str) -> "JointFrame":
        """Return the frame of a `convention`, "bundle" or "model", by the content of
        `deploy.json`.

        Raises:
            UserError: there is no such convention.
        """
        require_one_of("convention", convention, ("bundle", "model"))
        if convention == "bundle":
            return cls(MOTOR_NAMES, np.ones(12), np.zeros((2, 12)))
        names, sign, offset = (
            [one[key] for one in settings["model_joints"]]
            for key in ("name", "sign", "offset")
        )
        return cls(names, np.array(sign), np.stack((offset, np.zeros(12))))

    def inward(self, joints: np.ndarray) -> np.ndarray:
        """Return a caller's joint angles and speeds (2 12) as the bundle has them."""
        return self.sign * joints + self.offset

    def outward(self, joints: np.ndarray) -> np.ndarray:
        """Return the bundle's joint angles and speeds (2 12) as the caller has them."""
        return self.sign * (joints - self.offset)
