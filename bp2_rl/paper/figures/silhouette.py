"""The robot's shape in a plane, part by part, from the compiled model: no GL library is
needed."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from bp2_rl.robot.conventions import LEGS

CIRCLE = 24  # points
LOOKS = 2  # group of the geoms that are looks


class SilhouettePart(NamedTuple):
    """One geom, seen along an axis."""

    outline: Float[np.ndarray, "K 2"]  # m
    nearness: float  # m, towards the eye
    leg: str | None  # FR to RL; None: the trunk


def outlines(
    model: mujoco.MjModel, data: mujoco.MjData, axes: tuple[int, int]
) -> list[SilhouettePart]:
    """The convex outlines of all that is seen, the farthest first.

    Args:
        model: with its looks.
        data: after `mj_kinematics`.
        axes: of the world that go to the right and up; it is seen from where these
            two's cross product points to.
    """
    view = np.cross(*np.eye(3)[list(axes)])
    parts = []
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == 0 or model.geom_group[geom] != LOOKS:
            continue
        points = (
            data.geom_xpos[geom]
            + _surface(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T
        )
        flat = points[:, axes]
        body = model.body(model.geom_bodyid[geom]).name
        leg = body[:2] if body[:2] in LEGS else None
        parts.append(
            SilhouettePart(
                flat[ConvexHull(flat).vertices], float(data.geom_xpos[geom] @ view), leg
            )
        )
    return sorted(parts, key=lambda part: part.nearness)


def draw(
    axes: Axes,
    parts: list[SilhouettePart],
    colors: dict[str | None, str],
    *,
    right: float = 0.0,
    alpha: float = 1.0,
) -> None:
    """Outlines as filled shapes, moved to the right by so many metres."""
    for part in parts:
        shape = Polygon(
            part.outline + np.array((right, 0.0)),
            facecolor=colors[part.leg],
            edgecolor="white",
            linewidth=0.3,
            alpha=alpha,
        )
        axes.add_patch(shape)


def extent(
    parts: list[SilhouettePart],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The least and the greatest coordinates of these parts, m."""
    points = np.concatenate([part.outline for part in parts])
    return points.min(axis=0), points.max(axis=0)


def _surface(model: mujoco.MjModel, geom: int) -> Float[np.ndarray, "K 3"]:
    """Points of a geom's surface in its own frame whose hull is its shape, but for the
    roundness of circles."""
    size, turn = (
        model.geom_size[geom],
        np.linspace(0.0, 2 * np.pi, CIRCLE, endpoint=False),
    )
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(
                np.float64
            )
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return np.concatenate(
                [size[0] * ring + (0, 0, end) for end in (-size[1], size[1])]
            )
        case mujoco.mjtGeom.mjGEOM_BOX:
            return size * np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        case _:  # sphere and capsule
            half = (
                size[1]
                if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
                else 0.0
            )
            rings = [
                np.cos(at) * ring + (0, 0, np.sin(at))
                for at in np.linspace(-np.pi / 2, np.pi / 2, 9)
            ]
            ball = size[0] * np.concatenate(rings)
            return np.concatenate(
                [ball + np.array((0, 0, end)) for end in {-half, half}]
            )
