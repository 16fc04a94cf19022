"""What the figure of identifiability may be told."""

import dataclasses
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds


@dataclasses.dataclass(frozen=True)
class IdentifiabilitySettings:
    """Draw which of the numbers that had to be assumed the paper's own numbers pin down, and which nothing does.

    Takes some minutes: trajectories are optimised again with each assumption a little larger and smaller.
    """

    model_error: Annotated[float, Within(1e-6, 10.0)] = 0.05
    """relative, by which the model's numbers may be off if every assumption holds; rounding in print comes on top"""
    intervals: Annotated[int, Within(4, 100)] = 8
    """of each segment of the trajectories"""
    speed: Annotated[float, Within(2.0, 14.0)] = 10.0
    """m/s, of the trajectory that the paper's Fig. 4 is compared with"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
