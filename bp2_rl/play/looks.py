"""What the robot looks like: the MJCF's visible geoms as triangles, body by body, and where each body is in a state."""

import dataclasses

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float, Int

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import load_model

VISIBLE = 2  # the last group of geoms that is shown; collision shapes are in later ones
SIDES = 20  # of a round thing
GEOM = mujoco.mjtGeom


@dataclasses.dataclass(frozen=True)
class VisiblePart:
    """The geoms of one colour of one body."""

    body: int
    vertices: Float[np.ndarray, "V 3"]  # m, in the body's frame
    faces: Int[np.ndarray, "F 3"]
    color: tuple[int, int, int]  # of 255


class Looks:
    """The robot's looks: `model` and `data` with everything that is to be seen, for kinematics alone."""

    def __init__(self, hardware: HardwareSpec):
        self.model = load_model(hardware)
        self.data = mujoco.MjData(self.model)
        self.bodies = [self._path(i) for i in range(1, self.model.nbody)]
        """Path of each body but the world: the names from the trunk down to the body, such as trunk/FR_abad."""

    def _path(self, body: int) -> str:
        name, parent = self.model.body(body).name, int(self.model.body_parentid[body])
        return name if parent == 0 else f"{self._path(parent)}/{name}"

    def parts(self) -> list[VisiblePart]:
        """Return the visible parts of the robot."""
        model, found = self.model, {}
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            if body == 0 or model.geom_group[geom] > VISIBLE:
                continue
            found.setdefault((body, _color(model, geom)), []).append(_triangles(model, geom))
        parts = []
        for (body, color), meshes in found.items():
            first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
            vertices = np.concatenate([mesh.vertices for mesh in meshes])
            faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=True)])
            parts.append(VisiblePart(body, vertices, faces, color))
        return parts

    def place(self, qpos: Float[np.ndarray, " nq"]) -> tuple[Float[np.ndarray, "B 3"], Float[np.ndarray, "B 4"]]:
        """(Position in m, w-x-y-z quaternion) of every body but the world in the frame of the one that it hangs on.

        The trunk's is the world's, moved along so that the trunk is above its origin.
        """
        data = self.data
        data.qpos[:] = qpos
        data.qpos[:2] = 0.0
        mujoco.mj_kinematics(self.model, data)
        parent, own = self.model.body_parentid[1:], slice(1, None)
        turn = data.xmat.reshape(-1, 3, 3)[parent]  # from the parent's frame to the world's
        position = np.einsum("bji,bj->bi", turn, data.xpos[own] - data.xpos[parent])
        back = data.xquat[parent] * np.array([1.0, -1.0, -1.0, -1.0])
        return position, _product(back, data.xquat[own])


def _product(a: Float[np.ndarray, "B 4"], b: Float[np.ndarray, "B 4"]) -> Float[np.ndarray, "B 4"]:
    """Return the products of w-x-y-z quaternions, each with the sign that makes w at least 0."""
    w, v, x, u = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    whole = np.concatenate((w * x - np.sum(v * u, axis=1, keepdims=True), w * u + x * v + np.cross(v, u)), axis=1)
    return np.where(whole[:, :1] < 0.0, -whole, whole)


def _color(model: mujoco.MjModel, geom: int) -> tuple[int, int, int]:
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    r, g, b = (int(255.0 * float(part)) for part in rgba[:3])
    return r, g, b


def _triangles(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """A geom's surface in its body's frame."""
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
            mesh = _hull(model, int(model.geom_dataid[geom]))
        case other:
            raise NotImplementedError(f"no triangles for a geom of type {GEOM(other).name}")
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), model.geom_pos[geom]
    return mesh.apply_transform(pose)


def _hull(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    """A mesh of the MJCF, with an edge where its faces meet."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    whole = trimesh.Trimesh(
        model.mesh_vert[first : first + count], model.mesh_face[start : start + faces], process=False
    )
    whole.unmerge_vertices()
    return whole
