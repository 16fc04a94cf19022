"""The robots whose speed limit is studied: rigid quadrupeds from rows of published
numbers, those that ship as files, and variants of BP2.

What nobody publishes follows rules, all ASSUMED.

The plane knows pitch alone, so a link has one published inertia, and the trunk's centre
of mass is midway between the hips. The trunk weighs what the legs leave of the robot's
published mass. Fore and hind legs are alike and bend backwards.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.paper.published import read_robots
from bp2_rl.paper.published_tables import ColumnHeading, read_table
from bp2_rl.robot.anatomy import Anatomy, Inertia, Leg, Link
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import BUILT, HardwareSpec, Losses
from bp2_rl.robot.named import shipped_files
from bp2_rl.robot.robot_file import load_robot, mirrored

TABLE = "scaling/legs.csv"

# Of a robot whose links are not published: about the medians of those that are.
# of the robot's mass, one leg's
ABAD_SHARE, THIGH_SHARE, SHANK_SHARE = 0.042, 0.066, 0.014
THIGH_COM, SHANK_COM = 0.165, 0.5  # of the link's length
# of mass times length squared, about the centre of mass
THIGH_INERTIA, SHANK_INERTIA = 0.12, 0.17
# Of all robots where a cell is empty.
KNEE_BEND = 0.1, 2.7  # rad
CORNER_SHARE = 0.6  # of the no-load speed
ARMATURE = 2e-4  # kg m2 for each Nm of peak torque; those published are 0.6e-4 to 3e-4
# Of all robots.
ABAD_RANGE, HIP_RANGE = (-0.8, 0.8), (-1.6, 3.1)  # rad
STAND = 0.0, 0.8, -1.6  # rad
FRICTION = 0.8  # rubber on dry ground
GEAR_EFFICIENCY = 0.92
# of a hip's peak torque; the latter for each rad/s
JOINT_FRICTION, JOINT_VISCOSITY = 0.01, 6e-4
# length over the distance of the hips, width over their track, height over the length
TRUNK = 0.95, 0.6, 0.25
LEG_RADIUS = 0.07  # of the thigh

LENGTH, SIZE, BEND = Within(1e-3, 10.0), Within(0.0, 10.0), Within(0.0, 3.2)
MASS, TORQUE, SPEED = Within(1e-6, 1e6), Within(1e-3, 1e5), Within(1e-3, 1e4)


@dataclasses.dataclass(frozen=True)
class PublishedLegs:
    """The legs and motors of a robot of Table S1, at the joints; what is not published
    is None."""

    robot: str  # as in Table S1
    # from the middle of the trunk
    fore_aft: Annotated[float, LENGTH, ColumnHeading("hip fore-aft [m]")]
    # of the abduction axis, from the mid-plane
    abad_lateral: Annotated[float, SIZE, ColumnHeading("abad lateral [m]")]
    # of the leg's plane, from the abduction axis
    hip_lateral: Annotated[float, SIZE, ColumnHeading("hip lateral [m]")]
    thigh: Annotated[float, LENGTH, ColumnHeading("thigh [m]")]
    # knee to the centre of the foot
    shank: Annotated[float, LENGTH, ColumnHeading("shank [m]")]
    foot_radius: Annotated[float, LENGTH, ColumnHeading("foot radius [m]")]
    abad_mass: Annotated[float | None, MASS, ColumnHeading("abad mass [kg]")]
    thigh_mass: Annotated[float | None, MASS, ColumnHeading("thigh mass [kg]")]
    # below the hip
    thigh_com: Annotated[float | None, SIZE, ColumnHeading("thigh com [m]")]
    thigh_inertia: Annotated[
        float | None, SIZE, ColumnHeading("thigh inertia [kg m2]")
    ]  # in pitch, about its centre of mass
    shank_mass: Annotated[float | None, MASS, ColumnHeading("shank mass [kg]")]
    # below the knee
    shank_com: Annotated[float | None, SIZE, ColumnHeading("shank com [m]")]
    shank_inertia: Annotated[float | None, SIZE, ColumnHeading("shank inertia [kg m2]")]
    # at the foot's centre, beside the shank's
    foot_mass: Annotated[float, SIZE, ColumnHeading("foot mass [kg]")]
    least_bend: Annotated[float | None, BEND, ColumnHeading("least knee bend [rad]")]
    greatest_bend: Annotated[
        float | None, BEND, ColumnHeading("greatest knee bend [rad]")
    ]
    hip_torque: Annotated[float, TORQUE, ColumnHeading("hip torque [Nm]")]
    knee_torque: Annotated[float, TORQUE, ColumnHeading("knee torque [Nm]")]
    # the knee's in proportion
    corner_speed: Annotated[
        float | None, SPEED, ColumnHeading("hip corner speed [rad/s]")
    ]
    hip_speed: Annotated[float, SPEED, ColumnHeading("hip no-load speed [rad/s]")]
    knee_speed: Annotated[float, SPEED, ColumnHeading("knee no-load speed [rad/s]")]
    hip_armature: Annotated[float | None, SIZE, ColumnHeading("hip armature [kg m2]")]
    knee_armature: Annotated[float | None, SIZE, ColumnHeading("knee armature [kg m2]")]
    source: str


def read_legs() -> tuple[PublishedLegs, ...]:
    """Return the robots of Table S1 whose legs and motors are published."""
    return read_table(asset_path(TABLE), PublishedLegs)


def rigid_robot(legs: PublishedLegs, mass: float) -> HardwareSpec:
    """Return a rigid robot of `mass` kg with legs and motors from a row of published
    numbers.

    Raises:
        UserError: the legs leave the trunk nothing.
    """
    left = _left_leg(legs, mass)
    trunk_mass = mass - len(LEGS) * sum(link.mass for link in left.links)
    if trunk_mass <= 0.0:
        raise UserError(
            f"{legs.robot}: four legs are heavier than its {mass:g} kg; mend assets/{TABLE}"
        )
    length = TRUNK[0] * 2.0 * legs.fore_aft
    width = TRUNK[1] * 2.0 * (legs.abad_lateral + legs.hip_lateral)
    height = TRUNK[2] * length
    hind = dataclasses.replace(left, anchor=(-left.anchor[0], *left.anchor[1:]))
    body = Anatomy.of_parts(
        Link(trunk_mass, (0.0, 0.0, 0.0), _box(trunk_mass, length, width, height)),
        (mirrored(left), left, mirrored(hind), hind),
        (length / 2.0, width / 2.0, height / 2.0),
        name=legs.robot,
        stand=len(LEGS) * STAND,
        thigh_radius=LEG_RADIUS * legs.thigh,
        lower_radius=LEG_RADIUS * legs.thigh,
    )
    hip = legs.hip_torque
    knee = legs.knee_torque
    speeds = (legs.hip_speed, legs.hip_speed, legs.knee_speed)
    corner = (
        CORNER_SHARE
        if legs.corner_speed is None
        else legs.corner_speed / legs.hip_speed
    )
    rotors = (
        _or(legs.hip_armature, ARMATURE * hip),
        _or(legs.knee_armature, ARMATURE * knee),
    )
    abad, thigh, shank = (corner * speed for speed in speeds)
    return HardwareSpec(
        body=body,
        gear_ratio=body.gear_ratio,
        rotor_inertia=(rotors[0], *rotors),
        peak_torque=(hip, hip, knee),
        corner_speed=(abad, thigh, shank),
        no_load_speed=speeds,
        friction=FRICTION,
        losses=Losses(
            gear_efficiency=GEAR_EFFICIENCY,
            joint_friction=JOINT_FRICTION * hip,
            joint_viscosity=JOINT_VISCOSITY * hip,
        ),
    )


def _left_leg(legs: PublishedLegs, mass: float) -> Leg:
    thigh_mass = _or(legs.thigh_mass, THIGH_SHARE * mass)
    shank_mass = _or(legs.shank_mass, SHANK_SHARE * mass)
    abad_mass = _or(legs.abad_mass, ABAD_SHARE * mass)
    thigh_inertia = _or(legs.thigh_inertia, THIGH_INERTIA * thigh_mass * legs.thigh**2)
    shank_inertia = _or(legs.shank_inertia, SHANK_INERTIA * shank_mass * legs.shank**2)
    foot = Link(legs.foot_mass, (0.0, 0.0, -legs.shank), rod(0.0))
    shank = Link(
        shank_mass,
        (0.0, 0.0, -_or(legs.shank_com, SHANK_COM * legs.shank)),
        rod(shank_inertia),
    )
    low = _or(legs.least_bend, KNEE_BEND[0])
    high = _or(legs.greatest_bend, KNEE_BEND[1])
    return Leg(
        anchor=(legs.fore_aft, legs.abad_lateral, 0.0),
        hip=(0.0, legs.hip_lateral, 0.0),
        knee=(0.0, 0.0, -legs.thigh),
        foot=(0.0, 0.0, -legs.shank),
        foot_radius=legs.foot_radius,
        abad=Link(
            abad_mass, (0.0, 0.0, 0.0), _box(abad_mass, *3 * (0.4 * legs.thigh,))
        ),
        thigh=Link(
            thigh_mass,
            (0.0, 0.0, -_or(legs.thigh_com, THIGH_COM * legs.thigh)),
            rod(thigh_inertia),
        ),
        shank=merged(shank, foot, (0.0, 0.0, 0.0)),
        toe=None,
        seat=(0.0, 0.0, 0.0),
        ranges=(ABAD_RANGE, HIP_RANGE, (-high, -low)),
    )


def merged(one: Link, other: Link, at: tuple[float, float, float]) -> Link:
    """Return two links as one in the first one's frame, the other's at `at`, m; they
    hang along z."""
    mass = one.mass + other.mass
    z = one.com[2], at[2] + other.com[2]
    center = (one.mass * z[0] + other.mass * z[1]) / mass
    apart = one.mass * (z[0] - center) ** 2 + other.mass * (z[1] - center) ** 2
    xx, yy, *rest = (a + b for a, b in zip(one.inertia, other.inertia, strict=True))
    zz, xy, xz, yz = rest
    return Link(mass, (0.0, 0.0, center), (xx + apart, yy + apart, zz, xy, xz, yz))


def rod(inertia: float) -> Inertia:
    """Return the inertia of a leg's link that is known in pitch alone, kg m2."""
    return inertia, inertia, 0.2 * inertia, 0.0, 0.0, 0.0


