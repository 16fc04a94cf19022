"""From the MJCF or URDF of any quadruped to its `Anatomy`: structure alone tells which
joint is which, unless names do.

Every part that moves is merged with what is welded to it and expressed in the frames of
`Anatomy`, in which a leg hangs straight down at zero angles; `JointReading` keeps the
sign and the offset between these angles and the model's own. Meshes are left out and
need not be there: masses come from `<inertial>`.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.base.bounds import Range, Within
from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.files import LARGEST_TEXT, read_bytes
from bp2_rl.robot.anatomy import (
    Anatomy,
    Inertia,
    JointConvention,
    Leg,
    Link,
    Vector,
    possible_moments,
)
from bp2_rl.robot.building import build_spec
from bp2_rl.robot.compiling import ReadingError, compiled_apart
from bp2_rl.robot.conventions import JOINTS, LEGS, MOTOR_NAMES
from bp2_rl.robot.coordinates import motor_indices
from bp2_rl.robot.effects import FAST, Effects, effects_of, mass_matrix

PARALLEL = 1e-3
"""rad, by which a joint's axis may be off."""
STRAIGHT = 0.82
"""ASSUMED: share of the straight leg's length at which a robot stands whose model has
no keyframe."""
LEVEL = 0.1
"""Share of a foot's radius by which spheres may be nearer to the knee than the farthest
that touch as it does."""
SLENDER = 0.07
"""ASSUMED: a leg's radius over its thigh's length, where no capsule tells."""
ROUNDING = 1e-6
"""rad, by which a keyframe may leave a range; N, Nm, or a share, from which on a
difference is told."""
LONGEST = 0.1
"""m, ASSUMED: travel of a spring without a stop."""

_Geom = mujoco.mjtGeom
FREE, HINGE, SLIDE = (
    int(kind)
    for kind in (
        mujoco.mjtJoint.mjJNT_FREE,
        mujoco.mjtJoint.mjJNT_HINGE,
        mujoco.mjtJoint.mjJNT_SLIDE,
    )
)
BY_JOINT = {
    "armature": "armature, kg m2,",
    "damping": "damping, Nm s/rad,",
    "friction": "friction, Nm,",
    "peak_torque": "peak torque, Nm,",
    "speed": "greatest speed, rad/s,",
    "stiffness": "stiffness, Nm/rad,",
    "actuator_damping": "actuator's damping, Nm s/rad,",
}
"""What a robot file gives for abad, hip and knee, whatever the leg."""
SPHERE, CAPSULE, CYLINDER = (
    int(kind)
    for kind in (_Geom.mjGEOM_SPHERE, _Geom.mjGEOM_CAPSULE, _Geom.mjGEOM_CYLINDER)
)
CLOSING = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)


@dataclasses.dataclass(frozen=True, kw_only=True)
class JointReading(JointConvention):
    """What a model says of a motor's joint."""

    armature: float  # kg m2
    damping: float  # Nm s/rad
    friction: float  # Nm
    peak_torque: float  # Nm; inf: the model has no limit
    speed: float  # rad/s, the limit in its URDF; inf: the model has none
    stiffness: float  # Nm/rad, of its position actuator; 0: it has none
    actuator_damping: float  # Nm s/rad, of that; the joint's, where that has none


@dataclasses.dataclass(frozen=True)
class SpringReading:
    """What a model says of the springs in its shanks, in the mean over the legs."""

    stiffness: Annotated[float, Within(100.0, 1e7)]  # N/m
    damping: Annotated[float, Within(0.0, 1e5)]  # N s/m
    travel: Annotated[float, Within(0.0, 10.0)]  # m


