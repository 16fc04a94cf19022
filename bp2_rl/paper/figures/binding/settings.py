"""What the figure of binding limits may be told."""

import dataclasses
from pathlib import Path
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot.specs import RobotName


@dataclasses.dataclass(frozen=True)
class BindingSettings:
    """Draw which limits hold the optimiser's trots back at each speed and what a little more of each would bring, and
    how far the policy's gait is from the optimiser's at the same speed on the same robot.

    Takes some minutes: trajectories are solved.
    """

    speeds: tuple[Annotated[float, Within(0.5, 30.0)], ...] = (10.0, 13.0, 15.0, 17.0)
    """m/s; one that has no trajectory is said to have none"""
    robot: RobotName = "ideal"
    """of the trajectories; reports have to be of it, too"""
    intervals: Annotated[int, Within(4, 100)] = 8
    """of each segment"""
    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, one a speed: what the policy does there"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        if not self.speeds or sorted(set(self.speeds)) != list(self.speeds):
            raise UserError("--speeds: name the slowest first and each once, as each solve starts from the one before")
