"""A robot as a file of TOML: an MJCF or the numbers themselves, and what no MJCF says
of motors, losses and contacts.

A number for each of abad, hip and knee may be one number for all three. Lengths, masses
and inertias of a leg are those of the left one, in the frames of `Anatomy`; the right
one mirrors it.
"""

import dataclasses
import json
import math
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np

from bp2_rl.base.assets import render
from bp2_rl.base.bounds import Positive, Range, Within, check_bounds
from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.files import check_values, read_bytes
from bp2_rl.base.serialization import from_json
from bp2_rl.robot import bp2
from bp2_rl.robot.anatomy import Anatomy, JointConvention, Leg, Link, Vector
from bp2_rl.robot.conventions import LEGS, MOTOR_NAMES
from bp2_rl.robot.hardware import ByJoint, HardwareSpec, Losses
from bp2_rl.robot.reading import SLENDER, RobotReading, read_mjcf

LARGEST = 1 << 18
"""Bytes of the largest robot file that is read."""
MOST_DOTS = 200
"""In a line: a key of 50,000 levels keeps Python's reader of TOML busy for minutes."""
Lengths = Annotated[Vector, Within(-10.0, 10.0)]
Radius = Annotated[float, Within(0.0, 1.0, open_below=True)]
Angle = Annotated[float, Within(-10.0, 10.0)]


class RobotFileError(UserError):
    """A robot file that is missing, damaged, or describes no robot; one line that names
    the key at fault."""


@dataclasses.dataclass(frozen=True)
class TrunkNumbers(Link):
    """The trunk, with the half extents, m, of the box that it fills."""

    size: Annotated[Vector, Within(0.0, 10.0, open_below=True)]


@dataclasses.dataclass(frozen=True)
class LegNumbers:
    """A left leg; see `Leg`."""

    anchor: Lengths
    hip: Lengths
    knee: Lengths
    foot: Lengths
    foot_radius: Radius
    abad: Link
    thigh: Link
    shank: Link
    abad_range: Annotated[Range, Within(-10.0, 10.0)]
    hip_range: Annotated[Range, Within(-10.0, 10.0)]
    knee_range: Annotated[Range, Within(-10.0, 10.0)]
    toe: Link | None = None
    seat: Lengths = (0.0, 0.0, 0.0)
    bend: Literal[-1, 1] = -1


@dataclasses.dataclass(frozen=True)
class StandNumbers:
    """Angles, rad, of the left legs in the standing pose, one number or fore and hind
    legs'; right legs mirror them."""

    hip: Annotated[float | tuple[float, float], Within(-10.0, 10.0)]
    knee: Annotated[float | tuple[float, float], Within(-10.0, 10.0)]
    abad: Annotated[float | tuple[float, float], Within(-10.0, 10.0)] = 0.0


@dataclasses.dataclass(frozen=True)
class MotorNumbers:
    """The motors at the joint, behind their gears; None is what the MJCF says."""

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
class SpringNumbers:
    """The spring in a shank."""

    stiffness: Annotated[float, Within(100.0, 1e7)]  # N/m
    damping: Annotated[float, Within(0.0, 1e5)]  # N s/m
    travel: Annotated[float, Within(0.0, 10.0)]  # m


@dataclasses.dataclass(frozen=True)
class ContactNumbers:
    """The feet on the ground."""

    friction: Annotated[float, Within(0.01, 10.0)] = 0.8
    # s, in which the ground takes up a foot's depth
    time: Annotated[float, Within(0.002, 1.0)] = 0.005


@dataclasses.dataclass(frozen=True)
class WrittenRobot:
    """What stands in a robot file."""

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
    spring: SpringNumbers | None = None
    contact: ContactNumbers = ContactNumbers()
    losses: Losses = Losses()
    gains: GainNumbers | None = None
    top_speed: Positive | None = None  # m/s, as published
    sources: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class RobotFile:
    """A robot, and what its file says besides."""

    hardware: HardwareSpec
    # Nm/rad, of the position loop; None: the file gives no gains
    stiffness: ByJoint | None = None
    damping: ByJoint | None = None  # Nm s/rad
    top_speed: float | None = None  # m/s, published
    reading: RobotReading | None = None  # of its MJCF; None: the file has the numbers
    sources: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Return the robot's name."""
        return self.hardware.anatomy.name

    @property
    def anatomy(self) -> Anatomy:
        """Return the robot's body."""
        return self.hardware.anatomy


