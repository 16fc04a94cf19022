"""Read the `Anatomy` of any quadruped from its MJCF or URDF; structure tells which
joint is which, unless names do.

`compiling` makes the model, `limbs` finds its legs and feet, `frames` expresses each leg
in the frames of `Anatomy`; `JointReading` keeps the sign and the offset between the
angles there and the model's own.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal
from xml.etree import ElementTree

import mujoco
import numpy as np

from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import LARGEST_TEXT, read_bytes
from bp2_rl.robot.anatomy import Anatomy, JointConvention, Leg, Vector
from bp2_rl.robot.building import build_spec
from bp2_rl.robot.compiling import ROUNDING, ReadingError, compile_file
from bp2_rl.robot.conventions import JOINTS, LEGS, MOTOR_NAMES
from bp2_rl.robot.coordinates import motor_indices
from bp2_rl.robot.effects import FAST, Effects, effects_of, mass_matrix
from bp2_rl.robot.frames import (
    JointReading,
    LegReading,
    as_vector,
    merged_link,
    read_leg,
)
from bp2_rl.robot.limbs import (
    CAPSULE,
    CYLINDER,
    Foot,
    Limb,
    at_zero,
    collides,
    find_feet,
    find_legs,
    find_trunk,
    geoms_of,
    require_no_couplings,
)

STRAIGHT = 0.82
"""ASSUMED: length of a standing leg as a share of the straight leg's, for a model
without a keyframe."""
SLENDER = 0.07
"""ASSUMED: radius of a leg as a share of its thigh's length, for a model without
capsules."""
LONGEST = 0.1
"""ASSUMED: travel of a spring without a stop, m."""

BY_JOINT = {
    "armature": "armature, kg m2,",
    "damping": "damping, Nm s/rad,",
    "friction": "friction, Nm,",
    "peak_torque": "peak torque, Nm,",
    "speed": "greatest speed, rad/s,",
    "stiffness": "stiffness, Nm/rad,",
    "actuator_damping": "actuator's damping, Nm s/rad,",
}
"""Numbers that a robot file gives for abad, hip and knee alike on all legs, with their
names in notes."""


@dataclasses.dataclass(frozen=True)
class SpringReading:
    """Stiffness, damping and travel of the springs in a model's shanks, in the mean
    over the legs."""

    stiffness: Annotated[float, Within(100.0, 1e7)]  # N/m
    damping: Annotated[float, Within(0.0, 1e5)]  # N s/m
    travel: Annotated[float, Within(0.0, 10.0)]  # m


@dataclasses.dataclass(frozen=True)
class RobotReading:
    """A robot as read from its model: anatomy, joints, springs, feet and notes."""

    anatomy: Anatomy
    joints: tuple[JointReading, ...]  # in the order of `MOTOR_NAMES`
    spring: SpringReading | None
    friction: float  # of the feet
    contacts: tuple[str, ...]  # the geoms that are the feet
    notes: tuple[str, ...]  # what was left out or assumed

    def by_joint(
        self, name: str, otherwise: float | None = None, factor: float = 1.0
    ) -> tuple[float, float, float]:
        """Return a number of the joints abad, hip and knee, each in the mean over the
        legs, times a factor.

        Where the model says nothing, zero or no limit, it is `otherwise` if that is
        given.
        """
        numbers = [float(getattr(joint, name)) for joint in self.joints]
        if otherwise is not None:
            numbers = [x if 0.0 < x < math.inf else otherwise for x in numbers]
        abad, hip, knee = (factor * sum(numbers[i::3]) / len(LEGS) for i in range(3))
        return abad, hip, knee


def read_mjcf(
    path: Path,
    *,
    joints: Sequence[str] = (),
    feet: Sequence[str] = (),
    foot_radius: float | None = None,
) -> RobotReading:
    """Read a robot from an MJCF or URDF file.

    Args:
        path: of the file; its meshes need not be there.
        joints: the twelve joints' names in the order of `MOTOR_NAMES`; the robot's
            other joints are then welded. Empty: the joints are found in a free trunk
            with four legs of abad, hip and knee.
        feet: a geom, a site or a body in each foot, in the order of the legs; empty:
            the farthest sphere of each leg, or end of a capsule.
        foot_radius: m, of the feet's spheres; None for that of the geoms.

    Raises:
        ReadingError: one line that says what cannot be read and how to correct it.
    """
    try:
        model, notes = compile_file(path, joints)
        require_no_couplings(model)
        chains = find_legs(model, find_trunk(model), joints)
        found_feet = find_feet(model, at_zero(model), chains, feet, foot_radius)
        return _read_model(model, chains, found_feet, _urdf_speeds(path), notes)
    except UserError as error:
        raise ReadingError(f"{path}: {error}") from error


def _urdf_speeds(path: Path) -> dict[str, float]:
    """Return the limits of the joints' speeds that a URDF gives, rad/s, by the joints'
    names; MuJoCo drops them."""
    try:
        root = ElementTree.fromstring(read_bytes(path, LARGEST_TEXT))
        speeds = {
            joint.get("name", ""): float(limit.get("velocity", 0.0))
            for joint in root.iterfind("joint")
            for limit in joint.iterfind("limit")
            if root.tag == "robot"
        }
    except (ElementTree.ParseError, ValueError):
        return {}  # MuJoCo reads what is no XML, and no velocities
    return {name: speed for name, speed in speeds.items() if speed > 0.0}


def _read_model(
    model: mujoco.MjModel,
    chains: Sequence[Limb],
    feet: Sequence[Foot],
    speeds: Mapping[str, float],
    notes: list[str],
) -> RobotReading:
    """Read the robot from a compiled model, its legs and its feet.

    Args:
        model: the model, without meshes.
        chains: the legs.
        feet: of the legs.
        speeds: rad/s, limits of joints by their names.
        notes: corrections so far; omissions and assumptions are added.
    """
    data, effects = at_zero(model), effects_of(model)
    readings = [
        read_leg(model, data, effects, chain, foot, notes)
        for chain, foot in zip(chains, feet, strict=True)
    ]
    stand = _keyframe_stand(model, chains, readings, notes)
    fr, fl, rr, rl = (
        dataclasses.replace(
            reading.leg, bend=_bend(name, reading, stand[3 * i + 2], notes)
        )
        for i, (name, reading) in enumerate(zip(LEGS, readings, strict=True))
    )
    legs = fr, fl, rr, rl
    angles = np.reshape(stand, (4, 3))
    if stand[1] == stand[2] == 0.0:
        notes.append(
            f"the model has no keyframe of a stand: ASSUMED with legs at {STRAIGHT:g} of their length"
        )
        stand = _assumed_stand(legs)
    elif not np.allclose(angles[::2] * (-1, 1, 1), angles[1::2], atol=1e-3):
        notes.append(
            "the keyframe's right legs do not mirror the left ones: [stand] has the left legs' angles"
        )
    joints = tuple(
        dataclasses.replace(joint, speed=speeds.get(joint.name, math.inf))
        for reading in readings
        for joint in reading.joints
    )
    trunk, slender = find_trunk(model), SLENDER * legs[0].thigh_length
    thighs = [chain.bodies[1] for chain in chains]
    lower_links = [body for chain in chains for body in chain.bodies[2:]]
    anatomy = Anatomy.of_parts(
        merged_link(model, data, trunk, np.zeros(3), np.eye(3)),
        legs,
        _trunk_size(model, data, trunk, legs),
        name=model.names.split(b"\0")[0].decode(errors="replace") or "robot",
        stand=stand,
        thigh_radius=_capsule_radius(model, thighs, slender),
        lower_radius=_capsule_radius(model, lower_links, slender),
        joints=tuple(
            JointConvention(joint.name, joint.sign, joint.offset) for joint in joints
        ),
    )
    _note_differences(joints, notes)
    frictions = [foot.friction for foot in feet]
    if not np.allclose(frictions, frictions[0], rtol=1e-6):
        notes.append(
            f"the feet's friction differs ({', '.join(f'{x:g}' for x in frictions)}): their mean is taken"
        )
    dofs = [int(model.jnt_dofadr[j]) for chain in chains for j in chain.joints[:3]]
    _note_left_out(effects, [joint.name for joint in joints], dofs, notes)
    _note_mass_matrix(model, chains, anatomy, joints, notes)
    return RobotReading(
        anatomy=anatomy,
        joints=joints,
        spring=_spring(model, chains, notes),
        friction=float(np.mean(frictions)),
        contacts=tuple(foot.name for foot in feet),
        notes=tuple(dict.fromkeys(notes)),
    )


# --- What a robot file cannot hold ----------------------------------------------------


def _note_left_out(
    effects: Effects, names: Sequence[str], dofs: Sequence[int], notes: list[str]
) -> None:
    """Note forces on joints for which a robot file has no number."""
    # of a DC motor or a velocity servo
    without_stiffness = np.where(
        effects.stiffness == 0.0, effects.actuator_damping, 0.0
    )
    for values, unit, what in (
        (effects.spring, "Nm/rad", "springs parallel to joints"),
        (
            effects.nonlinear_damping,
            f"Nm at {FAST:g} rad/s",
            "damping that is not viscous",
        ),
        (
            without_stiffness,
            "Nm s/rad",
            "damping by actuators without stiffness",
        ),
        (
            effects.commanded_damping,
            "Nm s/rad",
            "damping in proportion to an actuator's command",
        ),
    ):
        joints_of: dict[str, list[str]] = {}
        for name, dof in zip(names, dofs, strict=True):
            if abs(values[dof]) > ROUNDING:
                joints_of.setdefault(f"{values[dof]:.4g} {unit}", []).append(name)
        if joints_of:
            at = "; ".join(
                f"{amount} at {', '.join(joints)}"
                for amount, joints in joints_of.items()
            )
            notes.append(f"left out: {what}, {at}")
    if effects.other_forces > ROUNDING:
        notes.append(
            f"left out: forces of a fluid or against gravity, up to {effects.other_forces:.3g} N or Nm"
        )


# --- Properties of all legs together --------------------------------------------------


def _keyframe_stand(
    model: mujoco.MjModel,
    chains: Sequence[Limb],
    legs: list[LegReading],
    notes: list[str],
) -> tuple[float, ...]:
    """Return the twelve joint angles, rad, of the keyframe in which the robot stands;
    zeros if there is none."""
    keys = {model.key(i).name: i for i in range(model.nkey)}
    key = next((keys[name] for name in ("stand", "home", *keys) if name in keys), None)
    if key is None:
        return (0.0,) * len(MOTOR_NAMES)
    joints = [joint for reading in legs for joint in reading.joints]
    model_angles = [
        model.key_qpos[key, model.jnt_qposadr[j]]
        for chain in chains
        for j in chain.joints[:3]
    ]
    keyframe = [
        joint.sign * float(angle) + joint.offset
        for joint, angle in zip(joints, model_angles, strict=True)
    ]
    angles = np.clip(
        keyframe,
        *np.transpose([ends for reading in legs for ends in reading.leg.ranges]),
    )
    excess = np.abs(keyframe - angles)
    worst = int(np.argmax(excess))
    if excess[worst] > ROUNDING:
        notes.append(
            f"the keyframe '{model.key(key).name}' leaves the joints' ranges by up to {excess[worst]:.3g} rad, at "
            f"'{joints[worst].name}': the ranges' ends are taken"
        )
    return tuple(float(angle) for angle in angles)


def _bend(
    leg: str, reading: LegReading, stand: float, notes: list[str]
) -> Literal[-1, 1]:
    """Return the sign of the knee's angle: in the standing pose, else in most of its
    range, else in the model's default pose."""
    low, high = reading.leg.ranges[2]
    one_sided = 0.5 * (low + high) if abs(low + high) > 0.5 * (high - low) else 0.0
    for angle in (stand, one_sided, reading.drawn_knee):
        if abs(angle) > 0.05:
            return 1 if angle > 0.0 else -1
    notes.append(
        f"the model does not show how the knee of {leg} bends: ASSUMED backwards"
    )
    return -1


