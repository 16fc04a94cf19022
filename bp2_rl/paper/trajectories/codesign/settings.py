"""What co-design looks for, and within which bounds."""

import dataclasses
import math
from collections.abc import Iterable
from typing import Annotated, Literal, get_args

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.problem import CostWeights, Intervals, Problem, Starts
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

Parameter = Literal["gear_ratio", "leg_length", "spring_stiffness"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
Others = Literal["BP2", "free"]
UNITS: dict[Parameter, str] = {
    "gear_ratio": "1",
    "leg_length": "m",
    "spring_stiffness": "N/m",
}
AT_BOUND = 1e-3  # of a parameter's range: closer than this, the bound made the value


@dataclasses.dataclass(frozen=True)
class DesignBounds:
    """Least and greatest values of the parameters; the shortest leg holds shank, toe
    and the spring's travel."""

    gear_ratio: tuple[float, float] = (5.0, 14.0)
    # m; see CodesignSettings
    leg_length: tuple[float, float] = (0.29, bp2.HIP_FORE_AFT)
    spring_stiffness: tuple[float, float] = (2500.0, 15000.0)  # N/m

    def __post_init__(self) -> None:
        """Refuse bounds between which there is no design, or one that cannot be
        built."""
        for name in PARAMETERS:
            low, high = getattr(self, name)
            if not (math.isfinite(low) and math.isfinite(high) and 0.0 < low < high):
                raise UserError(
                    f"bounds.{name} must be two numbers with 0 < low < high, got {low:g} and {high:g}"
                )
            for value, ends in ((low, "begins too low"), (high, "ends too high")):
                try:
                    IDEAL.changed(**{name: value})
                except UserError as error:
                    raise UserError(f"bounds.{name} {ends}: {error}") from error

    def of(self, names: Iterable[Parameter]) -> dict[str, tuple[float, float]]:
        """The bounds of some parameters."""
        return {name: getattr(self, name) for name in names}

    def touched(
        self, hardware: HardwareSpec, names: Iterable[Parameter] = PARAMETERS
    ) -> tuple[str, ...]:
        """Which of the parameters the hardware has at a bound."""
        return tuple(
            name
            for name, (low, high) in self.of(names).items()
            if min(hardware.parameter(name) - low, high - hardware.parameter(name))
            <= AT_BOUND * (high - low)
        )


@dataclasses.dataclass(frozen=True)
class CodesignSettings(Bounded):
    """What is optimised, within which bounds, and how hard it is looked for.

    Cost and dynamics alone do not decide the design: a leg weighs nothing more for
    being longer, long legs move their joints slower, and slow joints allow any gear.
    Unbounded, length and gear run away together, to 0.45 m and 14. What holds them here
    is stated, and ASSUMED:

    - Leg length up to 0.35 m, half the distance between the hips: then a fore and a
      hind thigh cannot meet. The length found is this bound; at BP2's gear legs of 0.37
      to 0.42 m are cheaper by 2 %.
    - Joint speeds up to 0.6 of the no-load speed. The same motors run 13.2 m/s, and do
      so on a battery that may sag to 0.8 of its voltage: 10 / 13.2 x 0.8 = 0.61. This
      margin sets the gear, all but in proportion: 7.2 for 0.5, 8.5 for 0.6, 9.2 for
      0.65, 11.2 for 0.8, 13.7 for 1.
    - F bar of three body weights, the largest force of a foot at 10 m/s; so forces,
      like torques, are shares of their greatest. It sets the stiffness: 3.6, 4.7, 6.1
      and 6.1 kN/m for 1, 2, 3 and 4 body weights.
    """

    problem: Problem = Problem(
        intervals=8,
        speed_margin=0.6,
        weights=CostWeights(force=round(3.0 * bp2.TOTAL_MASS * conventions.GRAVITY)),
    )
    bounds: DesignBounds = DesignBounds()
    # Where scans go; free parameters keep to `bounds`. Behind higher gears the speed
    # margin leaves no gait.
    scanned: DesignBounds = DesignBounds(
        gear_ratio=(5.5, 10.0), leg_length=(0.29, 0.45)
    )
    starts: Starts = 4  # of the optimum
    # of every other setting, besides the optimum itself
    starts_elsewhere: Annotated[int, Within(0, 1000)] = 1
    grid: Annotated[int, Within(3, 1000)] = 7  # values in a scan
    # on which the optimum is solved again, one after another
    confirm: tuple[Intervals, ...] = (16, 24, 32, 48)