def load_robot(path: Path) -> RobotFile:
    """Read a robot file.

    Raises:
        UserError: one line that names the file, the key at fault, and how to mend it.
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


def _require_tables(given: dict[str, Any]) -> None:
    """Refuse a file that lacks what every robot needs, all of it named at once; a slip
    of the pen is told first."""
    body = () if "mjcf" in given else ("trunk", "fore", "hind", "stand")
    lacking = [name for name in ("motors", *body) if name not in given]
    if lacking and given.keys() <= {
        field.name for field in dataclasses.fields(WrittenRobot)
    }:
        tables = ", ".join(
            ["name"] * ("name" not in given) + [f"[{name}]" for name in lacking]
        )
        raise UserError(
            f"it has no {tables}: `bp2 robot new MODEL.xml --numbers` writes all of them"
        )


def _robot(written: WrittenRobot, path: Path) -> RobotFile:
    if written.mjcf is not None and (written.trunk or written.fore or written.hind):
        raise UserError(
            "give either `mjcf`, the path of a model, or the numbers in [trunk], [fore] and [hind]"
        )
    reading = None
    if written.mjcf is not None:
        model = path.parent / written.mjcf
        reading = read_mjcf(
            model,
            joints=written.joints,
            feet=written.feet,
            foot_radius=written.foot_radius,
        )
    anatomy = _anatomy(written, reading)
    _check(anatomy)
    motors, spring = written.motors, _spring(written, reading, anatomy)
    hardware = HardwareSpec(
        body=anatomy,
        gear_ratio=anatomy.gear_ratio,
        solid_legs=True,
        rotor_inertia=_by_joint("armature", motors.armature, reading),
        peak_torque=_by_joint("peak_torque", motors.peak_torque, reading),
        corner_speed=motors.corner_speed,
        no_load_speed=motors.no_load_speed,
        envelope="throughout",
        joint_stop_time=0.005,
        friction=written.contact.friction,
        contact_time=written.contact.time,
        losses=written.losses,
        **(
            {}
            if spring is None
            else {
                f"spring_{name}": value
                for name, value in dataclasses.asdict(spring).items()
            }
        ),
    )
    gains = written.gains
    return RobotFile(
        hardware=hardware,
        stiffness=gains.stiffness if gains else None,
        damping=gains.damping if gains else None,
        top_speed=written.top_speed,
        reading=reading,
        sources=written.sources,
        assumed=written.assumed,
    )


def _by_joint(
    name: str, given: ByJoint | None, reading: RobotReading | None
) -> ByJoint:
    """Return a motor's number by joint: the file's, or in the mean over the legs the
    model's."""
    if given is not None:
        return given
    if reading is None:
        raise UserError(
            f"motors.{name}: missing; one number, or three for abad, hip and knee"
        )
    values = [getattr(joint, name) for joint in reading.joints]
    if not all(map(math.isfinite, values)):
        raise UserError(
            f"motors.{name}: the MJCF does not say it; give one number, or three for abad, hip and knee"
        )
    abad, hip, knee = (sum(values[i::3]) / len(LEGS) for i in range(3))
    return abad, hip, knee


def _spring(
    written: WrittenRobot, reading: RobotReading | None, anatomy: Anatomy
) -> SpringNumbers | None:
    if not anatomy.sprung:
        if written.spring is not None:
            raise UserError(
                "spring: the legs have no toe below a spring; give [fore.toe] and [hind.toe], or leave it out"
            )
        return None
    if written.spring is None and reading is not None and reading.spring is not None:
        return SpringNumbers(
            reading.spring.stiffness, reading.spring.damping, reading.spring.travel
        )
    if written.spring is None:
        raise UserError(
            "spring: missing, and the legs have a toe; give stiffness, damping and travel"
        )
    return written.spring


# --- The body -------------------------------------------------------------------------


def _anatomy(written: WrittenRobot, reading: RobotReading | None) -> Anatomy:
    if reading is not None:
        anatomy = reading.anatomy
    else:
        # `_require_tables` has seen all three
        trunk = cast(TrunkNumbers, written.trunk)
        left = [
            _leg(cast(LegNumbers, numbers)) for numbers in (written.fore, written.hind)
        ]
        if (left[0].toe is None) != (left[1].toe is None):
            raise UserError("fore.toe, hind.toe: give both, or neither")
        legs = (mirrored(left[0]), left[0], mirrored(left[1]), left[1])
        thick = SLENDER * left[0].thigh_length
        anatomy = Anatomy.of_parts(
            Link(trunk.mass, trunk.com, trunk.inertia),
            legs,
            trunk.size,
            name=written.name,
            stand=(0.0,) * len(MOTOR_NAMES),
            thigh_radius=thick,
            lower_radius=thick,
        )
    changes: dict[str, Any] = {"name": written.name}
    if (stand := written.stand) is not None:
        left = [
            np.broadcast_to(angle, 2) for angle in (stand.abad, stand.hip, stand.knee)
        ]
        both = (
            (-abad, hip, knee, abad, hip, knee)
            for abad, hip, knee in zip(*left, strict=True)
        )
        changes["stand"] = tuple(float(angle) + 0.0 for legs in both for angle in legs)
        if reading is not None:  # of a model whose knees bend either way, [stand] tells
            knees = changes["stand"][2::3]
            changes["legs"] = tuple(
                dataclasses.replace(
                    leg, bend=1 if knee > 0.0 else -1 if knee < 0.0 else leg.bend
                )
                for leg, knee in zip(anatomy.legs, knees, strict=True)
            )
    if written.conventions:
        changes["joints"] = written.conventions
    for name in ("thigh_radius", "lower_radius", "weighed_mass"):
        if (value := getattr(written, name)) is not None:
            changes[name] = value
    return dataclasses.replace(anatomy, **changes)


