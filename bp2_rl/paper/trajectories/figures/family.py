"""A family of motions over speed."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import QUIET, WIDTH, styled
from bp2_rl.optimiser.cycle import cost_of_transport, robot_mass
from bp2_rl.optimiser.figure_style import LEFT, RIGHT, letter, on_fine_mesh
from bp2_rl.optimiser.problem import spring_coordinates
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.decomposition import comparable
from bp2_rl.robot import conventions


@styled
def family_figure(solutions: Sequence[Solution]) -> Figure:
    """What changes with speed in a family of motions: times, loads, effort and the
    trunk's posture.

    Raises:
        UserError: there are no solutions, or they differ in gait or hardware.
    """
    solutions = comparable(solutions)
    problem = solutions[0].problem
    springs = spring_coordinates(problem.stride.legs)
    speeds = [solution.problem.speed for solution in solutions]
    motions = [on_fine_mesh(solution).motion for solution in solutions]
    figure = Figure(figsize=(WIDTH, 8.6), layout="constrained")
    panels = figure.subplots(4, 2, sharex=True).ravel().tolist()

    def line(axes: Axes, values: Sequence[float], **style: Any) -> None:
        axes.plot(speeds, values, "o-", ms=3.5, color=style.pop("color", LEFT), **style)

    line(panels[0], [1e3 * solution.period for solution in solutions])
    line(panels[1], [solution.duty for solution in solutions])
    line(panels[2], [np.max(motion.force[..., 1::2]) for motion in motions])
    for joint, (name, color) in enumerate((("hip", LEFT), ("knee", RIGHT))):
        line(
            panels[3],
            [np.max(np.abs(motion.tau[..., joint::2])) for motion in motions],
            label=name,
            color=color,
        )
    line(panels[4], [1e3 * np.max(motion.q[..., springs]) for motion in motions])
    line(panels[5], [cost_of_transport(solution) for solution in solutions])
    for axes, along in (
        (panels[6], [motion.q[..., 1] for motion in motions]),
        (panels[7], [np.rad2deg(motion.q[..., 2]) for motion in motions]),
    ):
        low, high = (
            [extreme(values) for values in along] for extreme in (np.min, np.max)
        )
        axes.fill_between(speeds, low, high, color=LEFT, alpha=0.2, linewidth=0)
        line(axes, low)
        line(axes, high)
    _mark_level(panels[2], robot_mass(problem) * conventions.GRAVITY, "body weight")
    _mark_level(panels[3], problem.hardware.joint_peak_torque, "motor's peak")
    _mark_level(panels[4], 1e3 * problem.hardware.spring_travel, "stop")
    panels[3].legend(loc="lower right", ncols=2)
    titles = (
        ("Period", "[ms]"),
        ("Duty factor", "share of the period"),
        ("Peak vertical force of a foot", "[N]"),
        ("Peak torque", "[Nm]"),
        ("Peak spring compression", "[mm]"),
        ("Cost of transport, mechanical", "work / (m g distance)"),
        ("Range of the trunk height", "[m]"),
        ("Range of the pitch, nose down", "[deg]"),
    )
    for axes, (title, unit) in zip(panels, titles, strict=True):
        axes.set(title=title, ylabel=unit)
    for axes in panels[:6]:
        axes.set_ylim(bottom=0.0)
    for axes in panels[-2:]:
        axes.set_xlabel("Speed [m/s]")
    letter(panels)
    return figure


def _mark_level(axes: Axes, level: float, text: str) -> None:
    """A dashed line across, with its name, and room above it."""
    axes.axhline(level, color=QUIET, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.set_ylim(top=max(axes.get_ylim()[1], 1.15 * level))
    box = {
        "boxstyle": "square,pad=0.15",
        "facecolor": "white",
        "edgecolor": "none",
        "alpha": 0.85,
    }
    at = (0.02, level)
    axes.annotate(
        text,
        at,
        xycoords=("axes fraction", "data"),
        ha="left",
        va="center",
        color=QUIET,
        bbox=box,
    )
