"""Fig. 2, Fig. S1 and Table S3 of the paper: the robot as it is modelled, measured on
the compiled model."""

import dataclasses

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.outcome import Table
from bp2_rl.paper.figures.drawn import Comparison, Drawn, Verdict
from bp2_rl.paper.figures.settings import RobotSettings
from bp2_rl.paper.figures.silhouette import draw, extent, outlines
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import ROBOTS, HardwareSpec
from bp2_rl.robot.model import load_model
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.simulator import RobotSetup, settled

TABLE_S3 = "paper, Table S3"
# m, by which the hips' height may differ: the paper does not say what it is measured to
HEIGHT_OFF = 0.02
SIZE_OFF = 0.005  # m
MASS_OFF = 0.5  # kg: Table S3 adds up to 35.8


@dataclasses.dataclass(frozen=True)
class RobotNumbers:
    """All that the figure shows."""

    standing_height: float  # m, of the hips' axes, settled on its springs
    length: float  # m, of the trunk that collides
    width: float  # m, over the legs' covers, legs in their planes
    mass: float  # kg
    parameters: dict[str, float]  # Table S3, by symbol


def robot(settings: RobotSettings) -> Drawn:
    """The figure, Table S3, and what comes of the paper's dimensions."""
    hardware = ROBOTS[settings.robot]
    numbers = measure(hardware)
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
    return Drawn(
        numbers, (table,), compare(numbers), {"robot": robot_figure(hardware, numbers)}
    )


def measure(hardware: HardwareSpec) -> RobotNumbers:
    """Measure the compiled model, standing."""
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
    """The model with its looks, in the pose in which it comes to rest on its feet."""
    model = load_model(hardware)
    data = mujoco.MjData(model)
    data.qpos[:] = settled([RobotSetup(EnvConfig(hardware=hardware))]).qpos[0]
    mujoco.mj_kinematics(model, data)
    return model, data


def compare(numbers: RobotNumbers) -> tuple[Comparison, ...]:
    """Fig. 2's four numbers."""

    def said(
        what: str, paper: float, ours: float, off: float, unit: str, because: str
    ) -> Comparison:
        verdict: Verdict = "same" if abs(paper - ours) <= off else "differs"
        return Comparison(
            f"{what} {paper:g} {unit}", f"{ours:.3f} {unit}", verdict, because
        )

    n = numbers
    return (
        said(
            "standing height",
            bp2.STANDING_HEIGHT,
            n.standing_height,
            HEIGHT_OFF,
            "m",
            "ours is the hips' axes'",
        ),
        said("body length", bp2.BODY_LENGTH, n.length, SIZE_OFF, "m", ""),
        said("width", bp2.BODY_WIDTH, n.width, SIZE_OFF, "m", "over the legs' covers"),
        said(
            "mass",
            bp2.TOTAL_MASS,
            n.mass,
            MASS_OFF,
            "kg",
            "Table S3 adds up to 35.8 kg",
        ),
    )


@styled
def robot_figure(hardware: HardwareSpec, numbers: RobotNumbers) -> Figure:
    """From the side and from the front, with the dimensions."""
    model, data = standing(hardware)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    side, front = figure.subplots(1, 2, width_ratios=(1.15, 0.85))
    colors: dict[str | None, str] = {None: INK, **LEG_COLORS}
    for axes, plane, title, across in (
        (side, (0, 2), "Side", "x"),
        (front, (1, 2), "Front", "y"),
    ):
        parts = outlines(model, data, plane)
        draw(axes, parts, colors)
        low, high = extent(parts)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set(
            title=title,
            xlabel=f"{across} [m]",
            aspect="equal",
            ylim=(-0.04, high[1] + 0.16),
        )
        axes.set_xlim(low[0] - 0.17, high[0] + 0.06)
    side.set_ylabel("z [m]")
    half = 0.5 * numbers.length
    top = float(extent(outlines(model, data, (0, 2)))[1][1]) + 0.05
    _dimension(side, (-half, top), (half, top), f"{numbers.length:.2f} m")
    _dimension(
        front,
        (-0.5 * numbers.width, top),
        (0.5 * numbers.width, top),
        f"{numbers.width:.2f} m",
    )
    edge = side.get_xlim()[0] + 0.06
    _dimension(
        side,
        (edge, 0.0),
        (edge, numbers.standing_height),
        f"{numbers.standing_height:.3f} m",
    )
    handles = [
        side.fill([], [], color=color, label=leg or "trunk")[0]
        for leg, color in colors.items()
    ]
    figure.legend(
        handles=handles,
        loc="outside upper right",
        ncols=5,
        handlelength=0.9,
        columnspacing=1.0,
    )
    figure.suptitle(
        f"BP2 as it is modelled, standing; {numbers.mass:.1f} kg",
        x=0.01,
        ha="left",
        fontsize=9.5,
    )
    return figure


def _dimension(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str
) -> None:
    """An arrow with two heads, and its length."""
    arrow = {
        "arrowstyle": "<->",
        "color": QUIET,
        "linewidth": 0.9,
        "shrinkA": 0.0,
        "shrinkB": 0.0,
    }
    axes.annotate("", end, start, arrowprops=arrow)
    upright = start[0] == end[0]
    middle = (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]))
    axes.annotate(
        text,
        middle,
        (-4, 0) if upright else (0, 3),
        textcoords="offset points",
        rotation=90 if upright else 0,
        ha="right" if upright else "center",
        va="center" if upright else "bottom",
        fontsize=8.5,
    )