def _leg(numbers: LegNumbers) -> Leg:
    own = {
        field.name: getattr(numbers, field.name)
        for field in dataclasses.fields(Leg)
        if field.name != "ranges"
    }
    return Leg(
        **own, ranges=(numbers.abad_range, numbers.hip_range, numbers.knee_range)
    )


def mirrored(leg: Leg) -> Leg:
    """Return the leg on the other side of the trunk."""

    def vector(v: Vector) -> Vector:
        return v[0], 0.0 - v[1], v[2]

    def link(part: Link) -> Link:
        xx, yy, zz, xy, xz, yz = part.inertia
        return Link(part.mass, vector(part.com), (xx, yy, zz, 0.0 - xy, xz, 0.0 - yz))

    (low, high), hip, knee = leg.ranges
    vectors = {
        name: vector(getattr(leg, name))
        for name in ("anchor", "hip", "knee", "foot", "seat")
    }
    links = {name: link(getattr(leg, name)) for name in ("abad", "thigh", "shank")}
    return dataclasses.replace(
        leg,
        **vectors,
        **links,
        toe=None if leg.toe is None else link(leg.toe),
        ranges=((-high, -low), hip, knee),
    )


def _check(anatomy: Anatomy) -> None:
    """Refuse a body that cannot be, naming the key at fault."""
    if len(anatomy.joints) != len(MOTOR_NAMES):
        raise UserError(
            f"conventions: {len(anatomy.joints)} are given; give the 12 joints', or leave them out"
        )
    _check_link("trunk", anatomy.trunk)
    for name, leg in zip(("fore", "hind"), anatomy.legs[1::2], strict=True):
        for part in ("abad", "thigh", "shank", "toe"):
            if (link := getattr(leg, part)) is not None:
                _check_link(f"{name}.{part}", link)
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
    if (
        anatomy.weighed_mass < 0.5 * anatomy.mass
        or anatomy.weighed_mass > 2.0 * anatomy.mass
    ):
        raise UserError(
            f"weighed_mass: {anatomy.weighed_mass:g} kg, and the links add up to {anatomy.mass:g} kg: one is wrong"
        )


def _check_link(name: str, link: Link) -> None:
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
        joints: as `read_mjcf` was told.
        feet: as `read_mjcf` was told.
        foot_radius: as `read_mjcf` was told.
    """

    def by_joint(name: str, otherwise: float, factor: float = 1.0) -> str:
        values = [getattr(joint, name) for joint in reading.joints]
        known = [
            value if math.isfinite(value) and value > 0.0 else otherwise
            for value in values
        ]
        return row(factor * sum(known[i::3]) / len(LEGS) for i in range(3))

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
        assumed=_assumed(reading),
        urdf=any(math.isfinite(joint.speed) for joint in reading.joints),
        torque=HardwareSpec(body=reading.anatomy).size.torque * bp2.PEAK_TORQUE,
        gains=all(joint.stiffness > 0.0 for joint in reading.joints),
        by_joint=by_joint,
    )


def _assumed(reading: RobotReading) -> list[str]:
    """Return the keys of the numbers that a model does not say."""
    said = {
        "motors.corner_speed": False,
        "motors.no_load_speed": all(
            math.isfinite(joint.speed) for joint in reading.joints
        ),
        "motors.peak_torque": all(
            math.isfinite(joint.peak_torque) for joint in reading.joints
        ),
        "motors.armature": all(joint.armature > 0.0 for joint in reading.joints),
    }
    return [key for key, known in said.items() if not known]


def row(values: Iterable[float]) -> str:
    """Return numbers as TOML has them."""
    return f"[{', '.join(f'{0.0 if abs(value) < 1e-12 else value:.7g}' for value in values)}]"
