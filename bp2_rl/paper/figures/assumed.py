"""What had to be assumed and how far off it may be, each with the way in which the
models take it."""

import dataclasses
import math
from typing import cast

from bp2_rl.optimiser.problem import CostWeights, Problem
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.paper.trajectories.shadow_prices import LIMITS, LOSSES, Change
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import BUILT

BODY_WEIGHT = CostWeights().force  # N


@dataclasses.dataclass(frozen=True)
class Assumed:
    """A positive number; its range is what published machines or the paper's silence
    leave, ASSUMED like itself."""

    name: str
    unit: str
    low: float
    value: float
    high: float
    change: Change | None = None  # of a problem; None: of the motors' heat alone
    heat: str = ""  # field of `MotorHeat`

    @property
    def reach(self) -> float:
        """Half the range, as a change of the number's logarithm: one unit of the
        analysis."""
        return 0.5 * math.log(self.high / self.low)


def _force_scale(problem: Problem, factor: float) -> Problem:
    weights = dataclasses.replace(problem.weights, force=factor * problem.weights.force)
    return dataclasses.replace(problem, weights=weights)


def _foot_radius(problem: Problem, factor: float) -> Problem:
    return dataclasses.replace(problem, foot_radius=factor * bp2.FOOT_RADIUS)


_LOSSES, _MOTOR = BUILT.losses, MotorHeat()
MECHANICAL = (
    Assumed("F bar", "N", BODY_WEIGHT, BODY_WEIGHT, 3.0 * BODY_WEIGHT, _force_scale),
    # the text, and Table S1
    Assumed("peak torque", "Nm", 100.0, bp2.PEAK_TORQUE, 120.0, LIMITS["peak torque"]),
    Assumed(
        "corner speed",
        "rad/s",
        bp2.CORNER_SPEED,
        bp2.CORNER_SPEED,
        18.0,
        LIMITS["corner speed"],
    ),
    Assumed(
        "rotor inertia", "kg m2", 1e-4, bp2.ROTOR_INERTIA, 4e-4, LIMITS["rotor inertia"]
    ),
    # for the spring's rest length
    Assumed("leg length", "m", 0.32, bp2.THIGH_LENGTH, 0.38, LIMITS["leg length"]),
    Assumed(
        "spring travel", "m", 0.10, bp2.SPRING_TRAVEL, 0.15, LIMITS["spring travel"]
    ),
    Assumed(
        "stops' stiffness",
        "N/m",
        15e3,
        bp2.SPRING_STOP_STIFFNESS,
        60e3,
        LIMITS["stops' stiffness"],
    ),
    Assumed("foot radius", "m", 0.01, bp2.FOOT_RADIUS, 0.04, _foot_radius),
    Assumed("friction", "-", 0.6, bp2.FOOT_FRICTION, 1.2, LIMITS["friction"]),
)
"""Of the robot and of the objective."""

LOST = tuple(
    # BP2's joints are alike
    Assumed(name, unit, low, cast(float, value), high, LOSSES[name])
    for name, unit, low, value, high in (
        ("drag area", "m2", 0.1, _LOSSES.drag_area, 0.3),
        ("gear loss", "-", 0.03, 1.0 - _LOSSES.gear_efficiency, 0.15),
        ("joint friction", "Nm", 1.0, _LOSSES.joint_friction, 4.0),
        ("joint viscosity", "Nm s/rad", 0.025, _LOSSES.joint_viscosity, 0.1),
        ("slide friction", "N", 10.0, _LOSSES.spring_friction, 40.0),
        ("bus sag", "1/kW", 0.00625, _LOSSES.bus_sag, 0.025),
        ("bus power", "W", 6e3, _LOSSES.bus_power_out, 10e3),
    )
)
"""What a machine loses; the paper's analysis has none of it."""

HEAT = tuple(
    Assumed(name, unit, low, value, high, heat=field)
    for name, unit, low, value, high, field in (
        (
            "winding's capacity",
            "J/K",
            50.0,
            _MOTOR.winding_capacity,
            152.0,
            "winding_capacity",
        ),
        # the straightest rise has 1.5 K/W
        ("winding to case", "K/W", 0.5, 1.5, 4.5, "winding_to_case"),
        ("case's capacity", "J/K", 200.0, _MOTOR.case_capacity, 600.0, "case_capacity"),
        ("case to air", "K/W", 0.5, _MOTOR.case_to_air, 2.0, "case_to_air"),
        ("magnets' loss", "1/K", 0.9e-3, _MOTOR.magnet_loss, 1.2e-3, "magnet_loss"),
    )
)
"""Of the motors' heat."""

ASSUMED = (*MECHANICAL, *LOST, *HEAT)
