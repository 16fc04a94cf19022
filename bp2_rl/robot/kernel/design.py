"""Read a robot's design from a compiled model: masses, lengths, springs, limits,
contacts.

The kernel's robots are quadrupeds whose legs hang straight down at zero joint angles,
the axes of all bodies parallel: abad turns about x, hip and knee about y, and a spring,
if shanks have one, shortens them along z.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import jax
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from bp2_rl.base.errors import UserError
from bp2_rl.robot.kernel.bodies import Body, Inertia
from bp2_rl.robot.kernel.vectors import NOWHERE, ZERO, Number, Vector, add
from bp2_rl.robot.model import foot_geom_ids

# coordinates of the trunk; a leg has three, abad, hip and knee, or four with a spring
TRUNK = 6
UNLIMITED = 1e6  # rad, where no joint ever is


class Softness(NamedTuple):
    """Compliance of a constraint, from MuJoCo's solref and solimp: K, B and the
    impedance over its depth."""

    stiffness: Number  # 1/s2
    damping: Number  # 1/s
    least: Number  # impedance at the surface
    most: Number  # impedance at `width` and beyond
    width: Number  # m or rad


@jax.tree_util.register_pytree_node_class
@dataclasses.dataclass(frozen=True)
class Design:
    """A robot's masses, lengths (m), springs, limits and contacts, as
    `Design.of(model)` reads them.

    A number is `ZERO` or a float if it is the same for all legs, and known when a
    program is traced; otherwise (4, 1). Armature, damping and stiffness may also be
    arrays over robots, (N,) or (4, N).
    """

    timestep: Number  # s
    gravity: Vector  # m/s2, world's axes
    trunk: Body
    links: tuple[Body, ...]  # abad, thigh, shank and, with a spring, toe
    anchor: Vector  # of the abduction joint in the trunk
    hip: Vector  # from the abduction joint
    knee: Vector  # from the hip
    toe: Vector  # from the knee, the spring at rest
    foot: Vector  # the centre of its sole, from the frame of the last link
    foot_radius: Number
    armature: tuple[Number, ...]  # of a leg's coordinates, kg m2 and kg
    damping: tuple[Number, ...]  # Nm s/rad and N s/m
    stiffness: Number  # of the spring, N/m
    stops: tuple[tuple[Number, Number, Number], ...]
    """stops of the spring: stiffness, N/m, and the least and greatest compression
    without force"""
    ranges: tuple[tuple[Number, Number], ...]  # of abad, hip and knee, rad
    range_weights: tuple[Number, ...]  # MuJoCo's dof_invweight0 of abad, hip and knee
    range_softness: Softness
    foot_weight: Number  # MuJoCo's body_invweight0
    floor_softness: Softness

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Design":
        """Read the design from a compiled model in which only feet and floor touch.

        Raises:
            UserError: it has something that the kernel does not know.
        """
        feet = foot_geom_ids(model)
        _require_known(model, feet)
        bodies, joints, dofs = (x.reshape(4, -1) for x in _of_legs(model))
        anchor, hip, knee, *toe = (_vector(model.body_pos[part]) for part in bodies.T)
        limited = model.jnt_limited[joints[:, :3], None].astype(bool)
        ranges = np.where(
            limited, model.jnt_range[joints[:, :3]], (-UNLIMITED, UNLIMITED)
        )
        joint = max(int(np.argmax(model.jnt_limited)), 1)
        return cls(
            timestep=float(model.opt.timestep),
            gravity=_vector(model.opt.gravity[None]),
            trunk=_body(model, np.array([1])),
            links=tuple(_body(model, part) for part in bodies.T),
            anchor=anchor,
            hip=hip,
            knee=knee,
            toe=toe[0] if toe else NOWHERE,
            foot=_vector(model.geom_pos[feet]),
            foot_radius=_shared(model.geom_size[feet, 0]),
            armature=tuple(_number(x) for x in model.dof_armature[dofs].T),
            damping=tuple(_number(x) for x in model.dof_damping[dofs].T),
            stiffness=_number(model.jnt_stiffness[joints[:, -1]]),
            stops=tuple(
                (_shared(x[:, 0]), _shared(x[:, 1]), _shared(x[:, 2]))
                for x in _stops(model)
            ),
            ranges=tuple(
                (_shared(x[:, 0]), _shared(x[:, 1])) for x in ranges.swapaxes(0, 1)
            ),
            range_weights=tuple(
                _shared(x) for x in model.dof_invweight0[dofs[:, :3]].T
            ),
            range_softness=_softness(
                model, model.jnt_solref[joint], model.jnt_solimp[joint]
            ),
            foot_weight=_shared(model.body_invweight0[bodies[:, -1], 0]),
            floor_softness=_softness(
                model, model.geom_solref[feet[0]], model.geom_solimp[feet[0]]
            ),
        )

    def tree_flatten(self) -> tuple[list[Any], Any]:
        """Return the design's arrays, and the parts that are known when JAX traces a
        program."""
        numbers, structure = jax.tree.flatten(
            [getattr(self, field.name) for field in dataclasses.fields(self)]
        )
        known = tuple(x if isinstance(x, float) else None for x in numbers)
        return [x for x in numbers if not isinstance(x, float)], (structure, known)

    @classmethod
    def tree_unflatten(cls, known: Any, arrays: Any) -> "Design":
        """Return the design from the parts that `tree_flatten` returned."""
        rest: Iterator[Any] = iter(arrays)
        return cls(
            *jax.tree.unflatten(
                known[0], [next(rest) if x is None else x for x in known[1]]
            )
        )


class Masses(NamedTuple):
    """Masses and inertias of trunk and links in a batch of randomised robots."""

    trunk: Body
    links: tuple[Body, ...]

    @classmethod
    def of(
        cls,
        design: Design,
        factors: Float[Array, "bodies N"],
        com_offset: Float[Array, "3 N"],
    ) -> "Masses":
        """Return the design's bodies with masses times `factors`, in MuJoCo's order,
        and the trunk's centre of mass moved."""
        trunk = design.trunk.times(factors[1])
        links = factors[2:].reshape(4, -1, factors.shape[-1])
        com = add(trunk.com, (com_offset[0], com_offset[1], com_offset[2]))
        return cls(
            trunk._replace(com=com),
            tuple(body.times(links[:, i]) for i, body in enumerate(design.links)),
        )


