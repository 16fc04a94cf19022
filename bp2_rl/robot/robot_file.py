"""A robot as a TOML file: an MJCF or the numbers themselves, and motors, losses and
contacts, which no MJCF has.

A number for each of abad, hip and knee may be one number for all three. Lengths, masses
and inertias of a leg are those of the left one, in the frames of `Anatomy`; the right
one mirrors it.
"""

import dataclasses
import json
import math
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, cast

import numpy as np

from bp2_rl.base.assets import render
from bp2_rl.base.bounds import Positive, Range, Within, check_bounds
from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.files import check_values, read_bytes
from bp2_rl.base.serialization import from_json
from bp2_rl.robot import bp2
from bp2_rl.robot.anatomy import (
    Anatomy,
    JointConvention,
    Leg,
    LegParts,
    Link,
    Radius,
    Vector,
)
from bp2_rl.robot.conventions import MOTOR_NAMES
from bp2_rl.robot.hardware import ByJoint, HardwareSpec, Losses
from bp2_rl.robot.reading import SLENDER, RobotReading, SpringReading, read_mjcf

LARGEST = 1 << 18
"""Bytes of the largest robot file that is read."""
MOST_DOTS = 200
"""Most dots in a line of a robot file: Python's reader of TOML is busy for minutes with
a key of 50,000 levels."""
Angle = Annotated[float, Within(-10.0, 10.0)]
ForeHind = Annotated[float | tuple[float, float], Within(-10.0, 10.0)]
"""An angle, rad: a number for all left legs, or a number each for the fore and the hind
leg."""
TurnRange = Annotated[Range, Within(-10.0, 10.0)]


class RobotFileError(UserError):
    """Raised for a robot file that is missing, damaged, or describes no robot; the line
    names the key at fault."""


