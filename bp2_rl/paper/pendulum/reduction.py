"""When a free beam lowers the peak torque of two pendulums, and when it raises it: over
phase, frequency, amplitude."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.optimize import brentq

from bp2_rl.base.plotting import INK, WIDTH, styled
from bp2_rl.paper.pendulum import bp2, exact
from bp2_rl.paper.pendulum.settings import PendulumMapSettings, driven_frequency
from bp2_rl.paper.pendulum.study import PendulumStudy, numbered
from bp2_rl.paper.pendulum.torque import drive, peak

# rad: an amplitude at which what is left out of the small-angle law is its square, 1e-8
SMALL = 1e-4
# columns of a map, from 0 to pi: a phase of 2 pi - phi is the same with the pendulums'
# names exchanged
PHASES = 91
FREQUENCIES = (0.1, 5.0)  # W of a map's rows
AMPLITUDES = (0.02, 1.5)  # rad
ROWS = 80
SPOTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of pi: phases whose numbers are printed
# colours: a ratio is blue where a free beam helps, white at 1, red where it hurts
HELPS_AND_HURTS = "RdBu_r"
MOST = 1.5  # of the colours over frequency: at W = 1 the ratio has a pole
CONTOURS = (0.4, 0.7, 0.9)
LABELLED = 0.3  # of a map's height, at which its contours are labelled
COLOR_TICKS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5)


@dataclasses.dataclass(frozen=True)
class Reduction:
    """One mass ratio in numbers; a ratio is that of the peak torques, beam free over
    beam fixed."""

    mass_ratio: float
    frequency: float  # W of the map over amplitudes
    boundary: float  # W above which a free beam helps small swings, in closed form
    # least and greatest over the phases, from the torques
    boundary_measured: tuple[float, float]
    boundary_error: float  # greatest difference of W^2
    small_swing_error: float
    """greatest difference of the map over frequencies to its closed form, relative
    where that exceeds 1"""
    phases: tuple[float, ...]  # rad, of the next two
    at_small_amplitude: tuple[float, ...]
    at_one_radian: tuple[float, ...]
    greatest: float  # of the map over amplitudes
    greatest_at: tuple[float, float]  # phase and amplitude, rad
    share_that_helps: float  # of that map's area


@dataclasses.dataclass(frozen=True)
class Maps:
    """The maps of one mass ratio; rows by frequency or amplitude, columns by phase."""

    reduction: Reduction
    phases: Float[np.ndarray, " phases"]  # rad
    frequencies: Float[np.ndarray, " rows"]
    amplitudes: Float[np.ndarray, " rows"]  # rad
    over_frequency: Float[np.ndarray, "rows phases"]  # of small swings
    over_amplitude: Float[np.ndarray, "rows phases"]


def peak_ratio(
    phase: Float[np.ndarray, "*#many"],
    amplitude: Float[np.ndarray, "*#many"],
    frequency: Float[np.ndarray, "*#many"],
    mass_ratio: Float[np.ndarray, "*#many"],
) -> Float[np.ndarray, "*many"]:
    """Return the greater peak torque of two pendulums a phase apart, beam free over
    beam fixed."""
    cycle = drive(
        np.stack(np.broadcast_arrays(0.0, phase), axis=-1),
        amplitude,
        frequency,
        mass_ratio,
    )
    return np.asarray(
        np.max(peak(cycle.free), axis=-1) / np.max(peak(cycle.fixed), axis=-1)
    )


def reduction_maps(mass_ratio: float, frequency: float) -> Maps:
    """Both maps of one mass ratio; `frequency` is the W of the one over amplitudes."""
    phases = np.linspace(0.0, np.pi, PHASES)
    frequencies, amplitudes = (_between(*ends) for ends in (FREQUENCIES, AMPLITUDES))
    ratio = np.array(mass_ratio)
    over_frequency = peak_ratio(phases, np.array(SMALL), frequencies[:, None], ratio)
    over_amplitude = peak_ratio(phases, amplitudes[:, None], np.array(frequency), ratio)
    law = exact.small_torque_ratio(phases, frequencies[:, None], ratio)
    measured = [_boundary(phase, mass_ratio) for phase in phases[:-1:10]]
    boundary = exact.boundary_frequency(mass_ratio)
    row, column = np.unravel_index(np.argmax(over_amplitude), over_amplitude.shape)
    spots = np.pi * np.array(SPOTS)
    small, wide = (
        peak_ratio(spots, np.array(amplitude), np.array(frequency), ratio)
        for amplitude in (SMALL, 1.0)
    )
    reduction = Reduction(
        mass_ratio=mass_ratio,
        frequency=frequency,
        boundary=boundary,
        boundary_measured=(min(measured), max(measured)),
        boundary_error=max(abs(w**2 - boundary**2) for w in measured),
        small_swing_error=float(
            np.max(np.abs(over_frequency - law) / np.maximum(law, 1.0))
        ),
        phases=tuple(map(float, spots)),
        at_small_amplitude=tuple(map(float, small)),
        at_one_radian=tuple(map(float, wide)),
        greatest=float(over_amplitude[row, column]),
        greatest_at=(float(phases[column]), float(amplitudes[row])),
        # in antiphase there is nothing to gain
        share_that_helps=float(np.mean(over_amplitude[:, :-1] < 1.0)),
    )
    return Maps(
        reduction, phases, frequencies, amplitudes, over_frequency, over_amplitude
    )


def _between(low: float, high: float) -> Float[np.ndarray, " rows"]:
    """Centres of equal intervals: so none is at W = 1, where the ratio has a pole."""
    return low + (np.arange(ROWS) + 0.5) * ((high - low) / ROWS)


def _boundary(phase: float, mass_ratio: float) -> float:
    """The W at which a free beam makes no difference to small swings a phase apart,
    from their torques."""

    def gain(frequency: float) -> float:
        return (
            float(peak_ratio(*map(np.array, (phase, SMALL, frequency, mass_ratio))))
            - 1.0
        )

    # W^2 is between 1 + 1 / (R + 1), the least being the pole at 1, and 2.
    return float(
        np.asarray(
            brentq(gain, 1.0 + 1e-3 / (1.0 + mass_ratio), math.sqrt(2.0), xtol=1e-12)
        )
    )


def map_reduction(settings: PendulumMapSettings) -> PendulumStudy:
    """Study where a free beam helps, for each mass ratio and for BP2."""
    frequency = driven_frequency(settings.frequency, settings.length)
    robot = bp2.reduced_frequency(bp2.STRIDE_FREQUENCY, bp2.LEG_LENGTH)
    maps = [reduction_maps(ratio, frequency) for ratio in settings.mass_ratio]
    maps.append(reduction_maps(bp2.MASS_RATIO, robot))
    rows = []
    for one in (one.reduction for one in maps):
        spots = (
            " ".join(f"{ratio:.2f}" for ratio in ratios)
            for ratios in (one.at_small_amplitude, one.at_one_radian)
        )
        worst = (
            f"{one.greatest:.3f} at {one.greatest_at[0]:.2f}, {one.greatest_at[1]:.2f}"
        )
        rows.append(
            (
                f"{one.mass_ratio:.3g}",
                f"{one.boundary:.4f}",
                f"{one.boundary_error:.0e}",
                *spots,
                worst,
            )
        )
    columns = (
        "R",
        "helps: W",
        "W^2 off",
        "small swings, 0 to pi",
        "1 rad, 0 to pi",
        "worst, phase, rad",
    )
    arrays = {
        name: getattr(maps[0], name) for name in ("phases", "frequencies", "amplitudes")
    }
    arrays |= numbered(
        {"over_frequency": one.over_frequency, "over_amplitude": one.over_amplitude}
        for one in maps
    )
    return PendulumStudy(
        columns,
        rows,
        {"mass_ratios": [one.reduction for one in maps]},
        arrays,
        reduction_figure(maps),
    )


@styled
def reduction_figure(maps: Sequence[Maps]) -> Figure:
    """Peak torque of two pendulums, beam free over beam fixed; a column for each mass
    ratio, BP2's last.

    The dashed line is the boundary in closed form, the black curve that of the map; a
    star is BP2's trot.
    """
    figure = Figure(figsize=(WIDTH, 5.9), layout="constrained")
    panels = figure.subplots(2, len(maps), sharex=True, sharey="row", squeeze=False)
    least = min(float(one.over_frequency.min()) for one in maps)
    most = max(1.2, *(one.reduction.greatest for one in maps))
    images = []
    for one, (upper, lower) in zip(maps, panels.T, strict=True):
        for axes, rows, values, norm in (
            (
                upper,
                one.frequencies,
                np.minimum(one.over_frequency, MOST),
                TwoSlopeNorm(1.0, least, MOST),
            ),
            (lower, one.amplitudes, one.over_amplitude, TwoSlopeNorm(1.0, least, most)),
        ):
            axes.grid(visible=False)
            image = axes.pcolormesh(
                one.phases,
                rows,
                values,
                cmap=HELPS_AND_HURTS,
                norm=norm,
                shading="gouraud",
                rasterized=True,
            )
            lines = axes.contour(
                one.phases, rows, values, CONTOURS, colors=INK, linewidths=0.5
            )
            axes.clabel(
                lines,
                fmt="%.1f",
                fontsize=7.0,
                manual=_label_places(one.phases, rows, values),
            )
            images.append(image)
        reduction = one.reduction
        lower.contour(
            one.phases[:-1],
            one.amplitudes,
            one.over_amplitude[:, :-1],
            [1.0],
            colors=INK,
            linewidths=1.4,
        )
        upper.axhline(
            reduction.boundary, color=INK, linewidth=1.2, linestyle=(0, (4, 2))
        )
        upper.set_title(f"R = {reduction.mass_ratio:.3g}")
        lower.set_title(f"W = {reduction.frequency:.3g}", fontweight="normal")
        lower.set_xlabel("Phase [rad]")
        lower.set_xticks(
            [0.0, math.pi / 2.0, math.pi], labels=["0", "$\\pi/2$", "$\\pi$"]
        )
    _mark_trot(panels[0, -1], maps[-1].reduction.frequency)
    _mark_trot(panels[1, -1], bp2.HIP_AMPLITUDE)
    panels[0, -1].set_title(f"BP2: R = {maps[-1].reduction.mass_ratio:.3g}")
    panels[0, 0].set_ylabel("Frequency of small swings, $W = \\omega/\\omega_0$")
    panels[1, 0].set_ylabel("Amplitude [rad]")
    for row, image, extend in (
        (panels[0], images[0], "max"),
        (panels[1], images[1], "neither"),
    ):
        bar = figure.colorbar(
            image, ax=row.tolist(), extend=extend, pad=0.01, aspect=18
        )
        bar.set_ticks(
            [tick for tick in COLOR_TICKS if tick <= image.norm.vmax], minor=False
        )
        bar.ax.set_yticklabels([f"{tick:g}" for tick in bar.get_ticks()])
        bar.set_label("Peak torque, free / fixed")
        bar.outline.set_visible(False)
    handles = [
        Line2D(
            [],
            [],
            color=INK,
            linewidth=1.2,
            linestyle=(0, (4, 2)),
            label="boundary, exact: $W^2 = (R+2)/(R+1)$",
        ),
        Line2D([], [], color=INK, linewidth=1.4, label="no difference"),
        Line2D([], [], color=INK, marker="*", ms=9, linestyle="", label="BP2's trot"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _label_places(
    phases: Float[np.ndarray, " phases"],
    rows: Float[np.ndarray, " rows"],
    values: Float[np.ndarray, "rows phases"],
) -> list[tuple[float, float]]:
    """Where contours cross one row of a map, clear of where they crowd."""
    row = round(LABELLED * len(rows))
    crossed = [
        np.flatnonzero(np.diff(np.sign(values[row] - level))) for level in CONTOURS
    ]
    return [
        (float(phases[columns[0]]), float(rows[row]))
        for columns in crossed
        if len(columns)
    ]


def _mark_trot(axes: Axes, height: float) -> None:
    axes.plot(math.pi, height, "*", color=INK, ms=10, clip_on=False, zorder=5)