@dataclasses.dataclass(frozen=True)
class RobotReading:
    """A robot as its model has it."""

    anatomy: Anatomy
    joints: tuple[JointReading, ...]  # in the order of `MOTOR_NAMES`
    spring: SpringReading | None
    friction: float  # of the feet
    contacts: tuple[str, ...]  # the geoms that are the feet
    notes: tuple[str, ...]  # what was left out or assumed

    def by_joint(
        self, name: str, otherwise: float | None = None, factor: float = 1.0
    ) -> tuple[float, float, float]:
        """Return a number of abad, hip and knee joints times a factor, each in the mean
        over the legs.

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
    """Read the robot in an MJCF or URDF file.

    Args:
        path: of the file; its meshes need not be there.
        joints: the twelve joints' names in the order of `MOTOR_NAMES`; the robot's
            other joints are then welded. Empty where the structure tells: a free trunk
            with four legs of abad, hip and knee.
        feet: a geom, a site or a body in each foot, in the order of the legs; empty:
            the farthest sphere of each leg, or end of a capsule.
        foot_radius: m, of the feet's spheres; None for that of the geoms.

    Raises:
        ReadingError: one line that says what cannot be read and how to mend it.
    """
    try:
        model, notes = _load(path, joints)
        found = read_model(
            model,
            joints=joints,
            feet=feet,
            foot_radius=foot_radius,
            speeds=_speeds(path),
        )
        return dataclasses.replace(found, notes=(*notes, *found.notes))
    except UserError as error:
        raise ReadingError(f"{path}: {error}") from error


def load_mjcf(path: Path, joints: Sequence[str] = ()) -> mujoco.MjModel:
    """Compile an MJCF or URDF file without its meshes.

    A fixed base becomes free. Where `joints` are named, the robot's others are welded.

    Raises:
        ReadingError: the file is no MJCF, a part's mass comes from a mesh, or it takes
            too much time or memory.
    """
    return _load(path, joints)[0]


def _load(path: Path, joints: Sequence[str]) -> tuple[mujoco.MjModel, list[str]]:
    """Compile a file as `load_mjcf`; return what was mended, too."""
    read_bytes(path, LARGEST_TEXT)
    return compiled_apart(_compile, path, tuple(joints))


def _compile(path: Path, joints: Sequence[str]) -> tuple[mujoco.MjModel, list[str]]:
    """Compile the file in the process for it."""
    notes: list[str] = []
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        _free(spec, notes)
        _mend_inertias(spec, notes)
        _require_inertias(spec)
        _strip(spec)
        _weld_others(spec, joints)
        return spec.compile(), notes
    except ReadingError:
        raise
    except (ValueError, TypeError, RuntimeError, mujoco.FatalError) as error:
        raise ReadingError(
            f"it is not an MJCF that MuJoCo can read: {one_line(str(error))}"
        ) from error


def _speeds(path: Path) -> dict[str, float]:
    """Return the limits of the joints' speeds that a URDF gives, rad/s, by the joints'
    names; MuJoCo drops them."""
    try:
        root = ElementTree.fromstring(read_bytes(path, LARGEST_TEXT))
        limits = {
            joint.get("name", ""): joint.find("limit")
            for joint in root.iterfind("joint")
        }
        given = {
            name: float(limit.get("velocity", 0.0))
            for name, limit in limits.items()
            if limit is not None
        }
    except (
        ElementTree.ParseError,
        ValueError,
    ):  # MuJoCo reads what is no XML, and no velocities
        return {}
    return (
        {name: speed for name, speed in given.items() if speed > 0.0}
        if root.tag == "robot"
        else {}
    )


def read_model(
    model: mujoco.MjModel,
    *,
    joints: Sequence[str] = (),
    feet: Sequence[str] = (),
    foot_radius: float | None = None,
    speeds: Mapping[str, float] = MappingProxyType({}),
) -> RobotReading:
    """Read the robot in a compiled model; arguments and errors as `read_mjcf`, `speeds`
    the joints' limits, rad/s."""
    trunk = _trunk(model)
    _require_no_couplings(model)
    chains = _legs(model, trunk, joints)
    data, effects = _at_zero(model), effects_of(model)
    notes: list[str] = []
    found = [
        _read_leg(model, data, effects, chain, foot, notes)
        for chain, foot in zip(
            chains, _feet(model, data, chains, feet, foot_radius), strict=True
        )
    ]
    stand = _stand(model, chains, found, notes)
    fr, fl, rr, rl = (
        dataclasses.replace(one.leg, bend=_bend(leg, one, stand[3 * i + 2], notes))
        for i, (leg, one) in enumerate(zip(LEGS, found, strict=True))
    )
    legs = fr, fl, rr, rl
    if stand[1] == stand[2] == 0.0:
        notes.append(
            f"no keyframe tells how it stands: ASSUMED with legs at {STRAIGHT:g} of their length"
        )
        stand = _assumed_stand(legs)
    elif not np.allclose(
        np.reshape(stand, (4, 3))[::2] * (-1, 1, 1),
        np.reshape(stand, (4, 3))[1::2],
        atol=1e-3,
    ):
        notes.append(
            "the keyframe's right legs do not mirror the left ones: [stand] has the left ones'"
        )
    body, size = (
        _merge(model, data, trunk, np.zeros(3), np.eye(3)),
        _trunk_size(model, data, trunk, legs),
    )
    anatomy = Anatomy.of_parts(
        body,
        legs,
        size,
        name=model.names.split(b"\0")[0].decode(errors="replace") or "robot",
        stand=stand,
        thigh_radius=_radius(
            model, [chain.bodies[1] for chain in chains], legs[0].thigh_length
        ),
        lower_radius=_radius(
            model,
            [body for chain in chains for body in chain.bodies[2:]],
            legs[0].thigh_length,
        ),
        joints=tuple(
            JointConvention(joint.name, joint.sign, joint.offset)
            for one in found
            for joint in one.joints
        ),
    )
    joints_read = tuple(
        dataclasses.replace(joint, speed=speeds.get(joint.name, math.inf))
        for one in found
        for joint in one.joints
    )
    _note_differences(joints_read, notes)
    frictions = [one.friction for one in found]
    if not np.allclose(frictions, frictions[0], rtol=1e-6):
        notes.append(
            f"the feet's friction differs ({', '.join(f'{x:g}' for x in frictions)}): their mean is taken"
        )
    dofs = [int(model.jnt_dofadr[j]) for chain in chains for j in chain.joints[:3]]
    _note_left_out(effects, [joint.name for joint in joints_read], dofs, notes)
    _note_mass_matrix(model, trunk, chains, anatomy, joints_read, notes)
    return RobotReading(
        anatomy=anatomy,
        joints=joints_read,
        spring=_spring(model, chains, notes),
        friction=float(np.mean(frictions)),
        contacts=tuple(one.contact for one in found),
        notes=tuple(dict.fromkeys(notes)),
    )


