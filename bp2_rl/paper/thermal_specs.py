"""Thermal parameters of a motor, with their sources."""

import dataclasses
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError

AMBIENT = 25.0  # C, ASSUMED: where 86 s at 1.8 K/s end at the limit of class H


@dataclasses.dataclass(frozen=True)
class MotorHeat:
    """Thermal model of a motor as two lumps, winding and case; all twelve motors
    alike."""

    # J/K, ASSUMED: 0.25 kg of copper at 385 J/kg/K
    winding_capacity: Annotated[float, Within(10.0, 1e6)] = 96.25
    winding_to_case: Annotated[float, Within(0.05, 1e6)] | None = None
    """K/W; by default such that a rear hip heats at the paper's 1.8 K/s over 86 s in
    the gait at 10.74 m/s"""
    case_capacity: Annotated[float, Within(10.0, 1e6)] = 350.0
    """J/K, ASSUMED: 0.75 kg of stator iron, magnets and housing at 470 J/kg/K"""
    # K/W, ASSUMED: 0.03 m2 in a wind of 10 m/s, 35 W/m2/K
    case_to_air: Annotated[float, Within(0.1, 1e6)] = 1.0
    # C; the motors are as warm when the clock starts
    air: Annotated[float, Within(-50.0, 100.0)] = AMBIENT
    limit: Annotated[float, Within(0.0, 1000.0)] = 180.0
    """C, at which the run ends for any winding: insulation class H of IEC 60085"""
    copper_growth: Annotated[float, Within(0.0, 0.01)] = 3.9e-3
    """1/K, of the windings' resistance: annealed copper at 20 C, IEC 60028"""
    magnet_loss: Annotated[float, Within(0.0, 0.002)] = 1.1e-3
    """1/K, of the magnets' flux, ASSUMED: NdFeB, remanence's reversible loss"""
    iron_loss: Annotated[float, Within(0.0, 1e4)] = 0.0  # W, in the case

    def __post_init__(self) -> None:
        """Refuse parameters out of bounds, and a limit that is no warmer than the
        air."""
        check_bounds(self, "--heat.")
        if self.limit <= self.air:
            raise UserError(
                f"--heat.limit ({self.limit:g} C) must be above --heat.air ({self.air:g} C)"
            )

    @property
    def to_case(self) -> float:
        """Thermal resistance from winding to case, K/W; 1 until it is calibrated."""
        return self.winding_to_case or 1.0
