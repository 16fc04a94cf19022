"""Settings of the figures, read before anything slow is imported."""

import dataclasses
from pathlib import Path
from typing import Annotated

from bp2_rl.base.bounds import Bounded, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot.hardware import RobotName


@dataclasses.dataclass(frozen=True)
class ScalingFigureSettings:
    """Draw greatest speed over body mass, and what is asked of the motors (paper, Fig.
    1 and its inset).

    Shown are the robots of the paper's Table S1, the law of animals, and the policy
    that ships, as its card has it.
    """

    mammals: Path | None = None
    """a table of mammals, CSV with the columns: species,mass [kg],top speed [km/h]"""
    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, in place of the policy that
    ships"""


@dataclasses.dataclass(frozen=True)
class RaceFigureSettings:
    """Draw speed over distance of BP2 and of athletes, their starts and their times
    (paper, Fig. 6 B-D, Table S2).

    Shown are Bolt's splits, what the paper says of the others, and the runs of
    policies.
    """

    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark sprint"""
    athletes: Path | None = None
    """splits of more athletes, CSV with the columns: athlete,distance [m],time
    [s],reaction [s]"""


@dataclasses.dataclass(frozen=True)
class RobotFigureSettings:
    """Draw the robot as it is modelled, with its dimensions (paper, Fig. 2, Fig. S1,
    Table S3)."""

    robot: RobotName = "built"


@dataclasses.dataclass(frozen=True)
class RewardsFigureSettings(Bounded, path="--"):
    """Draw how the weights of imitation and of tracking go with the commanded speed
    (paper, Table S4)."""

    speed: Annotated[float, Within(0.1, 100.0)] = 15.5
    """the greatest command, m/s"""


@dataclasses.dataclass(frozen=True)
class StridesFigureSettings:
    """Draw three cycles of a run's gait as keyframes (paper, Fig. 5 A)."""

    runs: tuple[Path, ...] = ()
    """folder of a report of eval.py --benchmark topspeed"""


@dataclasses.dataclass(frozen=True)
class OperatingFigureSettings:
    """Draw where hips and knees work, torque over speed, in three cycles of every run
    (paper, Fig. 5 E)."""

    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, one a speed; comparisons are
    of the first"""


@dataclasses.dataclass(frozen=True)
class LearningFigureSettings:
    """Draw how soon the policies of trainings run, over control steps and over time, as
    their judge saw it."""

    runs: tuple[Path, ...] = ()
    """folders of trainings, each with a judge (--run.judged)"""


@dataclasses.dataclass(frozen=True)
class WearFigureSettings(Bounded, path="--"):
    """Draw speed over how hard soles land, of policies on the built robot, and whether
    they need strong brakes."""

    policies: tuple[Path, ...] = (Path("built"), Path("gentle"))
    """policies that ship, by name, or of your runs"""
    speed: Annotated[float, Within(0.1, 100.0)] = 15.5
    """what they are told to run, m/s"""


@dataclasses.dataclass(frozen=True)
class IdentifiabilityFigureSettings(Bounded, path="--"):
    """Draw which of the numbers that had to be assumed the paper's own numbers pin
    down, and which nothing does.

    Takes some minutes: trajectories are optimised again with each assumption a little
    larger and smaller.
    """

    model_error: Annotated[float, Within(1e-6, 10.0)] = 0.05
    """relative, by which the model's numbers may be off if every assumption holds;
    rounding in print comes on top"""
    intervals: Annotated[int, Within(4, 100)] = 8
    """of each segment of the trajectories"""
    speed: Annotated[float, Within(2.0, 14.0)] = 10.0
    """m/s, of the trajectory that the paper's Fig. 4 is compared with"""


@dataclasses.dataclass(frozen=True)
class BindingFigureSettings:
    """Draw which limits hold the optimiser's trots back at each speed, and how far a
    policy's gait is from them.

    Shown is, too, what a little more of each limit would bring. Takes some minutes:
    trajectories are solved.
    """

    speeds: tuple[Annotated[float, Within(0.5, 30.0)], ...] = (10.0, 13.0, 15.0, 17.0)
    """m/s; one that has no trajectory is said to have none"""
    robot: RobotName = "ideal"
    """of the trajectories; reports have to be of it, too"""
    intervals: Annotated[int, Within(4, 100)] = 8
    """of each segment"""
    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, one a speed: what the policy
    does there"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        if not self.speeds or sorted(set(self.speeds)) != list(self.speeds):
            raise UserError(
                "--speeds: name the slowest first and each once, as each solve starts from the one before"
            )
