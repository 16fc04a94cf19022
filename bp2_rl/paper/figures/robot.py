"""Fig. 2, Fig. S1 and Table S3 of the paper: the robot as it is modelled, measured on
the compiled model."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from bp2_rl.base.metric import Table
from bp2_rl.base.plotting import INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import RobotFigureSettings
from bp2_rl.robot import conventions
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import ROBOTS, HardwareSpec
from bp2_rl.robot.model import load_model
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.simulator import RobotSetup, settled

TABLE_S3 = "paper, Table S3"
CIRCLE = 24  # points
LOOKS = 2  # group of the geoms that are looks
PART_COLORS = {"trunk": INK, **LEG_COLORS}


@dataclasses.dataclass(frozen=True)
class RobotNumbers:
    """Dimensions and mass of the modelled robot, and its parameters in the paper's
    Table S3."""

    standing_height: float  # m, of the hips' axes, settled on its springs
    length: float  # m, of the trunk that collides
    width: float  # m, over the legs' covers, legs in their planes
    mass: float  # kg
    parameters: dict[str, float]  # Table S3, by symbol


def robot(settings: RobotFigureSettings) -> Drawn:
    """Draw the robot with its dimensions, and tabulate Table S3."""
    hardware = ROBOTS[settings.robot]
    numbers = measure_robot(hardware)
    rows = [
        (p.symbol, f"{p.value:g}", p.unit, p.source)
        for p in conventions.PROVENANCE
        if p.source.startswith(TABLE_S3)
    ]
    table = Table(
        "Table S3, as the model has it",
        ("Symbol", "Value", "Unit", "Source"),
        rows,
        words=True,
    )
    return Drawn(numbers, (table,), {"robot": robot_figure(hardware, numbers)})


def measure_robot(hardware: HardwareSpec) -> RobotNumbers:
    """Measure dimensions and mass of the compiled MuJoCo model."""
    model, data = standing(hardware)
    trunk = [int(model.geom(name).id) for name in ("trunk_right", "trunk_left")]
    reach = max(data.geom_xpos[g][0] + model.geom_size[g][:2].sum() for g in trunk)
    least = min(data.geom_xpos[g][0] - model.geom_size[g][:2].sum() for g in trunk)
    height = float(data.qpos[2])
    # legs in their planes, not splayed by the load
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_kinematics(model, data)
    low, high = extent(outlines(model, data, (1, 2)))
    return RobotNumbers(
        standing_height=height,
        length=float(reach - least),
        width=float(high[0] - low[0]),
        mass=float(np.sum(model.body_mass)),
        parameters={
            p.symbol: p.value
            for p in conventions.PROVENANCE
            if p.source.startswith(TABLE_S3)
        },
    )


def standing(hardware: HardwareSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model with its visual geoms, in the pose in which it rests on its
    feet."""
    model = load_model(hardware)
    data = mujoco.MjData(model)
    data.qpos[:] = settled([RobotSetup(EnvConfig(hardware=hardware))]).qpos[0]
    mujoco.mj_kinematics(model, data)
    return model, data


@styled
def robot_figure(hardware: HardwareSpec, numbers: RobotNumbers) -> Figure:
    """Draw the robot from the side and from the front, with its dimensions."""
    model, data = standing(hardware)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    side, front = figure.subplots(1, 2, width_ratios=(1.15, 0.85))
    for axes, plane, title, across in (
        (side, (0, 2), f"{numbers.length:.2f} m long", "x"),
        (front, (1, 2), f"{numbers.width:.2f} m wide", "y"),
    ):
        parts = outlines(model, data, plane)
        draw_outlines(axes, parts)
        low, high = extent(parts)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set(
            title=title,
            xlabel=f"{across} [m]",
            aspect="equal",
            ylim=(-0.04, high[1] + 0.06),
        )
        axes.set_xlim(low[0] - 0.06, high[0] + 0.06)
    side.set_ylabel("z [m]")
    name_parts(figure, PART_COLORS)
    figure.suptitle(
        f"BP2 as it is modelled: {numbers.mass:.1f} kg, hips {numbers.standing_height:.3f} m high",
        x=0.01,
        ha="left",
        fontsize=9.5,
    )
    return figure


# --- The robot's shape in a plane, part by part: no GL library is needed --------------


class SilhouettePart(NamedTuple):
    """Outline of a geom of the model, seen along an axis."""

    outline: Float[np.ndarray, "K 2"]  # m
    nearness: float  # m, towards the eye
    name: str  # as in `PART_COLORS`


def outlines(
    model: mujoco.MjModel, data: mujoco.MjData, axes: tuple[int, int]
) -> list[SilhouettePart]:
    """Return the convex outlines of all visible geoms, the farthest first.

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
        name = body[:2] if body[:2] in LEGS else "trunk"
        parts.append(
            SilhouettePart(
                flat[ConvexHull(flat).vertices],
                float(data.geom_xpos[geom] @ view),
                name,
            )
        )
    return sorted(parts, key=lambda part: part.nearness)


def draw_outlines(
    axes: Axes,
    parts: list[SilhouettePart],
    *,
    right: float = 0.0,
    alpha: float = 1.0,
) -> None:
    """Draw outlines as filled shapes, moved to the right by `right`, m."""
    for part in parts:
        shape = Polygon(
            part.outline + np.array((right, 0.0)),
            facecolor=PART_COLORS[part.name],
            edgecolor="white",
            linewidth=0.3,
            alpha=alpha,
        )
        axes.add_patch(shape)


def name_parts(figure: Figure, colors: Mapping[str, str]) -> None:
    """Name the robot's parts by their colours, above the panels."""
    handles = [
        figure.axes[0].fill([], [], color=color, label=name)[0]
        for name, color in colors.items()
    ]
    figure.legend(
        handles=handles,
        loc="outside upper right",
        ncols=len(handles),
        handlelength=0.9,
        columnspacing=1.0,
    )


def extent(
    parts: list[SilhouettePart],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return the least and the greatest coordinates of silhouette parts, m."""
    points = np.concatenate([part.outline for part in parts])
    return points.min(axis=0), points.max(axis=0)


def _surface(model: mujoco.MjModel, geom: int) -> Float[np.ndarray, "K 3"]:
    """Return points of a geom's surface in its own frame; their hull is its shape, but
    for the roundness of circles."""
    size = model.geom_size[geom]
    turn = np.linspace(0.0, 2 * np.pi, CIRCLE, endpoint=False)
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