# --- The model without its meshes -----------------------------------------------------


def _free(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Give the one body that carries joints a free joint, if none has one: a URDF
    cannot, and MuJoCo fixes its base."""
    tops = [body for body in spec.worldbody.bodies if body.find_all("joint")]
    if (
        len(tops) != 1
        or list(tops[0].joints)
        or any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints)
    ):
        return
    for key in spec.keys:
        key.qpos = (
            [*tops[0].pos, 1.0, 0.0, 0.0, 0.0, *key.qpos] if len(key.qpos) else []
        )
        key.qvel = []
    tops[0].add_freejoint()
    spec.compiler.fusestatic = False  # so that a URDF's links keep their names
    notes.append(f"body '{tops[0].name}' was fixed to the world: it got a free joint")


def _mend_inertias(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Put the nearest inertia that a body can have in place of one that none can have,
    as URDFs have them."""
    mended: list[str] = []
    full = [body for body in spec.bodies if np.all(np.isfinite(body.fullinertia))]
    for body in full if not spec.compiler.balanceinertia else ():
        moments, axes = np.linalg.eigh(
            Link(1.0, (0.0, 0.0, 0.0), tuple(body.fullinertia)).inertia_matrix
        )
        # MuJoCo finds the axes anew, to that
        nearest = possible_moments(moments, margin=1e-9)
        if np.any(nearest != moments):
            body.fullinertia = six(axes @ np.diag(nearest) @ axes.T)
        if not np.allclose(nearest, moments, rtol=ROUNDING, atol=0.0):
            mended.append(body.name)
    if mended:
        notes.append(
            f"no body can have the inertia of {', '.join(mended)}: the nearest that one can have is taken"
        )


def _require_inertias(spec: mujoco.MjSpec) -> None:
    """Refuse a moving part whose mass comes from a mesh."""
    inferred = (
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        == spec.compiler.inertiafromgeom
    )
    for body in spec.worldbody.find_all("body"):
        heavy = any(
            _from_mesh(geom)
            and (geom.mass > 0.0 if math.isfinite(geom.mass) else geom.density > 0.0)
            for geom in body.geoms
        )
        moves = list(body.joints) or body.parent.name != "world"
        if heavy and moves and (inferred or not body.explicitinertial):
            raise ReadingError(
                f"the mass of body '{body.name}' comes from a mesh, and meshes are not read: give it an <inertial> "
                "(MuJoCo's `compile` writes it)"
            )


def _from_mesh(geom: Any) -> bool:
    """Return whether a geom is a mesh, or a box or the like that MuJoCo fits to one."""
    return bool(geom.meshname) or geom.type in (_Geom.mjGEOM_MESH, _Geom.mjGEOM_SDF)


def _strip(spec: mujoco.MjSpec) -> None:
    for geom in list(spec.geoms):
        if _from_mesh(geom) or geom.type == _Geom.mjGEOM_HFIELD:
            spec.delete(geom)
        else:
            geom.material = ""
    for site in list(spec.sites):
        if site.meshname:
            spec.delete(site)
    for element in (*spec.sites, *spec.tendons):
        element.material = ""
    for kind in (
        "tuples",
        "sensors",
        "pairs",
        "skins",
        "meshes",
        "hfields",
        "materials",
        "textures",
    ):
        for element in list(getattr(spec, kind)):
            spec.delete(element)


def _weld_others(spec: mujoco.MjSpec, joints: Sequence[str]) -> None:
    """Delete the joints of the robot that are not named, with what moves them."""
    if not joints:
        return
    known = {
        joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE
    }
    if (
        len(joints) != len(MOTOR_NAMES)
        or len(set(joints)) != len(MOTOR_NAMES)
        or not known.issuperset(joints)
    ):
        raise ReadingError(
            f"`joints` must be 12 names of {', '.join(sorted(known))}: each leg's abad, hip and knee"
        )
    others = known - set(joints)
    for actuator in list(spec.actuators):
        if actuator.target in others:
            spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name in others:
            spec.delete(joint)
    for key in list(spec.keys):  # they no longer fit
        spec.delete(key)


# --- Which part is which --------------------------------------------------------------


class _Chain(NamedTuple):
    bodies: list[int]  # that move: abad, thigh, shank, and a toe
    joints: list[int]


def _trunk(model: mujoco.MjModel) -> int:
    free = [
        int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == FREE
    ]
    carrying = [body for body in free if _moved_by(model, body)]
    if len(carrying) != 1:
        raise ReadingError(
            "its base is fixed, and no one body carries the legs: give the trunk a <freejoint/>; if MuJoCo wrote the "
            "file from a URDF, the base is lost: read the URDF itself"
            if not carrying
            else f"it holds {len(carrying)} robots: leave one"
        )
    return carrying[0]


def _moved_by(model: mujoco.MjModel, part: int) -> list[int]:
    """Return the moving bodies whose joint is on a moving body, or on what is welded to
    that."""
    return [
        body
        for body in range(1, model.nbody)
        if model.body_weldid[body] == body
        and body != part
        and model.body_weldid[model.body_parentid[body]] == part
    ]


def _require_no_couplings(model: mujoco.MjModel) -> None:
    for i in range(model.neq):
        if model.eq_active0[i]:
            kind, name = int(model.eq_type[i]), model.equality(i).name or f"number {i}"
            closed = kind in CLOSING
            raise ReadingError(
                f"equality constraint '{name}' {'closes a loop' if closed else 'couples joints'}: only serial legs can "
                "be; model the leg by its abad, hip and knee"
            )
    for i in range(model.ntendon):
        first, number = model.tendon_adr[i], model.tendon_num[i]
        if number > 1 or model.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT:
            raise ReadingError(
                f"tendon '{model.tendon(i).name or f'number {i}'}' couples joints: remove it, and let each joint have "
                "a motor of its own"
            )


def _legs(model: mujoco.MjModel, trunk: int, joints: Sequence[str]) -> list[_Chain]:
    """Return the legs in the order of `LEGS`."""
    limbs = [_chain(model, body) for body in _moved_by(model, trunk)]
    if len(limbs) != len(LEGS):
        names = ", ".join(f"'{model.body(limb.bodies[0]).name}'" for limb in limbs)
        few = (
            "six legs cannot be, nor wheels on the trunk"
            if len(limbs) > len(LEGS)
            else "four legs are needed"
        )
        raise ReadingError(
            f"the trunk carries {len(limbs)} limbs ({names}), and a quadruped has 4: {few}; name the twelve joints of "
            "the legs as `joints`, and the others are welded"
        )
    for chain in limbs:
        _require_leg(model, chain)
    if joints:
        return _named(model, limbs, joints)
    data = _at_zero(model)
    hips = np.array([data.xanchor[chain.joints[1]] for chain in limbs])
    fore = np.argsort(-hips[:, 0], kind="stable")
    pairs = [sorted(pair, key=lambda i: hips[i, 1]) for pair in (fore[:2], fore[2:])]
    apart = [hips[right, 1] < hips[left, 1] for right, left in pairs]
    if not all(apart) or hips[fore[1], 0] <= hips[fore[2], 0]:
        raise ReadingError(
            "where the hips are does not tell which leg is which: name the twelve joints as `joints`, legs FR, FL, RR, "
            "RL, each abad, hip, knee (x must point forward, and y left)"
        )
    return [limbs[i] for pair in pairs for i in pair]


def _named(
    model: mujoco.MjModel, limbs: list[_Chain], joints: Sequence[str]
) -> list[_Chain]:
    names = [[model.joint(j).name for j in chain.joints[:3]] for chain in limbs]
    wanted = [list(joints[i : i + 3]) for i in range(0, len(joints), 3)]
    if sorted(names) != sorted(wanted):
        raise ReadingError(
            f"`joints` must be 12 names, legs FR, FL, RR, RL, each abad, hip, knee; there are {names}"
        )
    return [limbs[names.index(leg)] for leg in wanted]


def _chain(model: mujoco.MjModel, body: int) -> _Chain:
    bodies = [body]
    while below := _moved_by(model, bodies[-1]):
        if len(below) > 1:
            raise ReadingError(
                f"the leg branches below body '{model.body(bodies[-1]).name}': leave one branch"
            )
        bodies += below
    for body in bodies:
        if model.body_jntnum[body] != 1:
            raise ReadingError(
                f"body '{model.body(body).name}' has several joints: give each a body with a mass"
            )
    return _Chain(bodies, [int(model.body_jntadr[body]) for body in bodies])


def _require_leg(model: mujoco.MjModel, chain: _Chain) -> None:
    """Refuse a limb that is not three hinges and, below them, at most one slide."""
    types = [int(model.jnt_type[j]) for j in chain.joints]
    names = [model.joint(j).name for j in chain.joints]
    if types[:3] != [HINGE] * 3 or types[3:] not in ([], [SLIDE]):
        if types[:4] == [HINGE] * 4:
            wheel = (
                "a wheel cannot be"
                if not model.jnt_limited[chain.joints[3]]
                else "an ankle cannot be"
            )
            raise ReadingError(
                f"joint '{names[3]}' is below the knee: {wheel}; weld it by removing the joint, or name the other "
                "twelve as `joints`"
            )
        raise ReadingError(
            f"the leg of body '{model.body(chain.bodies[0]).name}' has the joints {', '.join(map(repr, names))}: it "
            "needs three hinges, abad, hip and knee, and may have a slide as the shank's spring"
        )


# --- From the model's frames to those of `Anatomy` ------------------------------------


class _LegReading(NamedTuple):
    leg: Leg
    joints: list[JointReading]
    friction: float
    contact: str
    drawn_knee: float  # rad, the knee's angle as the model is drawn


class _Foot(NamedTuple):
    name: str
    center: Float[Any, "3"]
    radius: float
    friction: float


def _at_zero(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the state as the model is drawn, springs at rest, in the trunk's frame."""
    data, slides = mujoco.MjData(model), model.jnt_qposadr[model.jnt_type == SLIDE]
    data.qpos[slides] = model.qpos_spring[slides]
    for at in model.jnt_qposadr[model.jnt_type == FREE]:
        data.qpos[at : at + 7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    mujoco.mj_kinematics(model, data)
    return data


def _read_leg(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    effects: Effects,
    chain: _Chain,
    foot: _Foot,
    notes: list[str],
) -> _LegReading:
    anchors = [np.array(data.xanchor[j]) for j in chain.joints]
    axes = [np.array(data.xaxis[j]) for j in chain.joints]
    name = [model.joint(j).name for j in chain.joints]
    _require_axis(name[0], "abduction", axes[0], abs(axes[0][0]), "x, forward")
    across = math.hypot(axes[1][1], axes[1][2])
    _require_axis(
        name[1],
        "hip",
        axes[1],
        across,
        "y, to the left, at some angle of the abduction",
    )
    # The abduction's zero is where the hip axis is level; hip's and knee's, where what
    # hangs on them hangs below.
    side = math.copysign(1.0, axes[1][1])
    angle = [-math.atan2(side * axes[1][2], side * axes[1][1])]
    turned = [_turn(0, angle[0])]
    angle.append(_to_hang(turned[0] @ (anchors[2] - anchors[1]), name[2], name[1]))
    turned.append(_turn(1, angle[1]) @ turned[0])
    _require_axis(name[2], "knee", axes[2], abs(turned[0] @ axes[2])[1], "the hip's")
    angle.append(_to_hang(turned[1] @ (foot.center - anchors[2]), foot.name, name[2]))
    turned.append(_turn(1, angle[2]) @ turned[1])
    seat, toe = (0.0, 0.0, 0.0), None
    if len(chain.joints) == 4:
        _require_axis(
            name[3],
            "spring",
            axes[3],
            abs(turned[2] @ axes[3])[2],
            "the lower leg's, knee to foot",
        )
        seat = _vector(
            turned[2] @ (data.xpos[chain.bodies[3]] - anchors[2]), flat=False
        )
        toe = _merge(
            model, data, chain.bodies[3], data.xpos[chain.bodies[3]], turned[2]
        )
    along = (turned[0] @ axes[0])[0], (turned[0] @ axes[1])[1], (turned[0] @ axes[2])[1]
    joints = [
        _read_joint(model, effects, j, int(math.copysign(1, towards)), -turn, notes)
        for j, towards, turn in zip(chain.joints[:3], along, angle, strict=True)
    ]
    abad_range, hip_range, knee_range = (
        _range(model, j, joint, notes)
        for j, joint in zip(chain.joints[:3], joints, strict=True)
    )
    leg = Leg(
        anchor=_vector(anchors[0]),
        hip=_vector(turned[0] @ (anchors[1] - anchors[0])),
        knee=_vector(turned[1] @ (anchors[2] - anchors[1]), flat=True),
        foot=_vector(turned[2] @ (foot.center - anchors[2]), flat=True),
        foot_radius=foot.radius,
        abad=_merge(model, data, chain.bodies[0], anchors[0], turned[0]),
        thigh=_merge(model, data, chain.bodies[1], anchors[1], turned[1]),
        shank=_merge(model, data, chain.bodies[2], anchors[2], turned[2]),
        toe=toe,
        seat=seat,
        ranges=(abad_range, hip_range, knee_range),
    )
    return _LegReading(leg, joints, foot.friction, foot.name, -angle[2])


def _require_axis(
    joint: str, role: str, axis: np.ndarray, share: float, wanted: str
) -> None:
    """Refuse an axis of which `share`, its cosine with the wanted one, is not all."""
    if share < math.cos(PARALLEL):
        shown = ", ".join(f"{x:.3f}" for x in axis)
        raise ReadingError(
            f"joint '{joint}' turns about ({shown}) in the trunk's frame, and as its leg's {role} it should turn about "
            f"{wanted}: other joint axes cannot be; if the trunk's x does not point forward, turn the trunk's frame"
        )


def _turn(axis: int, angle: float) -> np.ndarray:
    """Rotation about x (0) or y (1)."""
    c, s = math.cos(angle), math.sin(angle)
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _to_hang(lever: np.ndarray, what: str, above: str) -> float:
    """Return the angle about y that turns a lever straight down."""
    if math.hypot(lever[0], lever[2]) < 1e-3:
        raise ReadingError(
            f"'{what}' is on the axis of joint '{above}': a leg's segments need a length"
        )
    return math.atan2(lever[0], -lever[2])


def _merge(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    part: int,
    origin: np.ndarray,
    turned: np.ndarray,
) -> Link:
    """Return a moving body with all that is welded to it, about `origin` and turned."""
    bodies = [body for body in range(1, model.nbody) if model.body_weldid[body] == part]
    mass = sum(float(model.body_mass[body]) for body in bodies)
    com = (
        sum((model.body_mass[body] * data.xipos[body] for body in bodies), np.zeros(3))
        / mass
    )
    inertia = np.zeros((3, 3))
    for body in bodies:
        axes, off = data.ximat[body].reshape(3, 3), data.xipos[body] - com
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += model.body_mass[body] * (off @ off * np.eye(3) - np.outer(off, off))
    return Link(
        mass, _vector(turned @ (com - origin)), six(turned @ inertia @ turned.T)
    )


def six(inertia: Float[np.ndarray, "3 3"]) -> Inertia:
    """Return the six numbers of a symmetric matrix, in the order of `Inertia`."""
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    xx, yy, zz, xy, xz, yz = (float(x) for x in inertia[rows, columns])
    return xx, yy, zz, xy, xz, yz


def _vector(xyz: np.ndarray, flat: bool = False) -> Vector:
    """Return three floats; `flat` sets x, which rounding alone keeps from 0, to 0."""
    x, y, z = (float(value) + 0.0 for value in xyz)
    return (0.0 if flat else x), y, z


def _read_joint(
    model: mujoco.MjModel,
    effects: Effects,
    j: int,
    sign: int,
    zero: float,
    notes: list[str],
) -> JointReading:
    """Read a joint whose angle in `Anatomy` is `zero` as the model is drawn."""
    name, dof = model.joint(j).name, int(model.jnt_dofadr[j])
    offset = zero - sign * float(model.qpos0[model.jnt_qposadr[j]])
    # of the angles that are one, that whose range is about zero
    if model.jnt_limited[j]:
        offset -= (
            2.0
            * math.pi
            * round(
                (sign * float(np.mean(model.jnt_range[j])) + offset) / (2.0 * math.pi)
            )
        )
    stiffness, damping = (
        float(effects.stiffness[dof]),
        float(effects.actuator_damping[dof]),
    )
    resisting = float(effects.damping[dof])
    # else the file has no [gains]
    in_loops = np.count_nonzero(effects.stiffness > 0.0) >= len(MOTOR_NAMES)
    if in_loops and damping == 0.0 < resisting:
        notes.append(
            "joints' damping is taken for that of the position loop, which has none of its own"
        )
        damping, resisting = resisting, 0.0
    return JointReading(
        name=name,
        sign=sign,
        offset=offset + 0.0,
        armature=float(effects.armature[dof, dof]),
        damping=resisting,
        friction=float(model.dof_frictionloss[dof]),
        peak_torque=float(effects.peak_torque[dof]),
        speed=math.inf,
        stiffness=stiffness,
        actuator_damping=damping,
    )


def _note_left_out(
    effects: Effects, names: Sequence[str], dofs: Sequence[int], notes: list[str]
) -> None:
    """Say what acts on joints and is no number of a robot file."""
    # a DC motor's, or a loop's of speed
    unheld = np.where(effects.stiffness == 0.0, effects.actuator_damping, 0.0)
    for values, unit, what in (
        (effects.spring, "Nm/rad", "springs parallel to joints"),
        (effects.beyond, f"Nm at {FAST:g} rad/s", "damping that is not viscous"),
        (
            unheld,
            "Nm s/rad",
            "damping by actuators that are told nothing and have no stiffness",
        ),
        (
            effects.told_damping,
            "Nm s/rad",
            "damping by actuators that are told how much",
        ),
    ):
        felt: dict[str, list[str]] = {}
        for name, dof in zip(names, dofs, strict=True):
            if abs(values[dof]) > ROUNDING:
                felt.setdefault(f"{values[dof]:.4g} {unit}", []).append(name)
        if felt:
            at = "; ".join(
                f"{amount} at {', '.join(joints)}" for amount, joints in felt.items()
            )
            notes.append(f"left out: {what}, {at}")
    if effects.others > ROUNDING:
        notes.append(
            f"left out: forces of a fluid or against gravity, up to {effects.others:.3g} N or Nm"
        )


def _range(
    model: mujoco.MjModel, j: int, joint: JointReading, notes: list[str]
) -> Range:
    if not model.jnt_limited[j]:
        notes.append(
            f"joint '{joint.name}' has no range: it may turn by pi to either side"
        )
        return -math.pi, math.pi
    low, high = sorted(
        joint.sign * float(end) + joint.offset for end in model.jnt_range[j]
    )
    return low, high


# --- Feet -----------------------------------------------------------------------------


def _feet(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    chains: list[_Chain],
    named: Sequence[str],
    radius: float | None,
) -> list[_Foot]:
    if not named:
        return [_farthest(model, data, chain, radius) for chain in chains]
    if len(named) != len(LEGS):
        raise ReadingError(
            f"`feet` must be four names of geoms or sites, in the order FR, FL, RR, RL, got {named}"
        )
    return [
        _named_foot(model, data, chain, name, radius)
        for chain, name in zip(chains, named, strict=True)
    ]


def _named_foot(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    chain: _Chain,
    name: str,
    radius: float | None,
) -> _Foot:
    geom, site, body = (
        mujoco.mj_name2id(model, kind, name)
        for kind in (
            mujoco.mjtObj.mjOBJ_GEOM,
            mujoco.mjtObj.mjOBJ_SITE,
            mujoco.mjtObj.mjOBJ_BODY,
        )
    )
    if max(geom, site, body) < 0:
        raise ReadingError(
            f"`feet` names '{name}', and there is no such geom, site or body (meshes are left out)"
        )
    holder = (
        model.geom_bodyid[geom]
        if geom >= 0
        else model.site_bodyid[site]
        if site >= 0
        else body
    )
    if model.body_weldid[holder] != chain.bodies[-1]:
        raise ReadingError(
            f"`feet` names '{name}', which is not on the last link of its leg: order FR, FL, RR, RL"
        )
    if geom >= 0 and int(model.geom_type[geom]) in (SPHERE, CAPSULE):
        return _lowest(model, data, chain, [geom], radius)
    if radius is None:
        raise ReadingError(
            f"'{name}' is no sphere: say the radius of the sphere that it becomes as `foot_radius`, m"
        )
    center = (
        data.geom_xpos[geom]
        if geom >= 0
        else data.site_xpos[site]
        if site >= 0
        else data.xpos[body]
    )
    return _Foot(
        name,
        np.array(center),
        radius,
        float(model.geom_friction[geom, 0]) if geom >= 0 else 1.0,
    )


def _farthest(
    model: mujoco.MjModel, data: mujoco.MjData, chain: _Chain, radius: float | None
) -> _Foot:
    """Return the foot of a leg: its farthest sphere that collides, or capsule that
    does, or one that does not.

    Raises:
        ReadingError: there is none, or a part of another shape that collides is farther
            from the knee.
    """
    geoms = [
        g
        for g in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[g]] == chain.bodies[-1]
    ]
    colliding = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
    kinds = [
        [g for g in of if model.geom_type[g] == kind]
        for of in (colliding, geoms)
        for kind in (SPHERE, CAPSULE)
    ]
    link = f"the last link of the leg, body '{model.body(chain.bodies[-1]).name}', has"
    mend = "name a geom, a site or a body in each foot as `feet`, with a `foot_radius`"
    if not any(kinds):
        raise ReadingError(f"{link} no sphere that could be its foot: {mend}")
    foot = _lowest(model, data, chain, next(of for of in kinds if of), radius)
    knee = data.xanchor[chain.joints[2]]
    length = float(np.linalg.norm(foot.center - knee))
    down = (foot.center - knee) / length
    for g in colliding:
        axes, box = data.geom_xmat[g].reshape(3, 3), model.geom_aabb[g]
        farthest = (
            down @ (data.geom_xpos[g] + axes @ box[:3] - knee)
            + np.abs(axes.T @ down) @ box[3:]
        )
        if (
            model.geom_type[g] not in (SPHERE, CAPSULE)
            and farthest > length + (1.0 + LEVEL) * foot.radius
        ):
            raise ReadingError(
                f"{link} '{foot.name}', and beyond it '{model.geom(g).name or f'geom {g}'}': {mend}"
            )
    return foot


def _lowest(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    chain: _Chain,
    geoms: Sequence[int],
    radius: float | None,
) -> _Foot:
    """Return the sphere that is farthest from the knee's axis; the middle of all that
    are equally far.

    So of a capsule across a toe it is the middle, on either side of the robot, and of
    one along a shank the end.
    """
    j, of = chain.joints[2], np.tile(geoms, 2)  # a geom for each of its two ends
    half = np.where(
        model.geom_type[of] == CAPSULE, model.geom_size[of, 1], 0.0
    ) * np.repeat((1.0, -1.0), len(geoms))
    centers = (
        data.geom_xpos[of]
        + half[:, None] * data.geom_xmat[of].reshape(-1, 3, 3)[:, :, 2]
    )
    radii = model.geom_size[of, 0]
    reach = (
        np.linalg.norm(np.cross(centers - data.xanchor[j], data.xaxis[j]), axis=1)
        + radii
    )
    first = int(np.argmax(reach))
    lowest = reach > reach[first] - LEVEL * radii[first]
    return _Foot(
        model.geom(of[first]).name or f"geom {of[first]}",
        np.mean(centers[lowest], axis=0),
        float(np.mean(radii[lowest])) if radius is None else radius,
        float(model.geom_friction[of[first], 0]),
    )


# --- What is told by more than one leg ------------------------------------------------


def _stand(
    model: mujoco.MjModel,
    chains: list[_Chain],
    found: list[_LegReading],
    notes: list[str],
) -> tuple[float, ...]:
    """Return the twelve angles of the keyframe in which the robot stands; zeros where
    there is none."""
    keys = {model.key(i).name: i for i in range(model.nkey)}
    key = next((keys[name] for name in ("stand", "home", *keys) if name in keys), None)
    if key is None:
        return (0.0,) * len(MOTOR_NAMES)
    joints = [joint for one in found for joint in one.joints]
    theirs = [
        model.key_qpos[key, model.jnt_qposadr[j]]
        for chain in chains
        for j in chain.joints[:3]
    ]
    drawn = [
        joint.sign * float(angle) + joint.offset
        for joint, angle in zip(joints, theirs, strict=True)
    ]
    angles = np.clip(
        drawn, *np.transpose([ends for one in found for ends in one.leg.ranges])
    )
    beyond = np.abs(drawn - angles)
    worst = int(np.argmax(beyond))
    if beyond[worst] > ROUNDING:
        notes.append(
            f"the keyframe '{model.key(key).name}' leaves the joints' ranges by up to {beyond[worst]:.3g} rad, at "
            f"'{joints[worst].name}': the ranges' ends are taken"
        )
    return tuple(float(angle) for angle in angles)


def _bend(leg: str, one: _LegReading, stand: float, notes: list[str]) -> Any:
    """Return the sign of the knee's angle: as it stands, in most of its range, or as it
    is drawn."""
    low, high = one.leg.ranges[2]
    one_sided = 0.5 * (low + high) if abs(low + high) > 0.5 * (high - low) else 0.0
    for angle in (stand, one_sided, one.drawn_knee):
        if abs(angle) > 0.05:
            return 1 if angle > 0.0 else -1
    notes.append(f"nothing tells how the knee of {leg} bends: ASSUMED backwards")
    return -1


def _assumed_stand(legs: Sequence[Leg]) -> tuple[float, ...]:
    """Return angles at which each foot is below its hip, at a share of the leg's
    length."""
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
    """Say where legs differ in what a robot file gives for abad, hip and knee alone."""
    for name, what in BY_JOINT.items():
        for i, kind in enumerate(JOINTS):
            values = [getattr(joint, name) for joint in joints[i::3]]
            if not np.allclose(values, values[0], rtol=1e-6):
                shown = ", ".join(f"{value:g}" for value in values)
                notes.append(
                    f"the legs' {what} at the {kind} differ ({shown}): their mean is taken"
                )


def _note_mass_matrix(
    model: mujoco.MjModel,
    trunk: int,
    chains: Sequence[_Chain],
    anatomy: Anatomy,
    joints: Sequence[JointReading],
    notes: list[str],
) -> None:
    """Compare the model's mass matrix, in a pose drawn at random, with that of the
    robot that its file can hold."""
    built, order = (
        build_spec(anatomy).compile(),
        [j for chain in chains for j in chain.joints],
    )
    ours, theirs, motors = (
        mujoco.MjData(built),
        _at_zero(model),
        motor_indices(built.nv),
    )
    angles = np.random.default_rng(0).uniform(
        *np.transpose([ends for leg in anatomy.legs for ends in leg.ranges])
    )
    ours.qpos[:7], ours.qpos[motors + 1] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), angles
    moved = model.jnt_qposadr[[j for chain in chains for j in chain.joints[:3]]]
    theirs.qpos[moved] = [
        joint.sign * (angle - joint.offset)
        for joint, angle in zip(joints, angles, strict=True)
    ]
    built.dof_armature[:] = 0.0
    built.dof_armature[motors] = np.tile(
        np.mean(np.reshape([joint.armature for joint in joints], (4, 3)), axis=0), 4
    )
    found, wanted = mass_matrix(built, ours), mass_matrix(model, theirs)
    free = np.arange(6) + model.body_dofadr[trunk]
    if np.any(held := [*model.dof_armature[free], *model.dof_damping[free]]):
        notes.append(
            f"left out: armature or damping of the trunk's free joint, up to {max(held):g}"
        )
    dofs = [*free, *model.jnt_dofadr[order]]
    sign = np.sign([*[1.0] * 6, *np.sum(ours.xaxis[1:] * theirs.xaxis[order], axis=1)])
    wanted = wanted[np.ix_(dofs, dofs)] * np.outer(sign, sign)
    wanted[range(6), range(6)] -= model.dof_armature[free]
    off = (
        np.max((found - wanted) ** 2 / np.outer(np.diag(wanted), np.diag(wanted)))
        ** 0.5
    )
    if off > ROUNDING:
        notes.append(
            f"the robot's mass matrix is not the model's: it is off by up to {off:.2g} of its diagonal"
        )


def _trunk_size(
    model: mujoco.MjModel, data: mujoco.MjData, trunk: int, legs: Sequence[Leg]
) -> Vector:
    """Return half extents of the box about the trunk's origin that holds its geoms,
    those that collide if any do."""
    geoms = [
        g
        for g in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[g]] == trunk
    ]
    colliding = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
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
    return _vector(np.max(boxes or extents, axis=0))


