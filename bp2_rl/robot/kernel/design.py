"""What the compiled model says of BP2: its masses and lengths, springs, joint stops and contacts."""

import dataclasses
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int

from bp2_rl.base.errors import UserError
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.kernel.vectors import Number, Vector, add, scaled
from bp2_rl.robot.model import foot_geom_ids

TRUNK, LEG = 6, 4  # coordinates of the trunk and of a leg: abad, hip, knee, spring
_FIRST_BODY, _FIRST_JOINT = 2, 1  # of the legs: the world and the trunk, the trunk's free joint stand before them


def _static() -> Any:
    """A field that is known when the program is compiled."""
    return cast(Any, struct).field(pytree_node=False)


@dataclasses.dataclass(frozen=True)
class Softness:
    """How a constraint yields, from MuJoCo's solref and solimp: K, B and the impedance over its depth."""

    stiffness: float  # 1/s2
    damping: float  # 1/s
    least: float  # impedance at the surface
    most: float  # impedance at `width` and beyond
    width: float  # m or rad


class Body(struct.PyTreeNode):
    """A part that every leg has; (4, 1) each."""

    mass: Number  # kg
    inertia: Vector  # kg m2, principal, along its own axes


class Design(struct.PyTreeNode):
    """BP2 as designed; lengths in m. `Design.of(model)` reads it. What differs from leg to leg is (4, 1), over legs."""

    bodies: tuple[Body, ...]  # abad, thigh, shank, toe
    anchor: Vector  # of the abduction joint in the trunk
    abad_com: Number  # along x
    hip: Number  # along y, from the abduction joint
    range_weights: tuple[Number, ...]  # MuJoCo's dof_invweight0 of abad, hip and knee
    foot_weight: Number  # MuJoCo's body_invweight0
    timestep: float = _static()  # s
    gravity: float = _static()  # m/s2
    trunk_mass: float = _static()  # kg
    trunk_inertia: Vector = _static()
    trunk_com: Vector = _static()
    thigh: float = _static()  # from hip to knee
    thigh_com: float = _static()  # below the hip
    shank_com: float = _static()  # below the knee
    toe_com: float = _static()  # below the knee, at no compression
    foot: float = _static()  # of the sole's centre
    foot_radius: float = _static()
    armature: float = _static()  # kg m2, of every motor
    spring: tuple[float, float] = _static()  # N/m, N s/m
    stops: tuple[tuple[float, float, float], ...] = _static()
    """of the spring: N/m, and the least and greatest compression without force"""
    ranges: tuple[tuple[float, float], ...] = _static()  # of abad, hip and knee, rad
    range_softness: Softness = _static()
    floor_softness: Softness = _static()

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Design":
        """Return the design of a model that `robot.model.load_model(feet_only=True)` has compiled.

        Raises:
            UserError: it has something that the kernel does not know.
        """
        feet = foot_geom_ids(model)
        _require_known(model, feet)
        bodies = np.arange(_FIRST_BODY, model.nbody).reshape(len(LEGS), LEG)
        _, thigh, shank, toe = bodies[0]
        knee_to_toe = -float(model.body_pos[toe, 2])
        first = slice(_FIRST_JOINT, _FIRST_JOINT + 3)
        return cls(
            timestep=float(model.opt.timestep),
            gravity=-float(model.opt.gravity[2]),
            trunk_mass=float(model.body_mass[1]),
            trunk_inertia=_vector(model.body_inertia[1]),
            trunk_com=_vector(model.body_ipos[1]),
            bodies=tuple(Body(_column(model.body_mass[part]), _columns(model.body_inertia[part])) for part in bodies.T),
            anchor=_columns(model.body_pos[bodies[:, 0]]),
            abad_com=_column(model.body_ipos[bodies[:, 0], 0]),
            hip=_column(model.body_pos[bodies[:, 1], 1]),
            thigh=-float(model.body_pos[shank, 2]),
            thigh_com=-float(model.body_ipos[thigh, 2]),
            shank_com=-float(model.body_ipos[shank, 2]),
            toe_com=knee_to_toe - float(model.body_ipos[toe, 2]),
            foot=knee_to_toe - float(model.geom_pos[feet[0], 2]),
            foot_radius=float(model.geom_size[feet[0], 0]),
            armature=float(model.dof_armature[TRUNK]),
            spring=(float(model.jnt_stiffness[LEG]), float(model.dof_damping[TRUNK + LEG - 1])),
            stops=_stops(model, 0),
            ranges=tuple((float(low), float(high)) for low, high in model.jnt_range[first]),
            range_weights=tuple(_column(x) for x in model.dof_invweight0[TRUNK:].reshape(len(LEGS), LEG)[:, :3].T),
            range_softness=_softness(model, model.jnt_solref[_FIRST_JOINT], model.jnt_solimp[_FIRST_JOINT]),
            foot_weight=_column(model.body_invweight0[bodies[:, 3], 0]),
            floor_softness=_softness(model, model.geom_solref[feet[0]], model.geom_solimp[feet[0]]),
        )


