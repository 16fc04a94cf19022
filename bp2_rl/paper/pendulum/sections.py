"""Poincare sections of two pendulums on a beam (paper, Fig. model_analysis D).

What is free to swing keeps its energy, and a flow that does so keeps volumes, too
(Liouville): no orbit attracts others. Yet with the mass ratio the section changes:
while the pendulums exchange their swing, both trace one path; once the swing is
trapped, each has a path of its own.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.distance import directed_hausdorff

from bp2_rl.base.plotting import WIDTH, styled
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, SwingMotion, swing
from bp2_rl.paper.pendulum.settings import PendulumSectionsSettings
from bp2_rl.paper.pendulum.study import ONE, TWO, PendulumStudy, numbered, remark

Instant = Literal["beam", "pendulum"]
INSTANTS: dict[Instant, str] = {
    "beam": "the beam turns, from left to right",
    "pendulum": "pendulum 1 passes the vertical, to the right",
}
"""When a point of the section is taken."""
SAMPLES = 100  # of a natural period; a cubic between two is right to 1e-6
COLUMNS = 3


@dataclasses.dataclass(frozen=True)
class Path:
    """What a section shows, in numbers."""

    mass_ratio: float
    points: int
    # rad, least and greatest of each pendulum
    angles: tuple[tuple[float, float], tuple[float, float]]
    apart: float | None
    """Hausdorff's distance between the two pendulums' points in the plane of (th, th'):
    how far, at most, a point of one is from the other's nearest. Where they share a
    path, gaps between points are left. None for a section that pins pendulum 1 to the
    vertical"""


@dataclasses.dataclass(frozen=True)
class Section:
    """The points of one mass ratio."""

    path: Path
    theta: Float[np.ndarray, "points 2"]
    rate: Float[np.ndarray, "points 2"]


def sections(
    amplitude: float, mass_ratios: Sequence[float], periods: float, instant: Instant
) -> list[Section]:
    """Let one of two pendulums go and look at both whenever it is that instant, for
    each mass ratio."""
    time = np.linspace(0.0, periods * NATURAL_PERIOD, round(periods * SAMPLES) + 1)
    released = np.tile((amplitude, 0.0), (len(mass_ratios), 1))
    motion = swing(released, np.array(mass_ratios), time, tolerance=1e-10)
    return [_section(motion, system, instant) for system in range(len(mass_ratios))]


def _section(motion: SwingMotion, system: int, instant: Instant) -> Section:
    """Return the section of one of several systems."""
    beam_acceleration, acceleration = (
        values[:, system] for values in motion.accelerations
    )
    theta, rate = motion.theta[:, system], motion.rate[:, system]
    if instant == "beam":
        rising = CubicHermiteSpline(
            motion.time, motion.beam_rate[:, system], beam_acceleration
        )
    else:
        rising = CubicHermiteSpline(motion.time, theta[:, 0], rate[:, 0])
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
        apart=max(directed_hausdorff(one, two)[0], directed_hausdorff(two, one)[0])
        if instant == "beam"
        else None,
    )
    return Section(path, theta, rate)


def _ends(values: Float[np.ndarray, " points"]) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def cut_sections(settings: PendulumSectionsSettings) -> PendulumStudy:
    """Study how far apart the paths of two pendulums are."""
    found = sections(
        settings.amplitude, settings.mass_ratio, settings.periods, settings.instant
    )
    rows = []
    for path in (section.path for section in found):
        angles = (f"{low:+.2f} to {high:+.2f}" for low, high in path.angles)
        apart = "-" if path.apart is None else f"{path.apart:.3f}"
        rows.append((f"{path.mass_ratio:g}", str(path.points), *angles, apart))
    columns = ("R", "points", "angles of 1, rad", "angles of 2, rad", "paths apart")
    arrays = numbered(
        {"theta": section.theta, "rate": section.rate} for section in found
    )
    results = {"mass_ratios": [section.path for section in found]}
    return PendulumStudy(
        columns, rows, results, arrays, sections_figure(found, settings.instant)
    )


@styled
def sections_figure(sections: Sequence[Section], instant: Instant) -> Figure:
    """Angle and rate of both pendulums at each instant of the section (paper, Fig.
    3D)."""
    columns = min(COLUMNS, len(sections))
    rows = -(-len(sections) // columns)
    figure = Figure(figsize=(WIDTH, 1.1 + 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.ravel()[len(sections) :]:
        axes.set_axis_off()
    for section, axes in zip(sections, panels.ravel(), strict=False):
        path = section.path
        axes.plot(
            section.theta[:, 0], section.rate[:, 0], "o", color=ONE, ms=3.2, mew=0.0
        )
        axes.plot(
            section.theta[:, 1],
            section.rate[:, 1],
            "o",
            color=TWO,
            ms=3.2,
            mew=0.8,
            mfc="none",
        )
        axes.set_title(f"R = {path.mass_ratio:g}")
        if path.apart is not None:
            remark(axes, f"{path.apart:.2f} apart")
    top = max(float(abs(section.rate).max()) for section in sections)
    panels[0, 0].set_ylim(-1.15 * top, 1.35 * top)
    for axes in panels[:, 0]:
        axes.set_ylabel("Rate / $\\omega_0$ [rad]")
    for column in panels.T:
        below = [axes for axes in column if axes.axison][-1]
        below.set_xlabel("Angle [rad]")
        below.tick_params(labelbottom=True)
    handles = [
        Line2D(
            [],
            [],
            color=ONE,
            marker="o",
            linestyle="",
            ms=4,
            label="pendulum 1, let go",
        ),
        Line2D(
            [],
            [],
            color=TWO,
            marker="o",
            linestyle="",
            ms=4,
            mfc="none",
            label="pendulum 2",
        ),
        Line2D([], [], linestyle="", label=f"taken each time {INSTANTS[instant]}"),
    ]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=3, handlelength=1.0
    )
    return figure
