"""Four legs as pendulums on a beam: how much torque a free beam saves, by a gait's
phases.

A leg's push on the beam, S th'^2 - C th'', is odd in its angle. So two legs in
antiphase cancel, at any amplitude, and a gait whose legs come in such pairs leaves the
beam at rest.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bp2_rl.base.metric import Table, metric, table_of
from bp2_rl.base.plotting import FALL, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.paper.figures.drawn import Drawn, joined, legend_above_panels, name_rows
from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.settings import (
    MASS_RATIO,
    PendulumGaitsSettings,
    driven_frequency,
)
from bp2_rl.paper.pendulum.torque import drive, peak, root_mean_square

GAITS: dict[str, tuple[float, float, float, float]] = {
    "trot": (0.0, 0.5, 0.5, 0.0),
    "pace": (0.0, 0.5, 0.0, 0.5),
    "bound": (0.0, 0.0, 0.5, 0.5),
    "walk": (0.0, 0.5, 0.75, 0.25),
    "gallop": (0.0, 0.1, 0.5, 0.6),
    "gathered gallop": (0.0, 0.1, 0.35, 0.45),
    "canter": (0.0, 1 / 3, 1 / 3, 2 / 3),
    "half-bound": (0.0, 0.0, 0.35, 0.5),
    "pronk": (0.0, 0.0, 0.0, 0.0),
}
"""Phases of FR, FL, RR and RL in cycles. All ASSUMED: textbook gaits, evenly timed. In
a gathered gallop the hind legs come sooner than half a cycle after the fore legs."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class GaitTorque:
    """Ratios of the torques of a gait's legs, beam free over beam fixed."""

    gait: str = metric("Gait", form="s")
    phases: tuple[float, ...] = metric("FR FL RR RL", "cycles", joined(".2f", " "))
    mass_ratio: float
    # |mean e^(i phi)|: 1 if all legs move as one, 0 if they balance
    order: float = metric("Order parameter")
    least_peak: float = metric("Peak of the least needy leg", form=".3f")
    peak: float = metric("Of the neediest", form=".3f")
    root_mean_square: float = metric("Root mean square", form=".3f")
    # root mean square of small swings: it hangs on the order parameter alone
    small_swing: float = metric("Of small swings", form=".3f")


def order_parameter(
    phases: Float[np.ndarray, "*many legs"],
) -> Float[np.ndarray, "*many"]:
    """Return the order parameter of leg phases (cycles): 1 if legs move as one, 0 if
    they balance."""
    return np.asarray(np.abs(np.mean(np.exp(2j * np.pi * phases), axis=-1)))


def gait_torques(
    mass_ratio: float, amplitude: float, frequency: float
) -> tuple[GaitTorque, ...]:
    """Return the torque ratios, beam free over fixed, of every gait; `frequency` is
    over w0."""
    phases = np.array(list(GAITS.values()))
    cycle = drive(
        2.0 * np.pi * phases,
        *(np.array(value) for value in (amplitude, frequency, mass_ratio)),
    )
    peaks = peak(cycle.free) / peak(cycle.fixed)
    free, fixed = (
        np.linalg.norm(root_mean_square(torque), axis=-1)
        for torque in (cycle.free, cycle.fixed)
    )
    order = order_parameter(phases)
    small = exact.small_gait_ratio(order, frequency, mass_ratio, phases.shape[-1])
    return tuple(
        GaitTorque(
            gait=name,
            phases=GAITS[name],
            mass_ratio=mass_ratio,
            order=float(order[row]),
            peak=float(peaks[row].max()),
            least_peak=float(peaks[row].min()),
            root_mean_square=float(free[row] / fixed[row]),
            small_swing=float(small[row]),
        )
        for row, name in enumerate(GAITS)
    )


def gain_by_gait(settings: PendulumGaitsSettings) -> Drawn:
    """Draw and tabulate how much torque a free beam saves four legs, by gait."""
    frequency = driven_frequency(settings.frequency, settings.length)
    found = [
        gait_torques(ratio, settings.amplitude, frequency)
        for ratio in settings.mass_ratio
    ]
    tables: tuple[Table, ...] = tuple(
        table_of(f"Torque free / fixed, R = {gaits[0].mass_ratio:.3g}", gaits)
        for gaits in found
    )
    named = [gait for gaits in found for gait in gaits]
    return Drawn({"gaits": named}, tables, {"gaits": gaits_figure(found)})


@styled
def gaits_figure(found: Sequence[Sequence[GaitTorque]]) -> Figure:
    """Draw torque ratios by gait, beam free over beam fixed; a panel for every mass
    ratio."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0].tolist()
    for gaits, axes in zip(found, panels, strict=True):
        rows = range(len(gaits))
        axes.axvline(1.0, color=QUIET, linewidth=0.8)
        axes.hlines(
            rows,
            [gait.least_peak for gait in gaits],
            [gait.peak for gait in gaits],
            color=FALL,
            linewidth=2.2,
        )
        peaks = [gait.peak for gait in gaits]
        axes.plot(peaks, rows, "o", ms=6, color=FALL, label="peak of the neediest leg")
        axes.plot(
            [gait.root_mean_square for gait in gaits],
            rows,
            "o",
            ms=5,
            mfc="white",
            color=LEG_COLORS["RR"],
            label="root mean square",
        )
        ratio = gaits[0].mass_ratio
        axes.set(
            title=f"R = {ratio:.3g}{', BP2' if ratio == MASS_RATIO else ''}",
            xlabel="Torque, beam free / fixed",
        )
        name_rows(axes, [f"{gait.gait}, {gait.order:.2f}" for gait in gaits])
    panels[0].set_ylabel("Gait, and its order parameter")
    legend_above_panels(figure, panels[0], 2)
    return figure
