"""Parameters of a robot in training and simulation: body, motors, springs, contacts,
losses; BP2's ideal and built robot."""

import dataclasses
import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot import bp2
from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.bp2_body import BP2Body
from bp2_rl.robot.conventions import LEGS

ByJoint = float | tuple[float, float, float]
"""A number for all joints, or a number each for abad, hip and knee."""
AtJoints = float | np.ndarray
"""A number for all joints, or an array with a number for each of the twelve."""


class Size(NamedTuple):
    """A robot's length and mass over BP2's, and scale factors for all else by dynamic
    similarity (equal Froude numbers).

    Settings and rewards are written for BP2. A robot of another size takes them times
    these factors.
    """

    length: float
    mass: float  # and force

    @property
    def time(self) -> float:
        """Return the scale factor of durations, over BP2's; accelerations are the same
        at every size."""
        return math.sqrt(self.length)

    @property
    def speed(self) -> float:
        """Return the scale factor of speeds, over BP2's."""
        return math.sqrt(self.length)

    @property
    def rate(self) -> float:
        """Return the scale factor of angular speeds, over BP2's."""
        return 1.0 / self.time

    @property
    def torque(self) -> float:
        """Return the scale factor of torques, over BP2's."""
        return self.mass * self.length

    @property
    def power(self) -> float:
        """Return the scale factor of powers, over BP2's."""
        return self.mass * self.speed


@dataclasses.dataclass(frozen=True)
class Losses:
    """A machine's losses between battery and road, and the delays of its motors.

    `Losses()` are the ideal robot's, which loses nothing; `BUILT` has the losses of the
    built robot. The laws are in `robot.losses` and, for the bus, in `robot.actuator`.
    """

    # m2, drag coefficient x frontal area
    drag_area: Annotated[float, Within(0.0, 10.0)] = 0.0
    # m/s, of air that blows towards -x
    headwind: Annotated[float, Within(-50.0, 50.0)] = 0.0
    # of the torque, driving and braking alike
    gear_efficiency: Annotated[float, Within(0.1, 1.0)] = 1.0
    # Nm, Coulomb's, at the joint
    joint_friction: Annotated[ByJoint, Within(0.0, 1000.0)] = 0.0
    # Nm s/rad, at the joint
    joint_viscosity: Annotated[ByJoint, Within(0.0, 10.0)] = 0.0
    # N, Coulomb's, of the slide that guides the spring
    spring_friction: Annotated[float, Within(0.0, 1e4)] = 0.0
    # s, time constant of the torque behind its command
    current_lag: Annotated[float, Within(0.0, 1.0)] = 0.0
    latency: Annotated[float, Within(0.0, 0.020)] = 0.0
    """s, from an observation to the joint target it leads to; training draws
    `randomization.latency` in its place"""
    # W, from battery to motors
    bus_power_out: Annotated[float, Within(1.0, 1e9, infinite=True)] = float("inf")
    # W, from motors to battery
    bus_power_in: Annotated[float, Within(0.0, 1e9, infinite=True)] = float("inf")
    # share of the voltage that is lost per kW out
    bus_sag: Annotated[float, Within(0.0, 1.0)] = 0.0


LOSSES = tuple(field.name for field in dataclasses.fields(Losses))


