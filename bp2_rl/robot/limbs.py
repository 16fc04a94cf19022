"""Find the trunk, the four legs and their feet in a compiled model, by structure,
unless names tell."""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from bp2_rl.robot.compiling import ReadingError
from bp2_rl.robot.conventions import LEGS

LEVEL = 0.1
"""Share of a foot's radius by which spheres may be nearer to the knee than the farthest
sphere and still belong to the foot."""
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)
CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
CYLINDER = int(mujoco.mjtGeom.mjGEOM_CYLINDER)
CLOSING = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)


class Limb(NamedTuple):
    """A limb's moving bodies from the trunk downwards, and their joints."""

    bodies: list[int]  # that move: abad, thigh, shank, and a toe
    joints: list[int]


def find_trunk(model: mujoco.MjModel) -> int:
    """Return the id of the one free body that carries limbs."""
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
    """Return the moving bodies that a joint ties to a moving body, or to a body welded
    to it."""
    return [
        body
        for body in range(1, model.nbody)
        if model.body_weldid[body] == body
        and body != part
        and model.body_weldid[model.body_parentid[body]] == part
    ]


def require_no_couplings(model: mujoco.MjModel) -> None:
    """Raise `ReadingError` for constraints or tendons that couple joints or close
    loops."""
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


def find_legs(model: mujoco.MjModel, trunk: int, joints: Sequence[str]) -> list[Limb]:
    """Return the legs in the order of `LEGS`."""
    limbs = [_limb(model, body) for body in _moved_by(model, trunk)]
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
    data = at_zero(model)
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
    model: mujoco.MjModel, limbs: list[Limb], joints: Sequence[str]
) -> list[Limb]:
    names = [[model.joint(j).name for j in chain.joints[:3]] for chain in limbs]
    requested = [list(joints[i : i + 3]) for i in range(0, len(joints), 3)]
    if sorted(names) != sorted(requested):
        raise ReadingError(
            f"`joints` must be 12 names, legs FR, FL, RR, RL, each abad, hip, knee; there are {names}"
        )
    return [limbs[names.index(leg)] for leg in requested]


def _limb(model: mujoco.MjModel, body: int) -> Limb:
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
    return Limb(bodies, [int(model.body_jntadr[body]) for body in bodies])


def _require_leg(model: mujoco.MjModel, chain: Limb) -> None:
    """Raise `ReadingError` unless a limb has three hinges and, below them, at most one
    slide."""
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


def at_zero(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the model's data in the pose in which it is drawn, springs at rest, trunk
    at the origin."""
    data, slides = mujoco.MjData(model), model.jnt_qposadr[model.jnt_type == SLIDE]
    data.qpos[slides] = model.qpos_spring[slides]
    for at in model.jnt_qposadr[model.jnt_type == FREE]:
        data.qpos[at : at + 7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    mujoco.mj_kinematics(model, data)
    return data


def geoms_of(model: mujoco.MjModel, parts: Sequence[int]) -> list[int]:
    """Return the geoms on these moving bodies and on bodies welded to them."""
    of = model.body_weldid[model.geom_bodyid]
    return np.flatnonzero(np.isin(of, parts)).tolist()


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom can collide with anything."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


# --- Feet -----------------------------------------------------------------------------


class Foot(NamedTuple):
    """The sphere on which a leg stands."""

    name: str
    center: np.ndarray  # (3), m, in the trunk's frame
    radius: float
    friction: float


def find_feet(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    chains: list[Limb],
    named: Sequence[str],
    radius: float | None,
) -> list[Foot]:
    """Return the feet of the legs: those that are named, or else the farthest sphere
    or end of a capsule on each leg."""
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
    chain: Limb,
    name: str,
    radius: float | None,
) -> Foot:
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
    return Foot(
        name,
        np.array(center),
        radius,
        float(model.geom_friction[geom, 0]) if geom >= 0 else 1.0,
    )


def _farthest(
    model: mujoco.MjModel, data: mujoco.MjData, chain: Limb, radius: float | None
) -> Foot:
    """Return the foot of a leg: its farthest sphere or end of a capsule; geoms that
    collide come first, then spheres.

    Raises:
        ReadingError: there is none, or a part of another shape that collides is farther
            from the knee.
    """
    geoms = geoms_of(model, chain.bodies[-1:])
    colliding = [g for g in geoms if collides(model, g)]
    kinds = [
        [g for g in of if model.geom_type[g] == kind]
        for of in (colliding, geoms)
        for kind in (SPHERE, CAPSULE)
    ]
    link = f"the last link of the leg, body '{model.body(chain.bodies[-1]).name}', has"
    remedy = (
        "name a geom, a site or a body in each foot as `feet`, with a `foot_radius`"
    )
    if not any(kinds):
        raise ReadingError(f"{link} no sphere that could be its foot: {remedy}")
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
                f"{link} '{foot.name}', and beyond it '{model.geom(g).name or f'geom {g}'}': {remedy}"
            )
    return foot


def _lowest(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    chain: Limb,
    geoms: Sequence[int],
    radius: float | None,
) -> Foot:
    """Return the sphere, or end of a capsule, that is farthest from the knee's axis;
    the middle of all that are equally far.

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
    return Foot(
        model.geom(of[first]).name or f"geom {of[first]}",
        np.mean(centers[lowest], axis=0),
        float(np.mean(radii[lowest])) if radius is None else radius,
        float(model.geom_friction[of[first], 0]),
    )
