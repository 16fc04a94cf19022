"""A robot in its standing pose, from the side and from the front, with its joints
marked."""

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from bp2_rl.base.plotting import FAINT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.robot.conventions import JOINTS, LEGS
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.model import load_model

MARKS = {"abad": "s", "hip": "o", "knee": "D"}


@styled
def draw_robot(hardware: HardwareSpec) -> Figure:
    """Draw the robot as it stands; axes in metres."""
    anatomy = hardware.anatomy
    model = load_model(hardware)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    figure = Figure(figsize=(WIDTH, 0.5 * WIDTH), layout="constrained")
    views: list[Axes] = list(
        figure.subplots(1, 2, width_ratios=(1.6, 1.0), sharey=True)
    )
    for axes, across, title in zip(
        views, (0, 1), ("from the right, forward is right", "from behind"), strict=True
    ):
        shown, sign = [across, 2], (1.0 if across == 0 else -1.0)

        def flat(
            point: np.ndarray, shown: list[int] = shown, sign: float = sign
        ) -> np.ndarray:
            return np.asarray(point)[shown] * (sign, 1.0)

        middle, half = (
            flat(data.body("trunk").xpos),
            np.array(anatomy.trunk_size)[shown],
        )
        axes.add_patch(
            Rectangle(
                tuple(middle - half), *(2.0 * half), facecolor=FAINT, edgecolor=QUIET
            )
        )
        for leg, name in reversed(list(zip(anatomy.legs, LEGS, strict=True))):
            joints = [flat(data.joint(f"{name}_{joint}").xanchor) for joint in JOINTS]
            foot = flat(data.geom(f"{name}_foot").xpos)
            line, color = np.array([*joints, foot]), LEG_COLORS[name]
            axes.plot(line[:, 0], line[:, 1], color=color, linewidth=2.4, label=name)
            for joint, at in zip(JOINTS, joints, strict=True):
                axes.plot(
                    *at,
                    MARKS[joint],
                    color=color,
                    markeredgecolor="white",
                    markersize=7,
                )
            axes.add_patch(
                Circle(tuple(foot), leg.foot_radius, facecolor=color, alpha=0.5)
            )
        axes.plot(
            *flat(data.subtree_com[1]), "+", color=INK, markersize=11, markeredgewidth=2
        )
        axes.axhline(0.0, color=QUIET)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("m")
        axes.set_title(title)
    for joint, mark in MARKS.items():
        views[1].plot([], [], mark, color=QUIET, label=joint)
    views[1].plot([], [], "+", color=INK, markersize=11, label="centre of mass")
    figure.legend(
        *views[1].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=8,
        handlelength=1.2,
    )
    figure.suptitle(anatomy.name, x=0.01, ha="left", fontweight="bold")
    return figure