class Robots(NamedTuple):
    """Robots that differ in masses, springs and rotors, and in the friction of the floor
    under them."""

    design: Design
    masses: Masses
    friction: Number  # (N,)


def _softness(
    model: mujoco.MjModel, reference: np.ndarray, impedance: np.ndarray
) -> Softness:
    least, most, width, middle, power = (float(x) for x in impedance)
    time, ratio = (float(x) for x in reference)
    _require(
        time > 0 and (middle, power) == (0.5, 2.0), "a constraint's solref or solimp"
    )
    time = max(time, 2.0 * float(model.opt.timestep))
    return Softness(
        1.0 / (most * time * ratio) ** 2, 2.0 / (most * time), least, most, width
    )


def _of_legs(model: mujoco.MjModel) -> tuple[Int[np.ndarray, " n"], ...]:
    """Return the ids of the legs' bodies, joints and velocity coordinates, leg by
    leg."""
    return (
        np.arange(2, model.nbody),
        np.arange(1, model.njnt),
        np.arange(TRUNK, model.nv),
    )


def _stops(model: mujoco.MjModel) -> Float[np.ndarray, "stops 4 3"]:
    """Return stiffness and range without force of the tendons along the legs'
    springs."""
    along = model.wrap_objid[model.tendon_adr]
    order = np.argsort(along, kind="stable")
    stops = np.c_[model.tendon_stiffness, model.tendon_lengthspring][order]
    return stops.reshape(4, -1, 3).swapaxes(0, 1)


def _body(model: mujoco.MjModel, parts: Int[np.ndarray, " n"]) -> Body:
    turns = np.zeros((len(parts), 9))
    for turn, part in zip(turns, parts, strict=True):
        mujoco.mju_quat2Mat(turn, model.body_iquat[part])
    turns = turns.reshape(-1, 3, 3)
    inertia = np.einsum("nij,nj,nkj->ikn", turns, model.body_inertia[parts], turns)
    entries = [
        inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    ]
    return Body(
        _number(model.body_mass[parts]),
        _vector(model.body_ipos[parts]),
        Inertia(*map(_number, entries)),
    )