def _box(mass: float, length: float, width: float, height: float) -> Inertia:
    x, y, z = (
        mass * (math.hypot(a, b) ** 2) / 12.0
        for a, b in ((width, height), (length, height), (length, width))
    )
    return x, y, z, 0.0, 0.0, 0.0


def _or(published: float | None, assumed: float) -> float:
    return assumed if published is None else published


# --- Variants of BP2, at equal motors -------------------------------------------------

BP2 = "BP2"
THIGHS = 0.5, 2.0  # times the mass of BP2's


def find_robots() -> dict[str, HardwareSpec]:
    """Return the hardware of all robots whose speed limit is studied, by name in Table
    S1; variants of BP2 come last, and their names begin with BP2."""
    masses = {robot.robot: robot.mass for robot in read_robots()}
    files = {
        robot.name: robot.hardware
        for robot in map(load_robot, shipped_files().values())
    }
    tabled = {legs.robot: rigid_robot(legs, masses[legs.robot]) for legs in read_legs()}
    return files | tabled | bp2_variants(files)


def bp2_variants(others: Mapping[str, HardwareSpec]) -> dict[str, HardwareSpec]:
    """Return the hardware of BP2, with other thighs, with rigid shanks, and on rigid
    legs of other robots, by name."""
    rigid = rigid_shanks(BUILT)
    return {
        BP2: BUILT,
        **{
            f"BP2, thighs x {factor:g}": BUILT.changed(
                thigh_mass=factor * BUILT.bp2.thigh_mass
            )
            for factor in THIGHS
        },
        "BP2, rigid shanks": rigid,
        **{
            f"BP2, rigid legs of {name}": on_legs_of(other.anatomy, rigid)
            for name, other in others.items()
        },
    }


