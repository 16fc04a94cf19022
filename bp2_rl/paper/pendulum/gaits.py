"""From two pendulums to four legs: what a gait's phases leave of the beam's help.

A leg's push on the beam, S th'^2 - C th'', is odd in its angle. So two legs in
antiphase cancel, at any amplitude, and a gait whose legs come in such pairs leaves the
beam at rest.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.paper.pendulum import bp2, exact
from bp2_rl.paper.pendulum.settings import PendulumGaitsSettings, driven_frequency
from bp2_rl.paper.pendulum.study import BEAM, ONE, TWO, PendulumStudy
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
RANDOM = 400  # gaits, drawn beside those with a name
HALO = [withStroke(linewidth=2.5, foreground="white")]  # of a label among points
AT_REST = 1e-9  # of the order parameter: the beam rests


@dataclasses.dataclass(frozen=True)
class GaitTorque:
    """What one gait's legs need with the beam free, over what they need with it
    fixed."""

    gait: str
    phases: tuple[float, ...]  # cycles
    mass_ratio: float
    order: float  # |mean e^(i phi)|: 1 if all legs move as one, 0 if they balance
    peak: float  # of the leg that needs most
    least_peak: float  # of the leg that needs least
    root_mean_square: float  # over time and legs
    small_swing: float  # that of small swings: it hangs on the order parameter alone


@dataclasses.dataclass(frozen=True)
class GaitComparison:
    """Gaits with a name, and beside them gaits with any phases: what there could be."""

    named: tuple[tuple[GaitTorque, ...], ...]  # by mass ratio
    phases: Float[np.ndarray, "gaits legs"]  # cycles, of the random ones
    order: Float[np.ndarray, " gaits"]
    peak: Float[np.ndarray, "ratios gaits"]  # of the leg that needs most
    orders: Float[np.ndarray, " points"]  # of the law's curve
    law: Float[np.ndarray, "ratios points"]  # root mean square of small swings

    def arrays(self) -> dict[str, Any]:
        """The points and curves."""
        return {
            name: getattr(self, name)
            for name in ("phases", "order", "peak", "orders", "law")
        }


def order_parameter(
    phases: Float[np.ndarray, "*many legs"],
) -> Float[np.ndarray, "*many"]:
    """How much legs move as one; phases in cycles."""
    return np.asarray(np.abs(np.mean(np.exp(2j * np.pi * phases), axis=-1)))


def compare_gaits(
    mass_ratios: Sequence[float], amplitude: float, frequency: float
) -> GaitComparison:
    """Every gait with a name and `RANDOM` others, on beams of several mass ratios;
    `frequency` over w0."""
    # Evenly drawn phases seldom move as one: draw them from an ever greater share of
    # the cycle.
    phases = (
        np.random.default_rng(0).random((RANDOM, bp2.LEGS))
        * np.linspace(0.0, 1.0, RANDOM)[:, None]
    )
    orders = np.linspace(0.0, 1.0, 101)
    return GaitComparison(
        named=tuple(gait_torques(ratio, amplitude, frequency) for ratio in mass_ratios),
        phases=phases,
        order=order_parameter(phases),
        peak=np.array(
            [
                _ratios(phases, ratio, amplitude, frequency)[0].max(axis=-1)
                for ratio in mass_ratios
            ]
        ),
        orders=orders,
        law=np.array(
            [
                exact.small_gait_ratio(orders, frequency, ratio, bp2.LEGS)
                for ratio in mass_ratios
            ]
        ),
    )


def gait_torques(
    mass_ratio: float, amplitude: float, frequency: float
) -> tuple[GaitTorque, ...]:
    """Return the torques of every gait that has a name."""
    phases = np.array(list(GAITS.values()))
    ratios, root_mean_squares = _ratios(phases, mass_ratio, amplitude, frequency)
    order = order_parameter(phases)
    small = exact.small_gait_ratio(order, frequency, mass_ratio, phases.shape[-1])
    return tuple(
        GaitTorque(
            gait=name,
            phases=GAITS[name],
            mass_ratio=mass_ratio,
            order=float(order[row]),
            peak=float(ratios[row].max()),
            least_peak=float(ratios[row].min()),
            root_mean_square=float(root_mean_squares[row]),
            small_swing=float(small[row]),
        )
        for row, name in enumerate(GAITS)
    )


def _ratios(
    phases: Float[np.ndarray, "gaits legs"],
    mass_ratio: float,
    amplitude: float,
    frequency: float,
) -> tuple[Float[np.ndarray, "gaits legs"], Float[np.ndarray, " gaits"]]:
    """Return torques, free over fixed: each leg's peak, and the root mean square over
    time and legs."""
    cycle = drive(
        2.0 * np.pi * phases,
        np.array(amplitude),
        np.array(frequency),
        np.array(mass_ratio),
    )
    free, fixed = (
        np.linalg.norm(root_mean_square(torque), axis=-1)
        for torque in (cycle.free, cycle.fixed)
    )
    return peak(cycle.free) / peak(cycle.fixed), free / fixed


def gain_by_gait(settings: PendulumGaitsSettings) -> PendulumStudy:
    """Study what each gait gains of four legs on a free beam."""
    frequency = driven_frequency(settings.frequency, settings.length)
    found = compare_gaits(settings.mass_ratio, settings.amplitude, frequency)
    rows = []
    for gaits in zip(*found.named, strict=True):
        peaks = (f"{one.least_peak:.3f} to {one.peak:.3f}" for one in gaits)
        phases = " ".join(f"{phase:.2f}" for phase in gaits[0].phases)
        rows.append((gaits[0].gait, phases, f"{gaits[0].order:.2f}", *peaks))
    peaks = (f"peak free / fixed, R = {ratio:.3g}" for ratio in settings.mass_ratio)
    columns = ("gait", "FR FL RR RL, cycles", "order parameter", *peaks)
    named = [one for gaits in found.named for one in gaits]
    return PendulumStudy(
        columns, rows, {"gaits": named}, found.arrays(), gaits_figure(found)
    )


@styled
def gaits_figure(comparison: GaitComparison) -> Figure:
    """Peak torque, beam free over beam fixed, against the order parameter; a panel for
    each mass ratio.

    A bar reaches from the leg that needs least to the one that needs most.
    """
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    panels = (
        figure.subplots(1, len(comparison.named), sharey=True, squeeze=False)
        .ravel()
        .tolist()
    )
    for named, peaks, law, axes in zip(
        comparison.named, comparison.peak, comparison.law, panels, strict=True
    ):
        axes.axhline(1.0, color=QUIET, linewidth=0.8)
        axes.plot(comparison.order, peaks, "o", ms=2.6, mew=0, color=ONE, alpha=0.35)
        axes.plot(comparison.orders, law, color=BEAM, linewidth=1.6)
        for gait in named:
            axes.plot(
                [gait.order] * 2,
                [gait.least_peak, gait.peak],
                color=TWO,
                linewidth=2.2,
                solid_capstyle="butt",
            )
            axes.plot(gait.order, gait.peak, "o", ms=6, color=TWO)
            axes.plot(
                gait.order, gait.root_mean_square, "o", ms=5, mfc="white", color=BEAM
            )
        still = [gait.gait for gait in named if gait.order < AT_REST]
        names = ", ".join(still[:2]) + ",\n" + ", ".join(still[2:])
        axes.annotate(
            names,
            (0.0, 1.0),
            (4, -10),
            textcoords="offset points",
            va="top",
            fontsize=8.5,
            color=INK,
        )
        moving = sorted(
            (gait for gait in named if gait.order >= AT_REST),
            key=lambda gait: gait.order,
        )
        for gait, after in zip(moving, (*moving[1:], None), strict=True):
            # the next one's bar is in the way
            left = after is None or after.order - gait.order < 0.1
            place = {
                "xytext": (-8 if left else 7, 6),
                "ha": "right" if left else "left",
            }
            at = (gait.order, gait.peak)
            axes.annotate(
                gait.gait,
                at,
                textcoords="offset points",
                fontsize=8.5,
                path_effects=HALO,
                **place,
            )
        ratio = named[0].mass_ratio
        axes.set_title(f"R = {ratio:.3g}{', BP2' if ratio == bp2.MASS_RATIO else ''}")
        axes.set(xlabel="Order parameter, |mean $e^{i\\varphi}$|", xlim=(-0.03, 1.03))
    highest = max(
        comparison.peak.max(),
        *(gait.peak for named in comparison.named for gait in named),
    )
    panels[0].set_ylim(0.0, 1.08 * highest)
    panels[0].set_ylabel("Peak torque, beam free / fixed")
    handles = [
        Line2D(
            [],
            [],
            color=TWO,
            marker="o",
            ms=6,
            label="peak: neediest leg, bar to the least needy",
        ),
        Line2D(
            [],
            [],
            color=ONE,
            marker="o",
            ms=3,
            linestyle="",
            alpha=0.6,
            label="peak, any phases",
        ),
        Line2D(
            [],
            [],
            color=BEAM,
            marker="o",
            ms=5,
            mfc="white",
            linestyle="",
            label="root mean square",
        ),
        Line2D([], [], color=BEAM, linewidth=1.6, label="that of small swings, exact"),
    ]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=2, columnspacing=2.0
    )
    return figure
