"""Ground that is not flat: heights at the points of a grid, and planes between them, as
in MuJoCo's height fields; or stairs, which are boxes in MuJoCo.

A cell of the grid is two triangles, which meet along the diagonal from the cell's
lowest x and y to its highest. The grid repeats itself along x and y: with 256 points
0.2 m apart, a robot that runs 130 m sees the same stretch of 51.2 m two and a half
times. Robots share a grid; their grounds differ in amplitude, cell and shift.

Stairs repeat themselves along x: up, a landing, down, and a landing. Both kinds of
ground tell the height below a point, and the plane that a foot meets.
"""

import functools
import math
from typing import NamedTuple

import mujoco
import numpy as np
from flax import struct
from jaxtyping import Float

from bp2_rl.base.arrays import Array

WAVE = 8
"""Cells in a wave's length, along x and along y."""
STEPS, LANDING = 10, 6
"""Steps in a flight of stairs, and treads in the length of a landing between
flights."""
HALF = LANDING + STEPS - 1
"""Treads from the middle of an upper landing to the middle of a lower one."""
STEEPEST = 1e5
"""Slope of the plane that stands for a riser: its normal is off by 1e-5 rad."""
# m, of the ground in MuJoCo: to both sides of the start, and ahead of what lies behind it
LENGTH, BREADTH = 240.0, 12.0


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
    """The plane of the ground at points: its height below or above them, m, and its
    slopes along x and y."""

    height: Array
    slope_x: Array
    slope_y: Array


class HeightField(struct.PyTreeNode):
    """The rough or wavy ground of a robot, or of several; NumPy and JAX alike."""

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

    def met_at(
        self, x: Float[Array, "..."], y: Float[Array, "..."], z: Float[Array, "..."]
    ) -> Plane:
        """Return the plane that a foot with its centre here meets, the one below it."""
        del z
        return self.below(x, y)

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
        floor = _solid_floor(spec)
        floor.type = mujoco.mjtGeom.mjGEOM_HFIELD
        floor.hfieldname = "ground"
        floor.pos = np.array(
            [
                half[0] - self.cell * self.column,
                half[1] - self.cell * self.row,
                lowest,
            ]
        )


class Stairs(struct.PyTreeNode):
    """Flights of `STEPS` stairs along x for a robot, or for several, up and down in turn
    with landings between them; NumPy and JAX alike. Lower landings have the height 0."""

    height: Float[Array, "..."]  # m, of a step
    run: Float[Array, "..."]  # m, of a tread
    # of the world's origin, from the middle of an upper landing, treads
    start: Float[Array, "..."]

    def _descended(self, x: Array) -> tuple[Array, Array, Array]:
        """Return how many steps the ground below x lies under the upper landing, how far
        x is beyond this landing's end, treads, and the way down, 1 or -1 along x."""
        xp = x.__array_namespace__()
        place = x / self.run + self.start
        place = place - 2 * HALF * xp.round(place / (2 * HALF))
        beyond = xp.abs(place) - 0.5 * LANDING
        return xp.clip(xp.floor(beyond) + 1.0, 0.0, STEPS), beyond, xp.sign(place)

    def below(self, x: Float[Array, "..."], y: Float[Array, "..."]) -> Plane:
        """Return the tread below or above points of the world, m."""
        del y
        height = self.height * (STEPS - self._descended(x)[0])
        return Plane(height, 0.0 * height, 0.0 * height)

    def met_at(
        self, x: Float[Array, "..."], y: Float[Array, "..."], z: Float[Array, "..."]
    ) -> Plane:
        """Return the plane that a foot with its centre here meets, m: across the line
        from the centre to the closest point of a tread, a riser, or the edge between.

        A centre inside a step is pushed out the nearest way, through the tread or the
        riser. The closest point is exact up to a distance of `run`. A riser's plane has
        the slope `STEEPEST`.
        """
        xp = x.__array_namespace__()
        steps, beyond, way = self._descended(x)
        over = z - self.below(x, y).height
        # over a tread a foot may meet the next riser uphill, in a step the next downhill
        riser = xp.where(over > 0.0, steps - 1.0, steps)
        depth, across = xp.abs(over), self.run * xp.abs(beyond - riser)
        lift = xp.clip(depth - self.height, 0.0, None)
        reach = xp.sqrt(across**2 + lift**2)
        nearer = (reach < depth) & (riser >= 0.0) & (riser < STEPS)
        across = xp.clip(across, 1e-9, None)  # a centre on the riser is beside it
        fall = xp.where(nearer, across / xp.maximum(lift, across / STEEPEST), 0.0)
        distance = xp.where(over > 0.0, 1.0, -1.0) * xp.where(nearer, reach, depth)
        return Plane(z - distance * xp.sqrt(1.0 + fall**2), -way * fall, 0.0 * fall)

    def lay(self, spec: mujoco.MjSpec) -> None:
        """Build the stairs on the floor of a MuJoCo scene, for robots that run ahead;
        solid thighs and shanks meet them, too. The numbers are floats.

        A box is a tread on the way up, the tread of this height on the way down, and
        all that lies between and below, down to 2 m under the floor.
        """
        floor = _solid_floor(spec)
        for hill in range(math.ceil(LENGTH / (2 * HALF * self.run)) + 1):
            for step in range(STEPS):
                top = 0.5 * self.height * (STEPS - step)
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    size=(self.run * (0.5 * LANDING + step), 0.5 * BREADTH, top + 1.0),
                    pos=(self.run * (2 * HALF * hill - self.start), 0.0, top - 1.0),
                    contype=floor.contype,
                    conaffinity=floor.conaffinity,
                    material=floor.material,
                )


Ground = HeightField | Stairs
"""The ground of a robot, or of several, where it is not flat."""


def _solid_floor(spec: mujoco.MjSpec) -> mujoco.MjsGeom:
    """Return the floor of a MuJoCo scene; let solid thighs and shanks meet it."""
    floor = spec.geom("floor")
    for geom in spec.geoms:
        if geom.contype and geom.name.endswith(("_solid_thigh", "_solid_shank")):
            geom.conaffinity |= floor.contype
    return floor


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
