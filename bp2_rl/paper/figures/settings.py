"""Settings of the figures, read before anything slow is imported."""

import dataclasses
from pathlib import Path
from typing import Annotated

from bp2_rl.base.bounds import Bounded, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot.hardware import RobotName


@dataclasses.dataclass(frozen=True)
class ScalingFigureSettings:
    """Figure of greatest speeds over body mass, and of motor demands (paper, Fig. 1).

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
    """Figure of speed over distance, BP2 beside athletes (paper, Fig. 6 B-D, Table S2).

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
    """Figure of the modelled robot with dimensions (paper, Figs. 2, S1, Table S3)."""

    robot: RobotName = "built"


@dataclasses.dataclass(frozen=True)
class RewardsFigureSettings(Bounded, path="--"):
    """Figure of the weight of velocity tracking over speed (paper, Table S4)."""

    speed: Annotated[float, Within(0.1, 100.0)] = 15.5
    """the greatest command, m/s"""


@dataclasses.dataclass(frozen=True)
class StridesFigureSettings:
    """Figure of three gait cycles of a run as keyframes (paper, Fig. 5 A)."""

    runs: tuple[Path, ...] = ()
    """folder of a report of eval.py --benchmark topspeed"""


@dataclasses.dataclass(frozen=True)
class OperatingFigureSettings:
    """Figure of hip and knee torque over speed, three gait cycles (paper, Fig. 5 E)."""

    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, one a speed; comparisons are
    of the first"""


@dataclasses.dataclass(frozen=True)
class IdentifiabilityFigureSettings(Bounded, path="--"):
    """Figure of the posterior of BP2's unknown parameters, and of its predictions.

    Takes some minutes, and the extra `posterior`.
    """

    runs: Path | None = None
    """runs.csv of `bp2 paper posterior`; by default the shipped file"""
    draws: Annotated[int, Within(100, 10**7)] = 40_000
    """number of samples from the prior"""


@dataclasses.dataclass(frozen=True)
class BindingFigureSettings:
    """Figure of the limits that bind optimised trots, beside policies' gaits.

    The figure also shows the speed gained by raising each limit. It takes some minutes,
    because trajectories are solved.
    """

    speeds: tuple[Annotated[float, Within(0.5, 30.0)], ...] = (10.0, 13.0, 15.0, 17.0)
    """speeds of the trajectories, m/s"""
    robot: RobotName = "ideal"
    """robot of the trajectories and of the reports"""
    intervals: Annotated[int, Within(4, 100)] = 8
    """of each segment"""
    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, one for each speed"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        if not self.speeds or sorted(set(self.speeds)) != list(self.speeds):
            raise UserError(
                "--speeds: name the slowest first and each once, as each solve starts from the one before"
            )
