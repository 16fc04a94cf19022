"""Settings of the two gaits that a reference motion can have."""

import dataclasses
import hashlib
import math
from pathlib import Path
from typing import Annotated

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Bounded, Share, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import LARGEST_ARRAYS, BadFileError, read_bytes
from bp2_rl.robot import bp2, kinematics

LIBRARIES = "bp2_trot", "bp2_trot_slow"
"""Shipped libraries in assets/reference_motions: the optimiser's, and one whose slow
trots have no flight."""
REMEDY = "build it again with `bp2 trajopt library build`"
Size = Annotated[float, Within(0.01, 10.0)]


@dataclasses.dataclass(frozen=True)
class KinematicConfig:
    """The kinematic gait's settings. Lengths are for BP2's own leg; they scale with the
    robot's."""

    # m, of the trunk's centre above the ground: mean over a stride
    height: Size = bp2.STANDING_HEIGHT
    slow_stance: Size = 0.22  # s, stance time at low speed
    sweep: Size = 0.70  # m, path of a foot during stance at high speed
    swing_time: Size = 0.28  # s
    flexion: Annotated[float, Within(0.0, 1.5)] = 0.8
    """rad, knee flexion in mid-swing beyond the mean of lift-off and touchdown"""
    follow_through: Annotated[int, Within(2, 100)] = 7
    """n: joints shed the speed of lift-off as (1 - s)^n, s in [0, 1] over the swing"""
    # shape of the force in stance: 1 a spring's bounce (parabola), 0 no rate at
    # touchdown
    landing: Share = 0.8
    stepping_speed: Annotated[float, Within(0.001, 100.0)] = 0.2
    """m/s, the scale on which stepping grows out of standing"""

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field."""
        check_bounds(self, "gait.")
        longest = kinematics.reach()[1]
        if math.hypot(self.sweep / 2, self.height) > longest:
            raise UserError(
                f"gait.height ({self.height}) and gait.sweep ({self.sweep}) exceed the legs' reach of {longest:.3f} m"
            )


@dataclasses.dataclass(frozen=True)
class CollocationConfig(Bounded, path="library."):
    """The motion library, and the speed below which its steps shrink."""

    # of the library, or the name of a shipped one: bp2_trot, bp2_trot_slow
    path: str = LIBRARIES[0]
    stepping_speed: Annotated[float, Within(0.001, 100.0)] = 0.4
    """m/s, speed below which steps shrink, to zero in a stand"""

    @property
    def file(self) -> Path:
        """Path of the library's file."""
        return (
            asset_path(f"reference_motions/{self.path}.npz")
            if self.path in LIBRARIES
            else Path(self.path)
        )

    @property
    def sha256(self) -> str:
        """Checksum of the library's file, by which a policy knows the motion it was
        trained on.

        Raises:
            UserError: the file cannot be read.
        """
        try:
            return hashlib.sha256(read_bytes(self.file, LARGEST_ARRAYS)).hexdigest()
        except BadFileError as error:
            raise UserError(f"motion library {error}; {REMEDY}") from error