def _assumed_stand(legs: Sequence[Leg]) -> tuple[float, ...]:
    """Return twelve joint angles, rad, that put each foot below its hip, at a share of
    the leg's length."""
    angles: list[float] = []
    for leg in legs:
        thigh, lower = leg.thigh_length, leg.lower_length
        reach = max(STRAIGHT * (thigh + lower), 1.05 * abs(thigh - lower))
        knee = math.acos((reach**2 - thigh**2 - lower**2) / (2.0 * thigh * lower))
        knee = float(np.clip(leg.bend * knee, *leg.ranges[2]))
        hip = -math.atan2(lower * math.sin(knee), thigh + lower * math.cos(knee))
        angles += [
            float(np.clip(0.0, *leg.ranges[0])),
            float(np.clip(hip, *leg.ranges[1])),
            knee,
        ]
    return tuple(angles)


def _note_differences(joints: Sequence[JointReading], notes: list[str]) -> None:
    """Note where legs differ in a number that a robot file gives once for all legs."""
    for name, what in BY_JOINT.items():
        for i, kind in enumerate(JOINTS):
            values = [getattr(joint, name) for joint in joints[i::3]]
            if not np.allclose(values, values[0], rtol=1e-6):
                listed = ", ".join(f"{value:g}" for value in values)
                notes.append(
                    f"the legs' {what} at the {kind} differ ({listed}): their mean is taken"
                )


