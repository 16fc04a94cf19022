"""Express a leg of a model in the frames of `Anatomy`, in which a leg hangs straight
down at zero angles.

Every part that moves is merged with what is welded to it.
"""

import dataclasses
import math
from typing import NamedTuple

import mujoco
import numpy as np

from bp2_rl.base.bounds import Range
from bp2_rl.robot.anatomy import JointConvention, Leg, Link, Vector, six
from bp2_rl.robot.compiling import ReadingError
from bp2_rl.robot.conventions import MOTOR_NAMES
from bp2_rl.robot.effects import Effects
from bp2_rl.robot.limbs import Foot, Limb

PARALLEL = 1e-3
"""Largest angle between a joint's axis and its nominal direction, rad."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class JointReading(JointConvention):
    """Armature, damping, friction, gains and limits of a motor's joint, as a model
    gives them."""

    armature: float  # kg m2
    damping: float  # Nm s/rad
    friction: float  # Nm
    peak_torque: float  # Nm; inf: the model has no limit
    speed: float  # rad/s, the limit in its URDF; inf: the model has none
    stiffness: float  # Nm/rad, of its position actuator; 0: it has none
    actuator_damping: float  # Nm s/rad, of that; the joint's, where that has none


class LegReading(NamedTuple):
    """A leg and its joints as read from a model."""

    leg: Leg
    joints: list[JointReading]
    drawn_knee: float  # rad, the knee's angle as the model is drawn


def read_leg(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    effects: Effects,
    chain: Limb,
    foot: Foot,
    notes: list[str],
) -> LegReading:
    """Return a leg in the frames of `Anatomy`, with its joints; append what was assumed
    to `notes`."""
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
        seat = as_vector(
            turned[2] @ (data.xpos[chain.bodies[3]] - anchors[2]), flat=False
        )
        toe = merged_link(
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
        anchor=as_vector(anchors[0]),
        hip=as_vector(turned[0] @ (anchors[1] - anchors[0])),
        knee=as_vector(turned[1] @ (anchors[2] - anchors[1]), flat=True),
        foot=as_vector(turned[2] @ (foot.center - anchors[2]), flat=True),
        foot_radius=foot.radius,
        abad=merged_link(model, data, chain.bodies[0], anchors[0], turned[0]),
        thigh=merged_link(model, data, chain.bodies[1], anchors[1], turned[1]),
        shank=merged_link(model, data, chain.bodies[2], anchors[2], turned[2]),
        toe=toe,
        seat=seat,
        ranges=(abad_range, hip_range, knee_range),
    )
    return LegReading(leg, joints, -angle[2])


def _require_axis(
    joint: str, role: str, axis: np.ndarray, share: float, wanted: str
) -> None:
    """Raise `ReadingError` unless a joint's axis is parallel to the wanted direction;
    `share` is their cosine."""
    if share < math.cos(PARALLEL):
        shown = ", ".join(f"{x:.3f}" for x in axis)
        raise ReadingError(
            f"joint '{joint}' turns about ({shown}) in the trunk's frame, and as its leg's {role} it should turn about "
            f"{wanted}: other joint axes cannot be; if the trunk's x does not point forward, turn the trunk's frame"
        )


def _turn(axis: int, angle: float) -> np.ndarray:
    """Return the matrix of a rotation about x (`axis` 0) or y (1), by an angle in
    rad."""
    c, s = math.cos(angle), math.sin(angle)
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _to_hang(lever: np.ndarray, what: str, above: str) -> float:
    """Return the angle about y, rad, that turns a lever straight down."""
    if math.hypot(lever[0], lever[2]) < 1e-3:
        raise ReadingError(
            f"'{what}' is on the axis of joint '{above}': a leg's segments need a length"
        )
    return math.atan2(lever[0], -lever[2])


def merged_link(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    part: int,
    origin: np.ndarray,
    turned: np.ndarray,
) -> Link:
    """Return a moving body merged with all bodies welded to it, about `origin` and in
    axes turned by `turned`."""
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
        mass, as_vector(turned @ (com - origin)), six(turned @ inertia @ turned.T)
    )


def as_vector(xyz: np.ndarray, flat: bool = False) -> Vector:
    """Return a vector as three floats; `flat` sets x to 0 where only rounding keeps it
    from 0."""
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
    """Read a joint of a model; `zero` is its angle in `Anatomy`, rad, in the pose in
    which the model is drawn."""
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
    stiffness = float(effects.stiffness[dof])
    damping = float(effects.actuator_damping[dof])
    resisting = float(effects.damping[dof])
    # else the file has no [gains]
    in_loops = np.count_nonzero(effects.stiffness > 0.0) >= len(MOTOR_NAMES)
    if in_loops and damping == 0.0 < resisting:
        notes.append(
            "the joints' damping is taken as the position loop's, which has none"
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
