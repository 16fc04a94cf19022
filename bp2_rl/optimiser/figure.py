"""Draw one gait cycle: stick figures, velocities, forces and torques.

Drawn off screen, in the style of `plotting`. Left is blue and right is vermilion, fore
legs are dotted and hind legs solid.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import FAINT, INK, QUIET, WIDTH, styled
from bp2_rl.optimiser.cycle import (
    Cycle,
    center_of_mass_velocity,
    leg_points,
    whole_cycle,
)
from bp2_rl.optimiser.problem import TRUNK
from bp2_rl.optimiser.solution import Solution, resample
from bp2_rl.robot.actuator import Actuator, of_joint, torque_limits

LEFT, RIGHT, ARROW = "#0072B2", "#D55E00", "#D55E00"
FRAMES = 8  # stick figures in a cycle
SPACE = 1.2  # m, least distance from one to the next
FINE = 64  # intervals of each segment that curves are drawn with
PANELS = (
    ("Horizontal velocity of the CoM", "[m/s]"),
    ("Vertical velocity of the CoM", "[m/s]"),
    ("Hip velocity", "[rad/s]"),
    ("Knee velocity", "[rad/s]"),
    ("Horizontal ground reaction", "[N]"),
    ("Vertical ground reaction", "[N]"),
    ("Hip torque", "[Nm]"),
    ("Knee torque", "[Nm]"),
)
"""Titles and units of the panels below the picture of the motion."""


@styled
def trajectory_figure(solution: Solution) -> Figure:
    """Draw one gait cycle: motion, velocities, ground reaction forces and torques
    (paper, Fig. hardware_opt, A to I).

    The dashed limits of a torque are those of the left hind leg's motor at its joint's
    speed.
    """
    cycle = whole_cycle(on_fine_mesh(solution))
    problem, motion, legs = cycle.problem, cycle.motion, cycle.problem.stride.legs
    share = cycle.time / cycle.period
    figure = Figure(figsize=(WIDTH, 10.4), layout="constrained")
    top, rest = rows(figure, 1.35, 8.0)
    sticks, panels = top.subplots(), rest.subplots(4, 2, sharex=True).ravel().tolist()
    for axes in panels:
        shade_stance(axes, cycle, legs)
    stick_figures(sticks, cycle)

    body = center_of_mass_velocity(motion.q, motion.v, legs, problem.hardware)
    for panel, along in zip(panels[:2], np.moveaxis(body, -1, 0), strict=True):
        _along(panel, share, along, color=INK)
    motors, limited = Actuator.from_hardware(problem.hardware), legs[-1]
    dashed = {"color": QUIET, "linewidth": 1.1, "linestyle": (0, (4, 2))}
    for leg, name in enumerate(legs):
        style, block = leg_style(name), TRUNK + cycle.problem.stride.per_leg * leg
        stands = np.array([[name in feet] for feet in cycle.standing])
        for joint in (0, 1):
            speed, column = motion.v[..., block + joint], 2 * leg + joint
            force = np.where(stands, motion.force[..., column], np.nan)
            if name == limited:
                # the optimiser's hips are alike, and its knees
                for limit in torque_limits(of_joint(motors, 1 + joint), speed):
                    _along(panels[6 + joint], share, limit, **dashed)
            _along(panels[2 + joint], share, speed, **style)
            _along(panels[6 + joint], share, motion.tau[..., column], **style)
            _along(panels[4 + joint], share, force, **style)
    for axes, (title, unit) in zip(panels, PANELS, strict=True):
        axes.set(title=title, ylabel=unit, xlim=(0.0, 1.0))
        axes.margins(y=0.08)
    for axes in panels[-2:]:
        axes.set_xlabel("Time / period")
    letter([sticks, *panels])
    handles = [Line2D([], [], label=name, **leg_style(name)) for name in legs]
    handles.append(
        Line2D([], [], label=f"limit, {limited}", color=QUIET, linestyle=(0, (4, 2)))
    )
    figure.legend(
        handles=handles, loc="outside upper right", ncols=len(handles), handlelength=2.2
    )
    return figure


def _along(
    axes: Axes,
    share: Float[np.ndarray, "segments points"],
    values: Float[np.ndarray, "segments points"],
    **style: Any,
) -> None:
    """Draw a curve over the cycle that may jump from one segment to the next."""
    axes.plot(share.ravel(), values.ravel(), **style)


# --- The style -----------------------------------------------------------------------


def rows(figure: Figure, *heights: float) -> list[SubFigure]:
    """Return subfigures one above the other, of these relative heights."""
    return list(
        np.asarray(
            figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
        ).ravel()
    )


def on_fine_mesh(solution: Solution) -> Solution:
    """Resample a solution onto a fine mesh by its scheme's polynomials."""
    problem = solution.problem.on_mesh(FINE)
    return dataclasses.replace(
        solution,
        problem=problem,
        motion=resample(solution.problem, solution.motion, problem),
    )


def leg_style(leg: str) -> dict[str, Any]:
    """Return a leg's colour, by its side, and its dashes, by its end."""
    right = leg.endswith("R") if len(leg) > 1 else not leg.startswith("F")
    dots = (
        {"linestyle": (0, (1.2, 1.2))} if leg.startswith("F") and len(leg) > 1 else {}
    )
    return {"color": RIGHT if right else LEFT, **dots}


def shade_stance(axes: Axes, cycle: Cycle, feet: Sequence[str]) -> None:
    """Shade axes grey where any of these feet stands."""
    edges = np.append(cycle.starts, cycle.period) / cycle.period
    for standing, start, end in zip(cycle.standing, edges, edges[1:], strict=False):
        if set(standing) & set(feet):
            axes.axvspan(start, end, color=FAINT, alpha=0.8, linewidth=0)


def stick_figures(axes: Axes, cycle: Cycle) -> None:
    """Draw the robot as stick figures at equal intervals of the cycle, moved apart
    where they would overlap."""
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
    """Write A, B, C and so on before the panels' titles."""
    for letter, axes in zip("ABCDEFGHIJKL", panels, strict=False):
        axes.set_title(f"{letter}   {axes.get_title(loc='left')}")