@dataclasses.dataclass(frozen=True)
class HardwareSpec:
    """A robot's body, motors, springs, contacts and losses; `HardwareSpec()` is the
    ideal BP2.

    The motors stay what they are under another gear: a gear ratio g gives g/g0 times
    the joint torque at g0/g times the speed, with the body's own gear ratio g0. What
    may differ from joint to joint is one number, or three for abad, hip and knee. The
    bounds are those of what can be computed, not of what can be built.
    """

    body: BP2Body | Anatomy = BP2Body()
    gear_ratio: Annotated[float, Within(0.1, 1000.0)] = bp2.GEAR_RATIO
    solid_legs: bool = False
    """legs collide with each other and with the trunk in C MuJoCo; in training they end
    the episode instead"""
    spring_stiffness: Annotated[float, Within(100.0, 1e7)] = bp2.SPRING_STIFFNESS  # N/m
    spring_damping: Annotated[float, Within(0.0, 1e5)] = bp2.SPRING_DAMPING  # N s/m
    # m, at which the stop begins to push
    spring_travel: Annotated[float, Within(0.0, 10.0)] = bp2.SPRING_TRAVEL
    # N/m, on top of the spring's
    spring_stop_stiffness: Annotated[float, Within(0.0, 1e8)] = (
        bp2.SPRING_STOP_STIFFNESS
    )
    rebound_stiffness: Annotated[float, Within(0.0, 1e8)] = bp2.SPRING_STOP_STIFFNESS
    """N/m, of the stop at no compression that keeps the toe from flying off, on top of
    the spring's"""
    # N s/m, of that stop; more is no stable step
    rebound_damping: Annotated[float, Within(0.0, 300.0)] = 0.0
    joint_stop_time: Annotated[float, Within(0.002, 1.0)] = 0.02
    """s, in which a joint limit takes up an excess: MuJoCo's time constant, critically
    damped"""
    # kg m2, motor side
    rotor_inertia: Annotated[ByJoint, Within(0.0, 10.0)] = bp2.ROTOR_INERTIA
    # Nm, at the joint with the body's own gear
    peak_torque: Annotated[ByJoint, Within(0.1, 1e5)] = bp2.PEAK_TORQUE
    # rad/s, with that gear; 0: a straight line
    corner_speed: Annotated[ByJoint, Within(0.0, 1e4)] = bp2.CORNER_SPEED
    # rad/s, with that gear
    no_load_speed: Annotated[ByJoint, Within(0.1, 1e4)] = bp2.NO_LOAD_SPEED
    braking_speed: Annotated[ByJoint, Within(0.1, 1e4, infinite=True)] = float("inf")
    """rad/s, at which no braking torque is left, on a line as the driving one's; inf:
    the peak at any speed"""
    envelope: Literal["start", "throughout"] = "start"
    """when in a millisecond torque keeps to the envelope: at its start only, or, in C
    MuJoCo, all the time"""
    # of every body, inertias alike
    mass_scale: Annotated[float, Within(0.01, 100.0)] = 1.0
    friction: Annotated[float, Within(0.01, 10.0)] = bp2.FOOT_FRICTION
    contact_time: Annotated[float, Within(0.002, 1.0)] = bp2.CONTACT_TIME
    """s, in which the ground takes up a foot's depth: MuJoCo's time constant"""
    # MuJoCo's damping ratio of that
    contact_damping: Annotated[float, Within(0.01, 100.0)] = 1.0
    losses: Losses = Losses()

    def __post_init__(self) -> None:
        """Raise `UserError` if a value is out of bounds, or a corner speed or leg
        length contradicts another value."""
        check_bounds(self, "hardware.")
        for name in ("no_load_speed", "braking_speed"):
            if np.any(np.greater_equal(self.corner_speed, getattr(self, name))):
                raise UserError(
                    f"hardware.corner_speed ({self.corner_speed}) must be below {name} ({getattr(self, name)})"
                )
        shortest = bp2.SHANK_LENGTH + bp2.TOE_LENGTH + self.spring_travel
        if isinstance(self.body, BP2Body) and self.body.leg_length <= shortest:
            raise UserError(
                f"hardware.body.leg_length ({self.body.leg_length}) must exceed shank + toe + spring travel = "
                f"{shortest:.3f} m"
            )

    @property
    def anatomy(self) -> Anatomy:
        """Return the body as an `Anatomy`, before masses are scaled."""
        return self.body if isinstance(self.body, Anatomy) else self.body.anatomy

    @property
    def is_bp2(self) -> bool:
        """Return whether the robot is a BP2, whatever its parameters."""
        return isinstance(self.body, BP2Body)

    def parameter(self, name: str) -> Any:
        """Return a parameter of this robot, of its losses or of BP2's body."""
        if name in LOSSES:
            return getattr(self.losses, name)
        return getattr(self if hasattr(self, name) else self.bp2, name)

    def changed(self, **parameters: Any) -> "HardwareSpec":
        """Return the robot with some parameters replaced, by name: its own, its losses'
        or BP2's body's.

        Raises:
            UserError: there is no such parameter, or the robot cannot have its value.
        """
        names = {field.name for field in dataclasses.fields(self)}
        lost = {name: value for name, value in parameters.items() if name in LOSSES}
        own = {
            name: value
            for name, value in parameters.items()
            if name not in LOSSES and name in names
        }
        of_body = {
            name: value
            for name, value in parameters.items()
            if name not in lost and name not in own
        }
        for name in of_body.keys() - {
            field.name for field in dataclasses.fields(BP2Body)
        }:
            raise UserError(f"a robot has no parameter {name}")
        body = dataclasses.replace(self.bp2, **of_body) if of_body else self.body
        losses = dataclasses.replace(self.losses, **lost)
        return dataclasses.replace(self, **{"body": body, "losses": losses, **own})

    @property
    def bp2(self) -> BP2Body:
        """Return the body of a BP2; raise `UserError` if the robot is another."""
        if isinstance(self.body, Anatomy):
            raise UserError(
                "this is about BP2 alone, and the robot is another: use --robot built or ideal"
            )
        return self.body

    @property
    def size(self) -> "Size":
        """Return the robot's length and mass over BP2's; they are 1 for a BP2, whatever
        its parameters."""
        if isinstance(self.body, BP2Body):
            return Size(1.0, 1.0)
        return Size(
            self.body.leg_length / bp2.THIGH_LENGTH,
            self.body.weighed_mass / bp2.TOTAL_MASS,
        )

    @property
    def mass(self) -> float:
        """Mass of the robot as published, times `mass_scale`, kg."""
        return self.mass_scale * self.anatomy.weighed_mass

    @property
    def reflected_inertia(self) -> Any:
        """Rotor inertia at the joint, kg m2: a number, or an array of twelve where
        joints differ."""
        return at_joints(self.rotor_inertia, self.gear_ratio**2)

    @property
    def joint_peak_torque(self) -> Any:
        """Peak torque at the joint behind this gear, Nm."""
        return at_joints(self.peak_torque, self._gear_share)

    @property
    def joint_corner_speed(self) -> Any:
        """Speed up to which the peak torque is available, at the joint, rad/s."""
        return at_joints(self.corner_speed, 1.0 / self._gear_share)

    @property
    def joint_no_load_speed(self) -> Any:
        """Speed at which no driving torque is left, at the joint, rad/s."""
        return at_joints(self.no_load_speed, 1.0 / self._gear_share)

    @property
    def joint_braking_speed(self) -> Any:
        """Speed at which no braking torque is left, at the joint, rad/s."""
        return at_joints(self.braking_speed, 1.0 / self._gear_share)

    @property
    def _gear_share(self) -> float:
        return self.gear_ratio / self.anatomy.gear_ratio


