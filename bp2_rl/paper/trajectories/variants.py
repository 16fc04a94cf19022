"""The variants of BP2 whose greatest speeds are compared in the plane: one thing about
the robot, or one of its losses, is changed at a time."""

import dataclasses
from typing import NamedTuple

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.problem import Problem
from bp2_rl.robot.hardware import IDEAL, differing, with_parts

HARDWARE_CHANGES: dict[str, dict[str, float]] = {
    "BP2 as specified": {},
    "straight-line envelope (corner at 0)": {"corner_speed": 0.0},
    "corner at 18 rad/s": {"corner_speed": 18.0},
    "peak torque 100 Nm": {"peak_torque": 100.0},
    "rotor inertia halved": {"rotor_inertia": 1e-4},
    "rotor inertia doubled": {"rotor_inertia": 4e-4},
    "friction 0.6": {"friction": 0.6},
    "friction 1.2": {"friction": 1.2},
    "stops half as stiff": {"spring_stop_stiffness": 15e3, "rebound_stiffness": 15e3},
    "spring travel 0.10 m": {"spring_travel": 0.10},
}
KNOWN_PARTS = (
    *(
        "air",
        "gears",
        "joint friction",
        "spring slides",
        "bus power",
        "bus sag",
        "braking limit",
        "rebound stop",
    ),
    "ground friction",
)
"""The parts of a robot that the model in the plane knows."""


class ProblemVariant(NamedTuple):
    """A problem, and the name of the variant that it is compared with."""

    base: str
    problem: Problem


def hardware_variants(problem: Problem) -> dict[str, ProblemVariant]:
    """Return the problem, and variants with one thing about the robot changed, by
    name."""
    problems = {name: problem.on(**change) for name, change in HARDWARE_CHANGES.items()}
    faster = dataclasses.replace(problem, speed_margin=2.0)
    problems |= {"joints faster than no-load": faster}
    base = next(iter(problems))
    return {name: ProblemVariant(base, one) for name, one in problems.items()}


def loss_variants(problem: Problem) -> dict[str, ProblemVariant]:
    """Return the problem by name: on the robot without losses, with each loss alone,
    with all, and with all but one.

    Raises:
        UserError: the robot loses nothing that the model knows.
    """
    robot = problem.hardware
    lost = [part for part in differing(robot, IDEAL) if part in KNOWN_PARTS]
    if not lost:
        raise UserError(
            "--losses: this robot has none; choose --robot built, or set some of --hardware.losses"
        )
    ideal = with_parts(robot, IDEAL, KNOWN_PARTS)
    variants = {
        "ideal": ("ideal", ideal),
        **{
            f"ideal + {part}": ("ideal", with_parts(ideal, robot, [part]))
            for part in lost
        },
        "built": ("ideal", robot),
        **{
            f"built - {part}": ("built", with_parts(robot, IDEAL, [part]))
            for part in lost
        },
    }
    return {
        name: ProblemVariant(base, dataclasses.replace(problem, hardware=variant))
        for name, (base, variant) in variants.items()
    }