def _require_known(model: mujoco.MjModel, feet: Int[np.ndarray, "4"]) -> None:
    """Raise `UserError` if a model has something that the kernel's equations leave
    out."""
    tree = "the tree of its bodies"
    _require(
        model.nbody in (14, 18)
        and np.array_equal(model.jnt_bodyid, np.arange(1, model.nbody)),
        tree,
    )
    bodies, joints, _ = (x.reshape(4, -1) for x in _of_legs(model))
    _require(
        np.array_equal(model.body_parentid[bodies], np.c_[np.ones(4), bodies[:, :-1]]),
        tree,
    )
    _require(np.array_equal(model.geom_bodyid[feet], bodies[:, -1]), tree)
    hinges = joints[:, :3]
    springs = joints[:, 3:]
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    kinds = [hinge, hinge, hinge, slide]
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]])
    along, each = np.unique(model.wrap_objid[model.tendon_adr], return_counts=True)
    limited = np.flatnonzero(model.jnt_limited)
    gains = (
        model.jnt_stiffnesspoly,
        model.dof_dampingpoly,
        model.tendon_stiffnesspoly,
        model.tendon_dampingpoly,
    )
    no_tendon = (
        model.tendon_limited,
        model.tendon_damping,
        model.tendon_frictionloss,
        model.tendon_armature,
    )
    option = model.opt
    meeting = (model.geom_contype[:, None] & model.geom_conaffinity) != 0
    meeting = (meeting | meeting.T) & (model.geom_bodyid[:, None] != model.geom_bodyid)
    floor, on_floor = int(np.argmax(meeting[feet[0]])), np.zeros_like(meeting)
    on_floor[floor, feet] = on_floor[feet, floor] = True
    contact = np.c_[model.geom_solref, model.geom_solimp]
    checks: list[tuple[str, Any]] = [
        (
            "turned bodies",
            np.all(model.body_quat[1:] == (1, 0, 0, 0)) and not np.any(model.jnt_pos),
        ),
        (
            "the axes of its joints",
            np.all(model.jnt_axis[joints] == axes[: joints.shape[1]]),
        ),
        (
            "the axes of its joints",
            np.all(model.jnt_type[joints] == kinds[: joints.shape[1]]),
        ),
        ("springs parallel to joints", not np.any(model.jnt_stiffness[hinges])),
        ("limited or preloaded springs", not np.any(model.jnt_limited[springs])),
        (
            "limited or preloaded springs",
            not np.any(model.qpos_spring[model.jnt_qposadr[springs]]),
        ),
        ("stiffness or damping that is not linear", not any(np.any(x) for x in gains)),
        (
            "tendons but for springs' stops",
            model.ntendon == 0 or np.array_equal(along, springs.ravel()),
        ),
        (
            "tendons but for springs' stops",
            np.all(model.wrap_prm == 1) and not any(np.any(x) for x in no_tendon),
        ),
        ("unlike legs", model.ntendon == 0 or np.ptp(each) == 0),
        (
            "unlike joints",
            _rows_equal(model.jnt_solref[limited])
            and _rows_equal(model.jnt_solimp[limited]),
        ),
        ("margins of joints", not np.any(model.jnt_margin)),
        (
            "a damped trunk",
            not np.any(model.dof_damping[:TRUNK])
            and not np.any(model.dof_armature[:TRUNK]),
        ),
        ("dry friction in MuJoCo's own joints", not np.any(model.dof_frictionloss)),
        ("equality constraints", model.neq == 0),
        ("unlike feet", _rows_equal(contact[feet])),
        ("other contacts", np.array_equal(meeting, on_floor) and model.npair == 0),
        (
            "other contacts",
            option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL and option.impratio == 1.0,
        ),
    ]
    for what, known in checks:
        _require(known, what)


def _rows_equal(x: np.ndarray) -> bool:
    """Return whether all rows of an array are equal."""
    return bool(np.all(x == x[:1]))


def _require(known: Any, what: str) -> None:
    if not known:
        raise UserError(
            f"--impl kernel does not know {what} as in this model: use --impl jax"
        )


def _number(x: Float[np.ndarray, " n"]) -> Number:
    """Return a number for each leg as `ZERO` or a float if all legs have it, else as an
    array (4, 1)."""
    return _shared(x) if np.any(x) else ZERO


def _shared(x: Float[np.ndarray, " n"]) -> Array | float:
    """Return a number for each leg as a float if all legs have it, else as an array (4,
    1); unlike `_number`, never `ZERO`."""
    # NumPy's until a program takes it
    return float(x[0]) if np.ptp(x) == 0 else cast(Array, x[:, None])


def _vector(x: Float[np.ndarray, "n 3"]) -> Vector:
    return _number(x[:, 0]), _number(x[:, 1]), _number(x[:, 2])