def times(factor: float, value: ByJoint) -> ByJoint:
    """Return a parameter of the joints, or its values for abad, hip and knee, times a
    factor."""
    if not isinstance(value, tuple):
        return factor * value
    abad, hip, knee = value
    return factor * abad, factor * hip, factor * knee


def at_joints(value: ByJoint, factor: float = 1.0) -> AtJoints:
    """Return a parameter of the joints times a factor: a number for all joints, or an
    array of twelve."""
    return (
        np.tile(factor * np.array(value), len(LEGS))
        if isinstance(value, tuple)
        else factor * value
    )


IDEAL = HardwareSpec()
"""BP2 with the paper's numbers alone: without losses, on legs that pass through each
other."""

BUILT = HardwareSpec(
    # the widest at which fore and hind legs hardly ever meet
    body=BP2Body(hind_track=0.28),
    solid_legs=True,
    rebound_stiffness=150e3,  # a polyurethane buffer 20 mm deep ...
    rebound_damping=100.0,  # ... that gives back half of a hit
    joint_stop_time=0.005,  # a hard stop
    # a drive's current loop is ten times as fast as the force loop
    envelope="throughout",
    friction=0.8,  # rubber on a dry track
    contact_time=0.003,  # rubber sole and track in series, some 300 kN/m
    losses=Losses(
        drag_area=0.2,  # 0.44 m x 0.3 m and four legs, at a drag coefficient of about 1
        gear_efficiency=0.92,  # a planetary stage of 8.5:1
        joint_friction=2.0,  # seals, bearings and cogging behind the gear
        joint_viscosity=0.05,  # grease
        spring_friction=20.0,  # a bushing under a leg's side load
        current_lag=0.002,  # drive and bus
        latency=0.005,  # one control step
        bus_power_out=8e3,  # a pack of about 1 kWh for seconds
        bus_power_in=3e3,  # cells are charged at less than half of what they give
        bus_sag=0.0125,  # a tenth at full load
    ),
)
"""BP2 as a machine that could be built, with ASSUMED losses; docs/notes/reality.md has
published values."""

