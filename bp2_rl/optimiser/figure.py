"""One gait cycle: the motion, its velocities, forces and torques."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.optimiser.cycle import center_of_mass_velocity, whole_cycle
from bp2_rl.optimiser.figure_style import (
    leg_style,
    letter,
    on_fine_mesh,
    rows,
    shade_stance,
    stick_figures,
)
from bp2_rl.optimiser.problem import PER_LEG, TRUNK
from bp2_rl.optimiser.solution import Solution
from bp2_rl.robot.actuator import Actuator, torque_limits

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
"""Titles and units below the picture of the motion."""


@styled
def trajectory_figure(solution: Solution) -> Figure:
    """One gait cycle: motion, velocities, ground reaction forces and torques (paper,
    Fig. hardware_opt, A to I).

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
        style, block = leg_style(name), TRUNK + PER_LEG * leg
        stands = np.array([[name in feet] for feet in cycle.standing])
        for joint in (0, 1):
            speed, column = motion.v[..., block + joint], 2 * leg + joint
            force = np.where(stands, motion.force[..., column], np.nan)
            if name == limited:
                for limit in torque_limits(motors, speed):
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
    """A curve over the cycle that may jump from one segment to the next."""
    axes.plot(share.ravel(), values.ravel(), **style)