def _note_mass_matrix(
    model: mujoco.MjModel,
    chains: Sequence[Limb],
    anatomy: Anatomy,
    joints: Sequence[JointReading],
    notes: list[str],
) -> None:
    """Note a difference between the model's mass matrix, in a random pose, and the mass
    matrix of the robot as read."""
    built, data = build_spec(anatomy).compile(), at_zero(model)
    built_data, motors = mujoco.MjData(built), motor_indices(built.nv)
    ranges = [ends for leg in anatomy.legs for ends in leg.ranges]
    angles = np.random.default_rng(0).uniform(*np.transpose(ranges))
    built_data.qpos[:7], built_data.qpos[motors + 1] = (0, 0, 0, 1, 0, 0, 0), angles
    moved = model.jnt_qposadr[[j for chain in chains for j in chain.joints[:3]]]
    data.qpos[moved] = [
        joint.sign * (angle - joint.offset)
        for joint, angle in zip(joints, angles, strict=True)
    ]
    built.dof_armature[:] = 0.0
    armature = np.reshape([joint.armature for joint in joints], (4, 3))
    built.dof_armature[motors] = np.tile(np.mean(armature, axis=0), 4)
    found, wanted = mass_matrix(built, built_data), mass_matrix(model, data)
    free = np.arange(6) + model.body_dofadr[find_trunk(model)]
    if np.any(values := [*model.dof_armature[free], *model.dof_damping[free]]):
        notes.append(
            f"left out: armature or damping of the trunk's free joint, up to {max(values):g}"
        )
    order = [j for chain in chains for j in chain.joints]
    dofs = [*free, *model.jnt_dofadr[order]]
    sign = np.sign(
        [*[1.0] * 6, *np.sum(built_data.xaxis[1:] * data.xaxis[order], axis=1)]
    )
    wanted = wanted[np.ix_(dofs, dofs)] * np.outer(sign, sign)
    wanted[range(6), range(6)] -= model.dof_armature[free]
    scale = np.outer(np.diag(wanted), np.diag(wanted))
    off = np.max((found - wanted) ** 2 / scale) ** 0.5
    if off > ROUNDING:
        notes.append(
            f"the robot's mass matrix differs from the model's by up to {off:.2g} of the diagonal"
        )