REAL = BUILT.changed(
    peak_torque=117.0,
    corner_speed=16.3,
    no_load_speed=19.5,
    braking_speed=36.4,
    rotor_inertia=1.86e-4,
    spring_stiffness=6280.0,
    spring_damping=45.6,
    spring_travel=0.141,
    spring_stop_stiffness=58.9e3,
    friction=0.848,
    drag_area=0.394,
    headwind=1.3,
    gear_efficiency=0.867,
    joint_friction=1.59,
    joint_viscosity=0.0383,
    spring_friction=18.5,
    current_lag=3.67e-3,
    latency=5.92e-3,
    bus_power_out=5140.0,
    bus_power_in=6890.0,
    bus_sag=0.0071,
)
"""One of the plausible robots of `evaluation.plausible`: the robot on which a policy's
speeds are nearest to those of the paper's BP2. Its wind is that of the road; the road
itself rises by 0.19 % and is rough by 2.8 mm."""


RobotName = Literal["ideal", "built", "real"]
ROBOTS: dict[RobotName, HardwareSpec] = {"ideal": IDEAL, "built": BUILT, "real": REAL}


def robot_name(hardware: HardwareSpec) -> RobotName | None:
    """Return a robot's name in `ROBOTS`; None where it has none."""
    return next((name for name, robot in ROBOTS.items() if robot == hardware), None)


# --- From one robot to another, a part at a time --------------------------------------

BP2_TRACKS = ("fore_track", "hind_track")
PARTS = {
    "air": ("drag_area", "headwind"),
    "gears": ("gear_efficiency",),
    "joint friction": ("joint_friction", "joint_viscosity"),
    "spring slides": ("spring_friction",),
    "bus power": ("bus_power_out", "bus_power_in"),
    "bus sag": ("bus_sag",),
    "torque lag": ("current_lag",),
    "latency": ("latency",),
    "envelope throughout": ("envelope",),
    "braking limit": ("braking_speed",),
    "ground friction": ("friction",),
    "ground stiffness": ("contact_time", "contact_damping"),
    "rebound stop": ("rebound_stiffness", "rebound_damping"),
    "joint stops": ("joint_stop_time",),
    "solid legs, tracks": ("solid_legs", *BP2_TRACKS),
}
"""Groups of parameters in which a built robot differs from an ideal one, by the group's
name."""


def ideal_of(robot: HardwareSpec) -> HardwareSpec:
    """Return a robot without losses: BP2's ideal one, or any other robot with its own
    ground and joint stops."""
    if robot.is_bp2:
        return IDEAL
    return dataclasses.replace(
        robot,
        losses=Losses(),
        envelope=IDEAL.envelope,
        braking_speed=math.inf,
        solid_legs=False,
    )


def with_parts(
    robot: HardwareSpec, other: HardwareSpec, parts: Iterable[str]
) -> HardwareSpec:
    """Return a robot with the parameters of some `PARTS` of another robot."""
    names = [name for part in parts for name in PARTS[part]]
    applicable = [name for name in names if robot.is_bp2 or name not in BP2_TRACKS]
    return robot.changed(**{name: other.parameter(name) for name in applicable})


def differing(robot: HardwareSpec, other: HardwareSpec) -> tuple[str, ...]:
    """Return the names of the `PARTS` in which two robots differ."""
    return tuple(part for part in PARTS if with_parts(robot, other, [part]) != robot)
