"""The style of trajectories' pictures: colours, grey stance, letters, the robot as sticks.

Drawn off screen, in the style of `plotting`. Left is blue and right is vermilion, fore
legs are dotted and hind legs solid.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from bp2_rl.base.plotting import FAINT, INK, QUIET
from bp2_rl.optimiser.cycle import Cycle, leg_points
from bp2_rl.optimiser.solution import Solution, resample

LEFT, RIGHT, ARROW = "#0072B2", "#D55E00", "#D55E00"
FRAMES = 8  # stick figures in a cycle
SPACE = 1.2  # m, least distance from one to the next
FINE = 64  # intervals of each segment that curves are drawn with


def rows(figure: Figure, *heights: float) -> list[SubFigure]:
    """Subfigures one above the other."""
    return list(
        np.asarray(
            figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
        ).ravel()
    )


def on_fine_mesh(solution: Solution) -> Solution:
    """The solution as its scheme's polynomials go on between the points of its mesh."""
    problem = solution.problem.on_mesh(FINE)
    return dataclasses.replace(
        solution,
        problem=problem,
        motion=resample(solution.problem, solution.motion, problem),
    )


def leg_style(leg: str) -> dict[str, Any]:
    """Colour by side and dashes by end; a leg without sides is its end's."""
    right = leg.endswith("R") if len(leg) > 1 else not leg.startswith("F")
    dots = (
        {"linestyle": (0, (1.2, 1.2))} if leg.startswith("F") and len(leg) > 1 else {}
    )
    return {"color": RIGHT if right else LEFT, **dots}


def shade_stance(axes: Axes, cycle: Cycle, feet: Sequence[str]) -> None:
    """Grey where any of these feet stands."""
    edges = np.append(cycle.starts, cycle.period) / cycle.period
    for standing, start, end in zip(cycle.standing, edges, edges[1:], strict=False):
        if set(standing) & set(feet):
            axes.axvspan(start, end, color=FAINT, alpha=0.8, linewidth=0)


def stick_figures(axes: Axes, cycle: Cycle) -> None:
    """The robot at equal intervals of the cycle, moved apart where it would stand in
    its own way."""
    problem, motion, legs = cycle.problem, cycle.motion, cycle.problem.stride.legs
    step = problem.speed * cycle.period / FRAMES
    space = max(step, SPACE)
    q = motion.q.reshape(-1, motion.q.shape[-1])
    for frame in range(FRAMES):
        t = frame * cycle.period / FRAMES
        pose = np.array(
            [np.interp(t, cycle.time.ravel(), coordinate) for coordinate in q.T]
        )
        pose[0] += frame * space - problem.speed * t
        points = leg_points(pose, legs, problem.hardware)
        for leg in sorted(range(len(legs)), key=lambda leg: legs[leg][-1] != "R"):
            color = leg_style(legs[leg])["color"]
            axes.plot(
                *points[leg].T,
                color=color,
                linewidth=1.6,
                solid_joinstyle="round",
                clip_on=False,
            )
            axes.plot(*points[leg, 2], "o", color=color, ms=2.4, clip_on=False)
        hips = points[:, 0]
        axes.plot(*hips[np.argsort(hips[:, 0])].T, color=INK, linewidth=3.0)
        axes.annotate(
            f"{frame}/{FRAMES}",
            (pose[0], 0.0),
            (0, -4),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=8,
        )
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    arrow = {"arrowstyle": "-|>", "color": ARROW, "linewidth": 2.0}
    end = (FRAMES - 1) * space
    axes.annotate("", (end / 2 + 0.6, 0.92), (end / 2 - 0.6, 0.92), arrowprops=arrow)
    moved = f"frames moved {space - step:.2f} m apart; " if space > step else ""
    axes.set_title(f"Motion at {problem.speed:g} m/s")
    axes.annotate(
        f"{moved}below: time / period",
        (1.0, 1.0),
        xycoords="axes fraction",
        ha="right",
        va="bottom",
        color=QUIET,
    )
    axes.set(xlim=(-0.7, end + 0.7), ylim=(-0.16, 1.0))
    axes.set_aspect("equal", anchor="W")
    axes.set_axis_off()


def letter(panels: Sequence[Axes]) -> None:
    """A, B, C and so on before the panels' titles."""
    for letter, axes in zip("ABCDEFGHIJKL", panels, strict=False):
        axes.set_title(f"{letter}   {axes.get_title(loc='left')}")
