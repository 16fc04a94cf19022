"""Poincare sections of two pendulums on a beam (paper, Fig. 3 D).

What is free to swing keeps its energy, and a flow that does so keeps volumes, too
(Liouville): no orbit attracts others. Yet with the mass ratio the section changes:
while the pendulums exchange their swing, both trace one path; once the swing is
trapped, each has a path of its own.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.distance import directed_hausdorff

from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import FALL, FRONT, WIDTH, styled
from bp2_rl.paper.figures.drawn import (
    Drawn,
    drawn_rows,
    joined,
    legend_above_panels,
    remark,
)
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, SwingMotion, swing
from bp2_rl.paper.pendulum.settings import PendulumSectionsSettings

SAMPLES = 100  # of a natural period; a cubic between two is right to 1e-6
COLUMNS = 3

_show_angles = joined("+.2f", " to ")


@dataclasses.dataclass(frozen=True)
class Path:
    """Numbers of a Poincare section: its angles, and how far apart the pendulums' paths
    are."""

    mass_ratio: float = metric("R", form="g")
    points: int = metric("Points", form="d")
    # rad, least and greatest of each pendulum
    angles: tuple[tuple[float, float], tuple[float, float]] = metric(
        "Angles of 1 / 2", "rad", lambda pairs: " / ".join(map(_show_angles, pairs))
    )
    apart: float = metric("Paths apart", "rad", ".3f")
    """Hausdorff's distance between the two pendulums' points in the plane of (th, th'):
    how far, at most, a point of one is from the other's nearest. Where they share a
    path, gaps between points are left"""


@dataclasses.dataclass(frozen=True)
class Section:
    """Points of the Poincare section at one mass ratio."""

    path: Path
    theta: Float[np.ndarray, "points 2"]
    rate: Float[np.ndarray, "points 2"]


def sections(
    amplitude: float, mass_ratios: Sequence[float], periods: float
) -> list[Section]:
    """Release one of two pendulums, and return angles and rates of both whenever the
    beam turns from left to right, for each mass ratio."""
    time = np.linspace(0.0, periods * NATURAL_PERIOD, round(periods * SAMPLES) + 1)
    released = np.tile((amplitude, 0.0), (len(mass_ratios), 1))
    motion = swing(released, np.array(mass_ratios), time, tolerance=1e-10)
    return [_section(motion, system) for system in range(len(mass_ratios))]


def _section(motion: SwingMotion, system: int) -> Section:
    """Return the Poincare section of a single system of pendulums, by its index among
    several."""
    beam_acceleration, acceleration = (
        values[:, system] for values in motion.accelerations
    )
    theta, rate = motion.theta[:, system], motion.rate[:, system]
    rising = CubicHermiteSpline(
        motion.time, motion.beam_rate[:, system], beam_acceleration
    )
    times = rising.roots(extrapolate=False)
    times = times[rising(times, 1) > 0.0]
    theta, rate = (
        CubicHermiteSpline(motion.time, *pair)(times)
        for pair in ((theta, rate), (rate, acceleration))
    )
    one, two = (np.stack((theta[:, k], rate[:, k]), axis=-1) for k in (0, 1))
    path = Path(
        mass_ratio=float(motion.mass_ratio[system]),
        points=len(times),
        angles=(_ends(one[:, 0]), _ends(two[:, 0])),
        apart=max(directed_hausdorff(one, two)[0], directed_hausdorff(two, one)[0]),
    )
    return Section(path, theta, rate)


def _ends(values: Float[np.ndarray, " points"]) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def cut_sections(settings: PendulumSectionsSettings) -> Drawn:
    """Draw and tabulate Poincare sections of two pendulums, and how far apart their
    paths are."""
    found = sections(settings.amplitude, settings.mass_ratio, settings.periods)
    paths = tuple(section.path for section in found)
    return drawn_rows("mass_ratios", paths, sections=sections_figure(found))


@styled
def sections_figure(sections: Sequence[Section]) -> Figure:
    """Draw angle and rate of both pendulums at each instant of the section (paper, Fig.
    3 D)."""
    columns = min(COLUMNS, len(sections))
    rows = -(-len(sections) // columns)
    figure = Figure(figsize=(WIDTH, 1.1 + 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.ravel()[len(sections) :]:
        axes.set_axis_off()
    marks = (FRONT, {"mew": 0.0}), (FALL, {"mew": 0.8, "mfc": "none"})
    for section, axes in zip(sections, panels.ravel(), strict=False):
        for k, (color, mark) in enumerate(marks):
            axes.plot(
                section.theta[:, k],
                section.rate[:, k],
                "o",
                color=color,
                ms=3.2,
                label=f"pendulum {k + 1}{'' if k else ', let go'}, as the beam turns",
                **mark,
            )
        axes.set_title(f"R = {section.path.mass_ratio:g}")
        remark(axes, f"{section.path.apart:.2f} apart")
    top = max(float(abs(section.rate).max()) for section in sections)
    panels[0, 0].set_ylim(-1.15 * top, 1.35 * top)
    for axes in panels[:, 0]:
        axes.set_ylabel("Rate / $\\omega_0$ [rad]")
    for column in panels.T:
        below = [axes for axes in column if axes.axison][-1]
        below.set_xlabel("Angle [rad]")
        below.tick_params(labelbottom=True)
    legend_above_panels(figure, panels[0, 0], 2)
    return figure