def _radius(model: mujoco.MjModel, parts: Sequence[int], thigh_length: float) -> float:
    """Return the radius of the longest capsule or cylinder on some links."""
    geoms = [
        (float(model.geom_size[g, 1]), float(model.geom_size[g, 0]))
        for g in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[g]] in parts
        and int(model.geom_type[g]) in (CAPSULE, CYLINDER)
        and model.geom_size[g, 1] > model.geom_size[g, 0]
        and (
            model.geom_contype[g]
            or model.geom_conaffinity[g]
            or model.geom_group[g] == 3
        )
    ]
    return max(geoms)[1] if geoms else SLENDER * thigh_length


def _spring(
    model: mujoco.MjModel, chains: list[_Chain], notes: list[str]
) -> SpringReading | None:
    sprung = [len(chain.joints) == 4 for chain in chains]
    if not any(sprung):
        return None
    if not all(sprung):
        raise ReadingError(
            "some legs have a spring and some have none: give all of them one, or none"
        )
    read: list[tuple[float, float, float]] = []
    for chain in chains:
        j = chain.joints[3]
        travels = (
            [float(model.jnt_range[j, 1] - model.jnt_range[j, 0])]
            if model.jnt_limited[j]
            else []
        )
        for i in range(model.ntendon):
            if model.wrap_objid[model.tendon_adr[i]] == j:
                travels += [
                    float(
                        model.tendon_lengthspring[i, 1]
                        - model.tendon_lengthspring[i, 0]
                    )
                ]
        travel, damping = (
            min(travels, default=LONGEST),
            float(model.dof_damping[model.jnt_dofadr[j]]),
        )
        read.append((float(model.jnt_stiffness[j]), damping, travel))
    if not np.allclose(read, read[0]):
        notes.append("the legs' springs differ: their mean is taken")
    stiffness, damping, travel = (float(x) for x in np.mean(read, axis=0))
    return SpringReading(stiffness, damping, travel)
