"""What the smaller figures may be told; read before anything slow is imported."""

import dataclasses
from pathlib import Path
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.robot.specs import RobotName


@dataclasses.dataclass(frozen=True)
class RobotSettings:
    """Draw the robot as it is modelled, with its dimensions (paper, Fig. 2, Fig. S1, Table S3)."""

    robot: RobotName = "built"


@dataclasses.dataclass(frozen=True)
class RewardsSettings:
    """Draw how the weights of imitation and of tracking go with the commanded speed (paper, Table S4)."""

    speed: Annotated[float, Within(0.1, 100.0)] = 15.5
    """the greatest command, m/s"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")


@dataclasses.dataclass(frozen=True)
class StridesSettings:
    """Draw three cycles of a run's gait as keyframes (paper, Fig. 5 A)."""

    runs: tuple[Path, ...] = ()
    """folder of a report of eval.py --benchmark topspeed"""


@dataclasses.dataclass(frozen=True)
class OperatingSettings:
    """Draw where hips and knees work, torque over speed, in three cycles of each run (paper, Fig. 5 E)."""

    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, one a speed; comparisons are of the first"""


@dataclasses.dataclass(frozen=True)
class LearningSettings:
    """Draw how soon the policies of trainings run, over control steps and over time, as their judge saw it."""

    runs: tuple[Path, ...] = ()
    """folders of trainings, each with a judge (--run.judged)"""
