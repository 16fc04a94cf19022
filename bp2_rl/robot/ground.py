"""Ground that is not flat: heights at the points of a grid, and planes between them, as
in MuJoCo's height fields.

A cell of the grid is two triangles, which meet along the diagonal from the cell's
lowest x and y to its highest. The grid repeats itself along x and y: with 256 points
0.2 m apart, a robot that runs 130 m sees the same stretch of 51.2 m two and a half
times. Robots share a grid; their grounds differ in amplitude, cell and shift.
"""

import functools
from typing import NamedTuple

import mujoco
import numpy as np
from flax import struct
from jaxtyping import Float

from bp2_rl.base.arrays import Array

WAVE = 8
"""Cells in a wave's length, along x and along y."""


class Grid:
    """Heights at the points of a grid, of at most 1 either way: rows along y, columns
    along x.

    A grid equals only itself, so that JAX may take it for a constant.
    """

    def __init__(self, heights: Float[np.ndarray, "rows columns"]):
        self.heights = heights


@functools.lru_cache(maxsize=8)
def shared_grid(kind: str, points: int = 256) -> Grid:
    """Return the square grid on which all robots of a training run."""
    return Grid(draw_heights(kind, 0, points, points).astype(np.float32))


def draw_heights(
    kind: str, seed: int, rows: int, columns: int
) -> Float[np.ndarray, "rows columns"]:
    """Return heights from -1 to 1 of rough ground, drawn evenly, or of waves along x and
    y, each as high as the other."""
    if kind == "waves":
        phase_y, phase_x = (
            2.0 * np.pi / WAVE * np.arange(count) for count in (rows, columns)
        )
        return 0.5 * (np.sin(phase_y)[:, None] + np.sin(phase_x))
    drawn = np.random.default_rng(seed).uniform(size=(rows, columns))
    return 2.0 * (drawn - drawn.min()) / (drawn.max() - drawn.min()) - 1.0


class Plane(NamedTuple):
    """The plane of the ground below points: its height there, m, and its slopes along x
    and y."""

    height: Array
    slope_x: Array
    slope_y: Array


class Ground(struct.PyTreeNode):
    """The ground of a robot, or of several; NumPy and JAX alike."""

    grid: Grid = struct.field(pytree_node=False)
    amplitude: Float[Array, "..."]  # m, of the highest and lowest points
    cell: Float[Array, "..."]  # m, between points
    # place of the world's origin in the grid, cells
    column: Float[Array, "..."]
    row: Float[Array, "..."]

    def below(self, x: Float[Array, "..."], y: Float[Array, "..."]) -> Plane:
        """Return the ground's plane below or above points of the world, m."""
        xp = x.__array_namespace__()
        heights = xp.asarray(self.grid.heights)
        along, left = x / self.cell + self.column, y / self.cell + self.row
        column, row = xp.floor(along), xp.floor(left)
        a, b = along - column, left - row
        column, row = column.astype(xp.int32), row.astype(xp.int32)
        rows, columns = heights.shape

        def point(i: int, j: int) -> Array:
            return heights[(row + i) % rows, (column + j) % columns]

        near, ahead, beside, far = point(0, 0), point(0, 1), point(1, 0), point(1, 1)
        rise_x = xp.where(b > a, far - beside, ahead - near)
        rise_y = xp.where(b > a, beside - near, far - ahead)
        return Plane(
            self.amplitude * (near + a * rise_x + b * rise_y),
            self.amplitude / self.cell * rise_x,
            self.amplitude / self.cell * rise_y,
        )

    def lay(self, spec: mujoco.MjSpec) -> None:
        """Replace the floor of a MuJoCo scene by a height field, one period of the
        grid, which solid thighs and shanks meet, too; the ground's numbers are
        floats."""
        heights = self.amplitude * self.grid.heights
        lowest, highest = float(np.min(heights)), float(np.max(heights))
        rows, columns = heights.shape
        half = 0.5 * self.cell * np.array([columns - 1, rows - 1])
        spec.add_hfield(
            name="ground",
            nrow=rows,
            ncol=columns,
            size=(*half, highest - lowest, 1.0),
            userdata=heights.ravel().tolist(),
        )
        for geom in spec.geoms:
            if geom.contype and geom.name.endswith(("_solid_thigh", "_solid_shank")):
                geom.conaffinity |= spec.geom("floor").contype
        floor = spec.geom("floor")
        floor.type = mujoco.mjtGeom.mjGEOM_HFIELD
        floor.hfieldname = "ground"
        floor.pos = np.array(
            [
                half[0] - self.cell * self.column,
                half[1] - self.cell * self.row,
                lowest,
            ]
        )


def over_ground(
    qpos: Float[Array, "... nq"], ground: Ground | None
) -> Float[Array, "... nq"]:
    """Return a robot's coordinates with the trunk's height taken from the ground below
    it; `None` is flat ground."""
    if ground is None:
        return qpos
    xp = qpos.__array_namespace__()
    height = qpos[..., 2] - ground.below(qpos[..., 0], qpos[..., 1]).height
    return xp.concat([qpos[..., :2], height[..., None], qpos[..., 3:]], axis=-1)