@dataclasses.dataclass(frozen=True)
class TrunkNumbers(Link):
    """The trunk in a robot file, with the half extents, m, of the box that it fills."""

    size: Annotated[Vector, Within(0.0, 10.0, open_below=True)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class LegNumbers(LegParts):
    """A left leg in a robot file: its links, places of joints, and ranges of joints."""

    abad_range: TurnRange
    hip_range: TurnRange
    knee_range: TurnRange

    @property
    def leg(self) -> Leg:
        """Return the leg as a `Leg` of an `Anatomy`."""
        parts = {part.name: getattr(self, part.name) for part in fields(LegParts)}
        return Leg(**parts, ranges=(self.abad_range, self.hip_range, self.knee_range))


@dataclasses.dataclass(frozen=True)
class StandNumbers:
    """Angles of the left legs in the standing pose; right legs mirror them."""

    hip: ForeHind
    knee: ForeHind
    abad: ForeHind = 0.0

    @property
    def joints(self) -> tuple[float, ...]:
        """Return the twelve joints' angles, rad."""
        left = (
            np.broadcast_to(x, 2).tolist() for x in (self.abad, self.hip, self.knee)
        )
        both = (
            (-abad, hip, knee, abad, hip, knee)
            for abad, hip, knee in zip(*left, strict=True)
        )
        return tuple(angle + 0.0 for legs in both for angle in legs)


@dataclasses.dataclass(frozen=True)
class MotorNumbers:
    """Limits and inertia of the motors at the joint, behind their gears; None takes the
    MJCF's value."""

    # rad/s, up to which the peak torque is there
    corner_speed: Annotated[ByJoint, Within(0.0, 1e4)]
    no_load_speed: Annotated[ByJoint, Within(0.1, 1e4)]  # rad/s
    peak_torque: Annotated[ByJoint, Within(0.1, 1e5)] | None = None  # Nm
    armature: Annotated[ByJoint, Within(0.0, 10.0)] | None = None  # kg m2


@dataclasses.dataclass(frozen=True)
class GainNumbers:
    """The gains of the joints' position loop that the maker gives."""

    stiffness: Annotated[ByJoint, Within(0.0, 1e5)]  # Nm/rad
    damping: Annotated[ByJoint, Within(0.0, 1e4)]  # Nm s/rad


@dataclasses.dataclass(frozen=True)
class ContactNumbers:
    """Friction and softness of the feet's contact with the ground."""

    friction: Annotated[float, Within(0.01, 10.0)] = 0.8
    # s, in which the ground takes up a foot's depth
    time: Annotated[float, Within(0.002, 1.0)] = 0.005


@dataclasses.dataclass(frozen=True, kw_only=True)
class FileNotes:
    """Statements of a robot file beside the robot: gains, published speed, sources and
    assumptions."""

    gains: GainNumbers | None = None
    top_speed: Positive | None = None  # m/s, as published
    sources: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class WrittenRobot(FileNotes):
    """The keys of a robot file, and their values."""

    name: str
    motors: MotorNumbers
    mjcf: str | None = None  # path from the file's folder; None: the numbers follow
    joints: tuple[str, ...] = ()
    feet: tuple[str, ...] = ()
    foot_radius: Radius | None = None
    # of the joints in the robot's own model; empty: the mjcf tells
    conventions: tuple[JointConvention, ...] = ()
    trunk: TrunkNumbers | None = None
    fore: LegNumbers | None = None
    hind: LegNumbers | None = None
    thigh_radius: Radius | None = None
    lower_radius: Radius | None = None
    weighed_mass: Positive | None = None
    stand: StandNumbers | None = None
    spring: SpringReading | None = None
    contact: ContactNumbers = ContactNumbers()
    losses: Losses = Losses()


@dataclasses.dataclass(frozen=True)
class RobotFile(FileNotes):
    """A robot, and what its file says beside it."""

    hardware: HardwareSpec
    reading: RobotReading | None = None  # of its MJCF; None: the file has the numbers

    @property
    def name(self) -> str:
        """Return the robot's name."""
        return self.hardware.anatomy.name

    @property
    def anatomy(self) -> Anatomy:
        """Return the robot's body."""
        return self.hardware.anatomy


def load_robot(path: Path) -> RobotFile:
    """Read a robot file, and return the robot and what the file says beside it.

    Raises:
        UserError: one line that names the file, the key at fault, and how to correct it.
    """
    content = read_bytes(path, LARGEST)
    try:
        if any(line.count(b".") > MOST_DOTS for line in content.splitlines()):
            raise RecursionError
        given = tomllib.loads(content.decode())
        check_values(given)
        _require_tables(given)
        written = from_json(WrittenRobot, given)
        check_bounds(written)
        return _robot(written, path)
    except RecursionError as error:
        raise RobotFileError(
            f"{path} is no robot file: it is nested too deeply"
        ) from error
    except UserError as error:
        raise RobotFileError(f"{path}: {one_line(str(error))}") from error
    except ValueError as error:  # UTF-8's and TOML's
        raise RobotFileError(
            f"{path} is damaged or not TOML: {one_line(str(error))}"
        ) from error


def _require_tables(given: dict[str, object]) -> None:
    """Raise `UserError` that names all missing tables that every robot needs; a
    misspelt key is left to be reported first."""
    body = () if "mjcf" in given else ("trunk", "fore", "hind", "stand")
    lacking = [name for name in ("motors", *body) if name not in given]
    if lacking and given.keys() <= {field.name for field in fields(WrittenRobot)}:
        tables = ", ".join(
            ["name"] * ("name" not in given) + [f"[{name}]" for name in lacking]
        )
        raise UserError(
            f"it has no {tables}: `bp2 robot new MODEL.xml --numbers` writes all of them"
        )


def _robot(written: WrittenRobot, path: Path) -> RobotFile:
    """Return the robot that a file describes, by its numbers or by its MJCF."""
    if written.mjcf is not None and (written.trunk or written.fore or written.hind):
        raise UserError(
            "give either `mjcf`, the path of a model, or the numbers in [trunk], [fore] and [hind]"
        )
    reading = None
    if written.mjcf is not None:
        reading = read_mjcf(
            path.parent / written.mjcf,
            joints=written.joints,
            feet=written.feet,
            foot_radius=written.foot_radius,
        )
    anatomy = _anatomy(written, reading)
    _require_possible_body(anatomy)
    motors, spring = written.motors, _spring(written, reading, anatomy)
    hardware = HardwareSpec(
        body=anatomy,
        gear_ratio=anatomy.gear_ratio,
        solid_legs=True,
        rotor_inertia=_of_motors("armature", motors.armature, reading),
        peak_torque=_of_motors("peak_torque", motors.peak_torque, reading),
        corner_speed=motors.corner_speed,
        no_load_speed=motors.no_load_speed,
        envelope="throughout",
        joint_stop_time=0.005,
        friction=written.contact.friction,
        contact_time=written.contact.time,
        losses=written.losses,
        **{f"spring_{name}": value for name, value in vars(spring).items()}
        if spring
        else {},
    )
    notes = {note.name: getattr(written, note.name) for note in fields(FileNotes)}
    return RobotFile(hardware, reading, **notes)


def _of_motors(
    name: str, given: ByJoint | None, reading: RobotReading | None
) -> ByJoint:
    """Return a number of the motors by name: the file's value, or else the model's."""
    if given is not None:
        return given
    numbers = reading.by_joint(name) if reading else None
    if numbers is None or not all(map(math.isfinite, numbers)):
        why = "missing" if numbers is None else "the MJCF does not say it"
        raise UserError(
            f"motors.{name}: {why}; give one number, or three for abad, hip and knee"
        )
    return numbers


def _spring(
    written: WrittenRobot, reading: RobotReading | None, anatomy: Anatomy
) -> SpringReading | None:
    """Return the springs in the shanks, from the file or else from the model; None
    where the shanks are rigid."""
    if written.spring is not None and not anatomy.sprung:
        raise UserError(
            "spring: the legs have no toe below a spring; give [fore.toe] and [hind.toe], or leave it out"
        )
    spring = written.spring or (reading.spring if reading else None)
    if spring is None and anatomy.sprung:
        raise UserError(
            "spring: missing, and the legs have a toe; give stiffness, damping and travel"
        )
    return spring


# --- The body -------------------------------------------------------------------------


def _anatomy(written: WrittenRobot, reading: RobotReading | None) -> Anatomy:
    """Return the body: the numbers in the file, or the model's with the file's
    changes."""
    anatomy = _numbered_body(written) if reading is None else reading.anatomy
    stand, legs = anatomy.stand, anatomy.legs
    if written.stand is not None:
        stand = written.stand.joints
    if written.stand is not None and reading is not None:
        # of a model whose knees bend either way, [stand] tells
        fr, fl, rr, rl = (
            dataclasses.replace(
                leg, bend=1 if knee > 0.0 else -1 if knee < 0.0 else leg.bend
            )
            for leg, knee in zip(legs, stand[2::3], strict=True)
        )
        legs = fr, fl, rr, rl
    return dataclasses.replace(
        anatomy,
        name=written.name,
        legs=legs,
        stand=stand,
        joints=written.conventions or anatomy.joints,
        thigh_radius=written.thigh_radius or anatomy.thigh_radius,
        lower_radius=written.lower_radius or anatomy.lower_radius,
        weighed_mass=written.weighed_mass or anatomy.weighed_mass,
    )


def _numbered_body(written: WrittenRobot) -> Anatomy:
    """Return the body from the numbers in the file."""
    # `_require_tables` has seen all three
    trunk = cast(TrunkNumbers, written.trunk)
    fore, hind = (
        cast(LegNumbers, numbers).leg for numbers in (written.fore, written.hind)
    )
    if (fore.toe is None) != (hind.toe is None):
        raise UserError("fore.toe, hind.toe: give both, or neither")
    thick = SLENDER * fore.thigh_length
    return Anatomy.of_parts(
        Link(trunk.mass, trunk.com, trunk.inertia),
        (mirrored(fore), fore, mirrored(hind), hind),
        trunk.size,
        name=written.name,
        stand=(0.0,) * len(MOTOR_NAMES),
        thigh_radius=thick,
        lower_radius=thick,
    )


def mirrored(leg: Leg) -> Leg:
    """Return a leg mirrored to the other side of the trunk."""

    def vector(v: Vector) -> Vector:
        return v[0], 0.0 - v[1], v[2]

    def link(part: Link) -> Link:
        xx, yy, zz, xy, xz, yz = part.inertia
        return Link(part.mass, vector(part.com), (xx, yy, zz, 0.0 - xy, xz, 0.0 - yz))

    (low, high), hip, knee = leg.ranges
    return dataclasses.replace(
        leg,
        anchor=vector(leg.anchor),
        hip=vector(leg.hip),
        knee=vector(leg.knee),
        foot=vector(leg.foot),
        seat=vector(leg.seat),
        abad=link(leg.abad),
        thigh=link(leg.thigh),
        shank=link(leg.shank),
        toe=link(leg.toe) if leg.toe else None,
        ranges=((-high, -low), hip, knee),
    )


def _require_possible_body(anatomy: Anatomy) -> None:
    """Raise `UserError`, naming the key at fault, for a body that cannot be."""
    if len(anatomy.joints) != len(MOTOR_NAMES):
        raise UserError(
            f"conventions: {len(anatomy.joints)} are given; give the 12 joints', or leave them out"
        )
    _require_possible_link("trunk", anatomy.trunk)
    for name, leg in zip(("fore", "hind"), anatomy.legs[1::2], strict=True):
        for part in ("abad", "thigh", "shank", "toe"):
            if (link := getattr(leg, part)) is not None:
                _require_possible_link(f"{name}.{part}", link)
        for part, below in (("knee", leg.knee), ("foot", leg.foot)):
            if abs(below[0]) > 1e-6 or below[2] >= -1e-3:
                raise UserError(
                    f"{name}.{part}: {below} must have x = 0 and a negative z, as the leg hangs at zero angles; "
                    "turn the link's frame, and the joint's range and the stand with it"
                )
        if leg.anchor[1] + leg.lateral <= 0.0:
            raise UserError(
                f"{name}: anchor, hip, knee and foot put the left leg right of the middle; y is to the left"
            )
    if anatomy.legs[1].anchor[0] <= anatomy.legs[3].anchor[0]:
        raise UserError("fore.anchor: must be in front of hind.anchor; x is forward")
    for i, (motor, angle) in enumerate(zip(MOTOR_NAMES, anatomy.stand, strict=True)):
        low, high = anatomy.legs[i // 3].ranges[i % 3]
        if not low - 1e-6 <= angle <= high + 1e-6:
            raise UserError(
                f"stand: {motor} at {angle:g} rad is outside its range, {low:g} to {high:g}"
            )
    if not 0.5 * anatomy.mass <= anatomy.weighed_mass <= 2.0 * anatomy.mass:
        raise UserError(
            f"weighed_mass: {anatomy.weighed_mass:g} kg, and the links add up to {anatomy.mass:g} kg: one is wrong"
        )


def _require_possible_link(name: str, link: Link) -> None:
    moments = np.linalg.eigvalsh(link.inertia_matrix)  # ascending
    if moments[0] <= 0.0 or moments[2] > (1.0 + 1e-6) * (moments[0] + moments[1]):
        shown = ", ".join(f"{x:.3g}" for x in moments)
        raise UserError(
            f"{name}.inertia: principal moments {shown} kg m2 belong to no body: each must be positive and at most the "
            "sum of the others; the order is xx, yy, zz, xy, xz, yz about the centre of mass"
        )


# --- The file that a model fills in ---------------------------------------------------


def robot_text(
    reading: RobotReading,
    mjcf: str | None,
    *,
    joints: Sequence[str] = (),
    feet: Sequence[str] = (),
    foot_radius: float | None = None,
) -> str:
    """Return a robot file filled in from a model, with a comment on each number that
    its user must confirm.

    Args:
        reading: of the model.
        mjcf: the model's path from the file's folder; None: the numbers themselves are
            written, the left legs'.
        joints: as given to `read_mjcf`.
        feet: as given to `read_mjcf`.
        foot_radius: as given to `read_mjcf`.
    """

    sayable = {"no_load_speed": "speed", "peak_torque": None, "armature": None}
    assumed = ["motors.corner_speed"] + [
        f"motors.{key}"
        for key, name in sayable.items()
        if not all(
            0.0 < getattr(joint, name or key) < math.inf for joint in reading.joints
        )
    ]
    return render(
        "robot/robot_file.toml",
        reading=reading,
        body=reading.anatomy,
        mjcf=mjcf,
        joints=list(joints),
        feet=list(feet),
        foot_radius=foot_radius,
        text=json.dumps,
        row=row,
        assumed=assumed,
        urdf=any(math.isfinite(joint.speed) for joint in reading.joints),
        torque=HardwareSpec(body=reading.anatomy).size.torque * bp2.PEAK_TORQUE,
        gains=all(joint.stiffness > 0.0 for joint in reading.joints),
    )


def row(values: Iterable[float]) -> str:
    """Return numbers as an array in TOML."""
    return f"[{', '.join(f'{0.0 if abs(value) < 1e-12 else value:.7g}' for value in values)}]"