def _trunk_size(
    model: mujoco.MjModel, data: mujoco.MjData, trunk: int, legs: Sequence[Leg]
) -> Vector:
    """Return half extents, m, of the box about the trunk's origin that holds its
    colliding geoms, or all its geoms if none collides."""
    geoms = geoms_of(model, [trunk])
    colliding = [g for g in geoms if collides(model, g)]
    extents = [
        np.array([abs(leg.anchor[0]), abs(leg.anchor[1]), 0.25 * leg.thigh_length])
        for leg in legs
    ]
    boxes: list[np.ndarray] = []
    for g in colliding or geoms:
        axes, box = data.geom_xmat[g].reshape(3, 3), model.geom_aabb[g]
        boxes.append(
            np.abs(data.geom_xpos[g] + axes @ box[:3]) + np.abs(axes) @ box[3:]
        )
    return as_vector(np.max(boxes or extents, axis=0))


def _capsule_radius(
    model: mujoco.MjModel, parts: Sequence[int], otherwise: float
) -> float:
    """Return the radius of the longest capsule or cylinder on some links, m, or
    `otherwise` if there is none."""
    geoms = [
        (float(model.geom_size[g, 1]), float(model.geom_size[g, 0]))
        for g in geoms_of(model, parts)
        if int(model.geom_type[g]) in (CAPSULE, CYLINDER)
        and model.geom_size[g, 1] > model.geom_size[g, 0]
        and (collides(model, g) or model.geom_group[g] == 3)
    ]
    return max(geoms)[1] if geoms else otherwise


def _spring(
    model: mujoco.MjModel, chains: Sequence[Limb], notes: list[str]
) -> SpringReading | None:
    """Return the springs in the shanks; None where the shanks are rigid."""
    springs = [chain.joints[3] for chain in chains if len(chain.joints) == 4]
    if not springs:
        return None
    if len(springs) != len(chains):
        raise ReadingError(
            "some legs have a spring and some have none: give all of them one, or none"
        )
    read: list[tuple[float, float, float]] = []
    for j in springs:
        ends = [model.jnt_range[j]] if model.jnt_limited[j] else []
        for i in range(model.ntendon):
            if model.wrap_objid[model.tendon_adr[i]] == j:
                ends.append(model.tendon_lengthspring[i])
        travel = min((float(high - low) for low, high in ends), default=LONGEST)
        damping = float(model.dof_damping[model.jnt_dofadr[j]])
        read.append((float(model.jnt_stiffness[j]), damping, travel))
    if not np.allclose(read, read[0]):
        notes.append("the legs' springs differ: their mean is taken")
    return SpringReading(*map(float, np.mean(read, axis=0)))