class Masses(NamedTuple):
    """Masses of one draw of robots, kg; principal inertias, kg m2; the trunk's centre of mass, m."""

    trunk: Number
    trunk_inertia: Vector
    trunk_com: Vector
    bodies: tuple[Number, ...]  # abad, thigh, shank, toe
    inertias: tuple[Vector, ...]

    @classmethod
    def of(cls, design: Design, factors: Float[Array, "18 N"], com_offset: Float[Array, "3 N"]) -> "Masses":
        """Return the masses of a design whose bodies are heavier by these factors, in MuJoCo's order."""
        trunk, legs = factors[1], factors[2:].reshape(4, 4, -1)
        com = add(design.trunk_com, (com_offset[0], com_offset[1], com_offset[2]))
        return cls(
            trunk=design.trunk_mass * trunk,
            trunk_inertia=scaled(trunk, design.trunk_inertia),
            trunk_com=com,
            bodies=tuple(body.mass * legs[:, i] for i, body in enumerate(design.bodies)),
            inertias=tuple(scaled(legs[:, i], body.inertia) for i, body in enumerate(design.bodies)),
        )


class Robots(NamedTuple):
    """Robots of one design that differ in their masses and in the friction of the floor under them."""

    design: Design
    masses: Masses
    friction: Number  # (N,)


def _softness(model: mujoco.MjModel, reference: np.ndarray, impedance: np.ndarray) -> Softness:
    least, most, width, middle, power = (float(x) for x in impedance)
    time, ratio = (float(x) for x in reference)
    _require(time > 0 and (middle, power) == (0.5, 2.0), "a constraint's solref or solimp")
    time = max(time, 2.0 * float(model.opt.timestep))
    return Softness(1.0 / (most * time * ratio) ** 2, 2.0 / (most * time), least, most, width)


def _stops(model: mujoco.MjModel, leg: int) -> tuple[tuple[float, float, float], ...]:
    """The tendons along a leg's spring."""
    spring = _FIRST_JOINT + LEG * leg + LEG - 1
    mine = np.flatnonzero(model.wrap_objid[model.tendon_adr] == spring)
    ranges = model.tendon_lengthspring[mine]
    return tuple(
        (float(stiffness), float(least), float(most))
        for stiffness, (least, most) in zip(model.tendon_stiffness[mine], ranges, strict=True)
    )


def _require_known(model: mujoco.MjModel, feet: Int[np.ndarray, "4"]) -> None:
    legs = range(len(LEGS))
    bodies = np.arange(_FIRST_BODY, model.nbody).reshape(len(LEGS), LEG)
    joints = slice(_FIRST_JOINT, model.njnt)
    same = np.array([1.0, 0.0, 0.0, 0.0])
    _require(np.array_equal(model.body_parentid[bodies], np.c_[np.ones(4), bodies[:, :-1]]), "the tree of its bodies")
    _require(
        np.all(model.body_iquat[1:] == same) and np.all(model.body_quat[1:] == same) and np.all(model.jnt_pos == 0),
        "turned bodies",
    )
    axes = np.tile([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], (len(LEGS), 1))
    _require(np.array_equal(model.jnt_axis[joints], axes), "the axes of its joints")
    off = [model.body_ipos[bodies[:, 0]][:, 1:], model.body_ipos[bodies[:, 1:]][:, :, :2]]
    off += [model.body_pos[bodies[:, 0]][:, 2:], model.body_pos[bodies[:, 1]][:, ::2]]
    off += [model.body_pos[bodies[:, 2:]][:, :, :2], model.geom_pos[feet][:, :2]]
    _require(all(np.all(x == 0) for x in off), "parts off their axes")
    for name in ("body_pos", "body_ipos"):  # but for the sides, legs are equal
        _require(np.ptp(getattr(model, name)[bodies[:, 2:]], axis=0).max() == 0, "legs of different lengths")
    of_legs = (
        model.jnt_stiffness[joints],
        model.jnt_range[joints],
        model.dof_damping[TRUNK:],
        model.dof_armature[TRUNK:],
    )
    for x in (*of_legs, np.array([_stops(model, leg) for leg in legs])):
        _require(np.ptp(x.reshape(len(LEGS), -1), axis=0).max() == 0, "unlike legs")
    motors = np.flatnonzero(model.jnt_limited)
    for x in (model.jnt_solref[motors], model.jnt_solimp[motors], model.dof_armature[TRUNK:].reshape(-1, LEG)[:, :3].T):
        _require(np.ptp(x, axis=0).max() == 0, "unlike joints")
    for x in (model.geom_solref[feet], model.geom_solimp[feet], model.geom_size[feet]):
        _require(np.ptp(x, axis=0).max() == 0, "unlike feet")
    _require(np.all(model.dof_damping[TRUNK:].reshape(-1, LEG)[:, :3] == 0), "damped joints")
    _require(not np.any(model.dof_frictionloss), "dry friction in MuJoCo's own joints")
    _require(len(feet) == len(legs) and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL, "other contacts")


def _require(known: Any, what: str) -> None:
    if not known:
        raise UserError(f"--impl kernel does not know {what} as in this model: use --impl jax")


def _column(x: Float[np.ndarray, "4"]) -> Float[Array, "4 1"]:
    return cast(Array, x.reshape(len(LEGS), 1))  # NumPy's until a program takes it


def _columns(x: Float[np.ndarray, "4 3"]) -> Vector:
    return _column(x[:, 0]), _column(x[:, 1]), _column(x[:, 2])


def _vector(x: Float[np.ndarray, "3"]) -> Vector:
    return float(x[0]), float(x[1]), float(x[2])