def rigid_shanks(hardware: HardwareSpec) -> HardwareSpec:
    """Return a robot whose toes are welded to its shanks where its springs have them at
    rest."""

    def rigid(leg: Leg) -> Leg:
        return (
            leg
            if leg.toe is None
            else dataclasses.replace(
                leg, shank=merged(leg.shank, leg.toe, leg.seat), toe=None
            )
        )

    fr, fl, rr, rl = map(rigid, hardware.anatomy.legs)
    body = dataclasses.replace(hardware.anatomy, legs=(fr, fl, rr, rl))
    return dataclasses.replace(hardware, body=body)


def on_legs_of(other: Anatomy, hardware: HardwareSpec) -> HardwareSpec:
    """Return a robot with rigid shanks on the thighs and shanks of another one, which
    is scaled to the same mass.

    Lengths go with the cube root of the mass. The trunk has what the legs leave. Hips,
    joint ranges and motors stay.

    Args:
        other: the robot whose legs are taken.
        hardware: the robot that gets them.
    """
    body = hardware.anatomy
    scale = (body.mass / other.mass) ** (1.0 / 3.0)

    def refit(leg: Leg, model: Leg) -> Leg:
        return dataclasses.replace(
            leg,
            knee=(0.0, 0.0, scale * model.knee[2]),
            foot=(0.0, 0.0, scale * model.foot[2]),
            foot_radius=scale * model.foot_radius,
            thigh=_scaled(model.thigh, scale, scale**3),
            shank=_scaled(model.shank, scale, scale**3),
        )

    fr, fl, rr, rl = map(refit, body.legs, other.legs)
    trunk = body.mass - sum(link.mass for leg in (fr, fl, rr, rl) for link in leg.links)
    lighter = _scaled(body.trunk, 1.0, trunk / body.trunk.mass)
    return dataclasses.replace(
        hardware, body=dataclasses.replace(body, legs=(fr, fl, rr, rl), trunk=lighter)
    )


def _scaled(link: Link, length: float, mass: float) -> Link:
    """Return a link with its lengths multiplied by `length` and its mass by `mass`."""
    x, y, z = (length * c for c in link.com)
    xx, yy, zz, xy, xz, yz = (mass * length**2 * i for i in link.inertia)
    return Link(mass * link.mass, (x, y, z), (xx, yy, zz, xy, xz, yz))
