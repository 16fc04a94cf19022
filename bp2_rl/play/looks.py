"""Draw the robot and its ground as triangle meshes for the page."""

from typing import cast

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import (
    field_of,
    ground_geoms,
    load_model,
    mesh_of,
    visible_geoms,
)
from bp2_rl.simulation.world import LEVEL, World

SIDES = 20  # of a round thing
GEOM = mujoco.mjtGeom
Color = tuple[int, int, int]  # of 255


class Looks:
    """The visible shapes of a robot and of its ground, and their poses, from its full
    MuJoCo model."""

    def __init__(self, hardware: HardwareSpec, world: World = LEVEL):
        self.model = load_model(hardware, scene=world.lay)
        self.data = mujoco.MjData(self.model)
        self.bodies = [self.model.body(i).name for i in range(1, self.model.nbody)]
        """Name of each body but the world."""

    def parts(self) -> dict[tuple[int, Color], trimesh.Trimesh]:
        """Return a triangle mesh (m, in the body's frame) by body and colour of the
        robot's geoms."""
        found: dict[tuple[int, Color], list[trimesh.Trimesh]] = {}
        for geom, color in visible_geoms(self.model):
            r, g, b = (255.0 * color).astype(int).tolist()
            found.setdefault((int(self.model.geom_bodyid[geom]), (r, g, b)), []).append(
                _triangles(self.model, geom)
            )
        return {
            part: cast(trimesh.Trimesh, trimesh.util.concatenate(meshes))
            for part, meshes in found.items()
        }

    @property
    def has_floor(self) -> bool:
        """True where stairs or nothing stand on the floor, False where a field of heights
        takes its place."""
        return bool(self.model.geom("floor").type[0] == GEOM.mjGEOM_PLANE)

    def ground(self) -> list[trimesh.Trimesh]:
        """Return the triangle meshes of ground that is not flat, in the world's
        frame."""
        return [_triangles(self.model, geom) for geom in ground_geoms(self.model)]

    def place(
        self, qpos: Float[np.ndarray, " nq"], level: float = 0.0
    ) -> tuple[Float[np.ndarray, "B 3"], Float[np.ndarray, "B 4"]]:
        """Return position (m) and quaternion (w-x-y-z) of every body but the world, the
        trunk above the origin, which is at the height `level`, m."""
        self.data.qpos[:] = qpos
        self.data.qpos[:3] = 0.0, 0.0, qpos[2] - level
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.xpos[1:].copy(), self.data.xquat[1:].copy()


def _triangles(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return a geom's surface as a triangle mesh in its body's frame."""
    radius, half = (float(size) for size in model.geom_size[geom][:2])
    match int(model.geom_type[geom]):
        case GEOM.mjGEOM_SPHERE:
            mesh = trimesh.creation.icosphere(2, radius)
        case GEOM.mjGEOM_CAPSULE:
            mesh = trimesh.creation.capsule(2.0 * half, radius, count=[SIDES, SIDES])
        case GEOM.mjGEOM_CYLINDER:
            mesh = trimesh.creation.cylinder(radius, 2.0 * half, sections=SIDES)
        case GEOM.mjGEOM_BOX:
            mesh = trimesh.creation.box(2.0 * model.geom_size[geom])
        case GEOM.mjGEOM_MESH:
            mesh = trimesh.Trimesh(
                *mesh_of(model, int(model.geom_dataid[geom])), process=False
            )
            mesh.unmerge_vertices()  # an edge where faces meet
        case GEOM.mjGEOM_HFIELD:
            mesh = _field(*field_of(model))
        case other:
            raise NotImplementedError(
                f"no triangles for a geom of type {GEOM(other).name}"
            )
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    pose = np.eye(4)
    pose[:3, :3] = turn.reshape(3, 3)
    pose[:3, 3] = model.geom_pos[geom]
    return mesh.apply_transform(pose)


def _field(
    x: Float[np.ndarray, " columns"],
    y: Float[np.ndarray, " rows"],
    heights: Float[np.ndarray, "rows columns"],
) -> trimesh.Trimesh:
    """Return a field of heights, whose cells are split as MuJoCo splits them."""
    points = np.stack([*np.meshgrid(x, y), heights], axis=-1).reshape(-1, 3)
    near = np.arange(len(points)).reshape(heights.shape)[:-1, :-1].reshape(-1, 1)
    faces = near + np.array([0, 1, len(x) + 1, 0, len(x) + 1, len(x)])
    return trimesh.Trimesh(points, faces.reshape(-1, 3), process=False)
