"""Compile an MJCF or URDF file to a MuJoCo model without its meshes.

Meshes need not be there: masses come from `<inertial>`.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.files import LARGEST_TEXT, read_bytes
from bp2_rl.robot.anatomy import Link, possible_moments, six
from bp2_rl.robot.conventions import MOTOR_NAMES

ROUNDING = 1e-6
"""Tolerance: rad by which a keyframe may leave a joint's range; N, Nm, or a share above
which a difference is noted."""


class ReadingError(UserError):
    """Raised for an MJCF that cannot be read, or a robot that is no quadruped with legs
    of abad, hip and knee."""


def compile_file(
    path: Path, joints: Sequence[str] = ()
) -> tuple[mujoco.MjModel, list[str]]:
    """Compile an MJCF or URDF file without its meshes; return the model, and notes on
    what was repaired.

    A fixed base becomes free. Where `joints` are named, the robot's others are welded.

    Raises:
        ReadingError: the file is no MJCF, a part's mass comes from a mesh, or a name
            cannot be shown.
    """
    read_bytes(path, LARGEST_TEXT)
    notes: list[str] = []
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        _free_base(spec, notes)
        _repair_inertias(spec, notes)
        _require_inertias(spec)
        _strip(spec)
        _weld_others(spec, joints)
        model = spec.compile()
    except ReadingError:
        raise
    except (ValueError, TypeError, RuntimeError, mujoco.FatalError) as error:
        raise ReadingError(
            f"it is not an MJCF that MuJoCo can read: {one_line(str(error))}"
        ) from error
    for name in model.names.decode(errors="replace").split("\0"):
        if not name.isprintable():
            raise ReadingError(
                f"it holds the name {name!a}, which no terminal can show: choose another"
            )
    return model, notes


def _free_base(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Give the body that carries the joints a free joint if no body has one, as in a
    URDF, whose base MuJoCo fixes."""
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


def _repair_inertias(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Replace physically impossible inertias, which URDFs have, by the nearest possible
    ones."""
    repaired: list[str] = []
    full = [body for body in spec.bodies if np.all(np.isfinite(body.fullinertia))]
    for body in full if not spec.compiler.balanceinertia else ():
        moments, axes = np.linalg.eigh(
            Link(1.0, (0.0, 0.0, 0.0), tuple(body.fullinertia)).inertia_matrix
        )
        # MuJoCo recomputes the axes to that
        nearest = possible_moments(moments, margin=1e-9)
        if np.any(nearest != moments):
            body.fullinertia = six(axes @ np.diag(nearest) @ axes.T)
        if not np.allclose(nearest, moments, rtol=ROUNDING, atol=0.0):
            repaired.append(body.name)
    if repaired:
        notes.append(
            f"no body can have the inertia of {', '.join(repaired)}: the nearest that one can have is taken"
        )


def _require_inertias(spec: mujoco.MjSpec) -> None:
    """Raise `ReadingError` if the mass of a moving part comes from a mesh."""
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


def _from_mesh(geom: mujoco.MjsGeom) -> bool:
    """Return whether a geom is a mesh, a signed distance field, or a shape that MuJoCo
    fits to a mesh."""
    return bool(geom.meshname) or geom.type in (
        mujoco.mjtGeom.mjGEOM_MESH,
        mujoco.mjtGeom.mjGEOM_SDF,
    )


def _strip(spec: mujoco.MjSpec) -> None:
    """Delete meshes, height fields and looks from a spec, and the elements that refer
    to them."""
    for geom in list(spec.geoms):
        if _from_mesh(geom) or geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
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
    """Weld the robot's joints that `joints` does not name, by deleting them and their
    actuators."""
    if not joints:
        return
    names = {
        joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE
    }
    if (
        len(joints) != len(MOTOR_NAMES)
        or len(set(joints)) != len(MOTOR_NAMES)
        or not names.issuperset(joints)
    ):
        raise ReadingError(
            f"`joints` must be 12 names of {', '.join(sorted(names))}: each leg's abad, hip and knee"
        )
    unnamed = names - set(joints)
    driven = [actuator for actuator in spec.actuators if actuator.target in unnamed]
    welded = [joint for joint in spec.joints if joint.name in unnamed]
    for element in (*driven, *welded, *spec.keys):  # which no longer fit
        spec.delete(element)
