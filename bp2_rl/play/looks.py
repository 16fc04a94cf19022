"""Draw the robot as triangle meshes for the page, and its motors' torque over speed as
a chart."""

import dataclasses
from typing import cast

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float

from bp2_rl.base.assets import render
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, of_joint, torque_limits
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
# px, where the axes cross, and how far they reach right and up
CENTER, REACH = (164, 88), (130, -72)
EVERY = 5  # ms: of so many one is drawn
COLORS = {"abad": "#009E73", "hip": "#0072B2", "knee": "#E69F00"}
GEOM = mujoco.mjtGeom


@dataclasses.dataclass(frozen=True)
class VisiblePart:
    """A triangle mesh of all geoms on a body that share a colour."""

    body: int
    mesh: trimesh.Trimesh  # m, in the body's frame
    color: tuple[int, int, int]  # of 255


class Looks:
    """The visible shapes of a robot and of its ground, and their poses, from its full
    MuJoCo model."""

    def __init__(self, hardware: HardwareSpec, world: World = LEVEL):
        self.model = load_model(hardware, scene=world.lay)
        self.data = mujoco.MjData(self.model)
        self.bodies = [self.model.body(i).name for i in range(1, self.model.nbody)]
        """Name of each body but the world."""

    def parts(self) -> list[VisiblePart]:
        """Return the coloured triangle meshes of the robot."""
        found: dict[tuple[int, tuple[int, int, int]], list[trimesh.Trimesh]] = {}
        for geom, color in visible_geoms(self.model):
            r, g, b = (255.0 * color).astype(int).tolist()
            found.setdefault((int(self.model.geom_bodyid[geom]), (r, g, b)), []).append(
                _triangles(self.model, geom)
            )
        return [
            VisiblePart(
                body, cast(trimesh.Trimesh, trimesh.util.concatenate(meshes)), color
            )
            for (body, color), meshes in found.items()
        ]

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


class TorqueSpeed:
    """A small SVG chart of the twelve motors' recent torques over their speeds."""

    def __init__(self, motors: Actuator):
        limits = motors.no_load_speed, motors.peak_torque  # rad/s and Nm
        self._marks = np.array([np.max(np.asarray(limit)) for limit in limits])
        self._ends = np.array([1.4, 1.15]) * self._marks  # of the axes
        speeds = np.linspace(-self._ends[0], self._ends[0], 141)
        self._outlines: dict[str, None] = {}
        for joint in range(len(conventions.JOINTS)):
            low, high = torque_limits(of_joint(motors, joint), speeds)
            edge = np.stack([[*speeds, *speeds[::-1]], [*high, *low[::-1]]], axis=-1)
            # one for joints with the same motors
            self._outlines[" L".join(self._places(edge))] = None

    def svg(self, worked: Float[np.ndarray, "N 2 12"]) -> str:
        """Return the chart of joint speeds (rad/s) and torques (Nm), given as
        `Session.worked` has them."""
        samples = np.moveaxis(
            worked[::-EVERY].reshape(-1, 2, 4, len(conventions.JOINTS)), (3, 1), (0, 3)
        )
        dots = {
            joint: "".join(
                f"M{place}h0" for place in self._places(points.reshape(-1, 2))
            )
            for joint, points in zip(conventions.JOINTS, samples, strict=True)
        }
        return render(
            "play/chart.svg",
            outlines=self._outlines,
            worked=dots,
            colors=COLORS,
            marks=self._marks,
            shares=self._marks / self._ends,
            center=CENTER,
            reach=REACH,
        )

    def _places(self, points: Float[np.ndarray, "N 2"]) -> list[str]:
        """Return the places of points (rad/s, Nm) on the chart, px; a point beyond the
        chart is drawn on its edge."""
        places = np.array(CENTER) + np.array(REACH) * np.clip(
            points / self._ends, -1.0, 1.0
        )
        return [f"{x:.1f} {y:.1f}" for x, y in places.tolist()]
