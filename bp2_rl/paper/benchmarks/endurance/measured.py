"""What the endurance benchmark measures."""

import dataclasses

from bp2_rl.paper.benchmarks.endurance.calibration import CalibratedMotor, straightest
from bp2_rl.paper.benchmarks.endurance.heating import EnduranceResult, HeatingCourse
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import conventions


@dataclasses.dataclass(frozen=True)
class HeldSpeed:
    """One speed, held to the end."""

    # with heat as fast as motion; None in the quick version
    full: EnduranceResult | None
    accelerated: EnduranceResult  # with heat faster than motion
    limitless: (
        EnduranceResult | None
    )  # accelerated, and windings may get as hot as they will; None in the quick version
    # s to the limit, by the heat of the cold gait alone; None: never within an hour
    by_cold_gait: float | None
    course: HeatingCourse  # of the full run where there is one

    @property
    def result(self) -> EnduranceResult:
        """What counts."""
        return self.full or self.accelerated

    @property
    def motor(self) -> int:
        """The one that ends it: the hottest, or, where heat does not, the one that is
        on its envelope most."""
        by_heat = self.result.cause in ("winding", "none")
        return _greatest(
            self.result.winding if by_heat else self.result.last.on_envelope
        )

    @property
    def hottest(self) -> int:
        """The motor with the hottest winding at the end."""
        return _greatest(self.result.winding)

    @property
    def disagreement(self) -> float | None:
        """The accelerated run's time over the full one's, less 1."""
        return (
            self.accelerated.seconds / self.full.seconds - 1.0
            if self.full and self.full.seconds > 0.0
            else None
        )


@dataclasses.dataclass(frozen=True)
class EnduranceAtSpeed:
    """One speed, by the heat of the cold gait alone."""

    commanded_speed: float  # m/s
    speed: float  # m/s, made good
    motor: str  # that heats most
    heat: float  # W, of its winding at T_0
    torque: float  # Nm, root mean square
    seconds: float | None  # to the limit; None: never within an hour
    fell: bool


@dataclasses.dataclass(frozen=True)
class RandomRobot:
    """A robot drawn at random as in training, run at the paper's speed with the motor
    of the designed robot."""

    friction: float  # of its feet
    mass: float  # factor on every body
    strength: float  # factor on the peak torque
    latency: float  # s
    ran: EnduranceAtSpeed


@dataclasses.dataclass(frozen=True)
class EnduranceMetrics:
    """All of it."""

    heat: MotorHeat  # as calibrated
    is_input: bool  # whether the heating rate at the paper's speed was put in
    # W, of the hottest rear hip's winding at T_0, at the paper's speed: what it was
    # calibrated on
    cold_heat: float
    held: tuple[HeldSpeed, ...]  # the paper's speed, then the top
    speeds: tuple[EnduranceAtSpeed, ...]
    drawn: tuple[RandomRobot, ...]  # none in the quick version
    family: tuple[CalibratedMotor, ...]  # of motors that heat at the paper's rate

    @property
    def drawn_times(self) -> tuple[float, ...]:
        """s to the limit of the drawn robots that did not fall, in order."""
        return tuple(
            sorted(
                one.ran.seconds
                for one in self.drawn
                if one.ran.seconds is not None and not one.ran.fell
            )
        )

    @property
    def straightest(self) -> CalibratedMotor:
        """The one of the family that heats most nearly at a constant rate."""
        return straightest(self.family)


def joint_of(motor: int) -> str:
    """In words: `rear right hip`."""
    leg, joint = conventions.MOTOR_NAMES[motor].split("_")
    place = {"F": "front", "R": "rear"}[leg[0]] + {"R": " right", "L": " left"}[leg[1]]
    return f"{place} {joint}"


def _greatest(values: tuple[float, ...]) -> int:
    return max(range(len(values)), key=values.__getitem__)
