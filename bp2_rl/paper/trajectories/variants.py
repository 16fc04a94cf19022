"""The variants of BP2 and of its gait that are compared in the plane.

**Gaits.** Is it the trot that limits BP2? A bound is the model of half a robot on a
fore and a hind leg half a cycle apart ("two-leg"), a pronk that on both at once; with
left and right alike the other half does the same. In the plane right and left legs of
one end cannot be told apart, so a pace is a trot with other pairs, a rotary gallop a
transverse one. In a half-bound the fore legs land one after the other, in a gallop the
hind legs, too. What a plane cannot know is roll, and how a pace or a gallop holds it:
greatest speeds are upper bounds.

**Limbs.** Should limbs be light? The paper wants the inertia of limbs used rather than
least, and tries no other legs. Mass moves between trunk and legs, all of it the same.
Inertias go with the masses, so a thigh of twice the mass has twice the inertia about
its end; what legs gain the trunk loses. A trunk of a thousand times its inertia is
guided: it cannot pitch, as if limbs had nothing to shake.

**Hardware and losses.** What does the greatest speed depend on? One thing about the
robot is changed at a time.
"""

import dataclasses
from typing import NamedTuple

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.problem import Gait, Problem
from bp2_rl.robot.hardware import IDEAL, differing, with_parts

GAITS: dict[str, Gait] = {
    "trot (and pace)": "trot",
    "bound": "two-leg",
    "pronk": "pronk",
    "half-bound": "half-bound",
    "gallop": "gallop",
}
LIMBS: dict[str, tuple[str, float]] = {
    f"{what} x {factor:g}": (field, factor)
    for what, field, factors in (
        ("thigh", "thigh_mass", (0.5, 1.5, 2.0)),
        ("toe", "toe_mass", (0.5, 1.5, 2.0)),
        ("trunk", "trunk_inertia", (0.5, 2.0, 1e3)),
    )
    for factor in factors
}
"""Variants of the limbs by name: a field of the hardware, and the factor on its
value."""
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


class LossVariant(NamedTuple):
    """A robot with some of its losses, and the name of the variant it is compared
    with."""

    base: str
    problem: Problem


def gait_variants(problem: Problem) -> dict[str, Problem]:
    """Return the problem in every gait, by the gait's name."""
    return {
        name: dataclasses.replace(problem, gait=gait) for name, gait in GAITS.items()
    }


def limb_variants(problem: Problem) -> dict[str, Problem]:
    """Return the problem, and variants on robots with other limbs, by name."""
    changed = {
        name: problem.on(**{field: factor * problem.hardware.parameter(field)})
        for name, (field, factor) in LIMBS.items()
    }
    return {"as it is": problem, **changed}


def hardware_variants(problem: Problem) -> dict[str, Problem]:
    """Return the problem, and variants with one thing about the robot changed, by
    name."""
    changed = {name: problem.on(**change) for name, change in HARDWARE_CHANGES.items()}
    return {
        **changed,
        "joints faster than no-load": dataclasses.replace(problem, speed_margin=2.0),
    }


def loss_variants(problem: Problem) -> dict[str, LossVariant]:
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
        name: LossVariant(base, dataclasses.replace(problem, hardware=variant))
        for name, (base, variant) in variants.items()
    }
