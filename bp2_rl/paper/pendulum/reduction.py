"""Where a free beam lowers the peak torque of two pendulums, and where it raises it:
maps over phase, frequency, amplitude."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from scipy.optimize import brentq

from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import INK, WIDTH, styled
from bp2_rl.paper.figures.drawn import (
    DASHES,
    Drawn,
    drawn_rows,
    joined,
    legend_above_panels,
)
from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.settings import (
    HIP_AMPLITUDE,
    LEG_LENGTH,
    MASS_RATIO,
    STRIDE_FREQUENCY,
    PendulumMapSettings,
    driven_frequency,
    reduced_frequency,
)
from bp2_rl.paper.pendulum.torque import drive, peak

# rad: an amplitude at which what is left out of the small-angle law is its square, 1e-8
SMALL = 1e-4
# columns of a map, from 0 to pi: a phase of 2 pi - phi is the same with the pendulums'
# names exchanged
PHASES = 91
FREQUENCIES = (0.1, 5.0)  # W of a map's rows
AMPLITUDES = (0.02, 1.5)  # rad
ROWS = 80
# colours: a ratio is blue where a free beam helps, white at 1, red where it hurts
HELPS_AND_HURTS = "RdBu_r"
LEAST, MOST = 0.2, 1.5  # of the colours: at W = 1 the ratio has a pole


@dataclasses.dataclass(frozen=True)
class Reduction:
    """Frequency above which a free beam lowers the peak torque, at one mass ratio."""

    mass_ratio: float = metric("R", form=".3g")
    frequency: float = metric("W of the map over amplitudes", form=".3g")
    # W above which a free beam helps small swings
    boundary: float = metric("Helps above W, in closed form", form=".4f")
    # least and greatest over the phases, from the torques
    boundary_measured: tuple[float, float] = metric(
        "From the torques", form=joined(".4f", " to ")
    )
    boundary_error: float = metric("W^2 off", form=".0e")  # greatest difference
    # greatest difference of the map over frequencies to its closed form, relative where
    # that exceeds 1
    small_swing_error: float = metric("Map off", form=".0e")


@dataclasses.dataclass(frozen=True)
class Maps:
    """Maps of the ratio of peak torques, beam free over fixed, at one mass ratio; rows
    by frequency or amplitude, columns by phase."""

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
    """Return the ratio of the greater peak torques of two pendulums a phase apart, beam
    free over beam fixed."""
    phases = np.stack(np.broadcast_arrays(0.0, phase), axis=-1)
    cycle = drive(phases, amplitude, frequency, mass_ratio)
    return np.asarray(
        np.max(peak(cycle.free), axis=-1) / np.max(peak(cycle.fixed), axis=-1)
    )


def reduction_maps(mass_ratio: float, frequency: float) -> Maps:
    """Return a mass ratio's maps over frequency and, at the W `frequency`, over
    amplitude."""
    phases = np.linspace(0.0, np.pi, PHASES)
    # the middles of equal parts: none is at W = 1, where the ratio has a pole
    frequencies, amplitudes = (
        low + (np.arange(ROWS) + 0.5) * ((high - low) / ROWS)
        for low, high in (FREQUENCIES, AMPLITUDES)
    )
    ratio = np.array(mass_ratio)
    over_frequency = peak_ratio(phases, np.array(SMALL), frequencies[:, None], ratio)
    over_amplitude = peak_ratio(phases, amplitudes[:, None], np.array(frequency), ratio)
    law = exact.small_torque_ratio(phases, frequencies[:, None], ratio)
    measured = [_boundary(phase, mass_ratio) for phase in phases[:-1:10]]
    boundary = exact.boundary_frequency(mass_ratio)
    reduction = Reduction(
        mass_ratio=mass_ratio,
        frequency=frequency,
        boundary=boundary,
        boundary_measured=(min(measured), max(measured)),
        boundary_error=max(abs(w**2 - boundary**2) for w in measured),
        small_swing_error=float(
            np.max(np.abs(over_frequency - law) / np.maximum(law, 1.0))
        ),
    )
    return Maps(
        reduction, phases, frequencies, amplitudes, over_frequency, over_amplitude
    )


def _boundary(phase: float, mass_ratio: float) -> float:
    """Return the W at which a free beam makes no difference to small swings a phase
    apart, from their torques."""

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


def map_reduction(settings: PendulumMapSettings) -> Drawn:
    """Draw and tabulate where a free beam lowers the peak torque, for each mass ratio
    and for BP2."""
    frequency = driven_frequency(settings.frequency, settings.length)
    robot = reduced_frequency(STRIDE_FREQUENCY, LEG_LENGTH)
    maps = [reduction_maps(ratio, frequency) for ratio in settings.mass_ratio]
    maps.append(reduction_maps(MASS_RATIO, robot))
    rows = tuple(one.reduction for one in maps)
    return drawn_rows("mass_ratios", rows, map=reduction_figure(maps))


@styled
def reduction_figure(maps: Sequence[Maps]) -> Figure:
    """Draw maps of peak torque of two pendulums, beam free over beam fixed; a column
    for each mass ratio, BP2's last.

    The dashed line is the boundary in closed form, the black curve that of the map; a
    star is BP2's trot.
    """
    figure = Figure(figsize=(WIDTH, 5.9), layout="constrained")
    panels = figure.subplots(2, len(maps), sharex=True, sharey="row", squeeze=False)
    norm = TwoSlopeNorm(1.0, LEAST, MOST)
    for one, (upper, lower) in zip(maps, panels.T, strict=True):
        for axes, rows, values in (
            (upper, one.frequencies, one.over_frequency),
            (lower, one.amplitudes, one.over_amplitude),
        ):
            axes.pcolormesh(
                one.phases,
                rows,
                values,
                cmap=HELPS_AND_HURTS,
                norm=norm,
                shading="gouraud",
                rasterized=True,
            )
            axes.grid(visible=False)
        # in antiphase there is no difference anyway
        inner = one.phases[:-1], one.amplitudes, one.over_amplitude[:, :-1]
        lower.contour(*inner, [1.0], colors=INK, linewidths=1.4)
        upper.axhline(
            one.reduction.boundary,
            color=INK,
            linewidth=1.2,
            linestyle=DASHES,
            label="boundary, exact: $W^2 = (R+2)/(R+1)$",
        )
        upper.set_title(f"R = {one.reduction.mass_ratio:.3g}")
        lower.set_title(f"W = {one.reduction.frequency:.3g}", fontweight="normal")
        lower.set_xlabel("Phase [rad]")
        lower.set_xticks([0.0, math.pi / 2, math.pi], ["0", "$\\pi/2$", "$\\pi$"])
    for axes, height in zip(
        panels[:, -1], (maps[-1].reduction.frequency, HIP_AMPLITUDE), strict=True
    ):
        star = {"color": INK, "ms": 10, "clip_on": False, "zorder": 5}
        axes.plot(math.pi, height, "*", label="BP2's trot", **star)
    panels[0, -1].set_title(f"BP2: R = {MASS_RATIO:.3g}")
    panels[0, 0].set_ylabel("Frequency of small swings, $W = \\omega/\\omega_0$")
    panels[1, 0].set_ylabel("Amplitude [rad]")
    bar = figure.colorbar(
        panels[0, 0].collections[0],
        ax=panels.ravel().tolist(),
        extend="both",
        aspect=40,
    )
    bar.set_label("Peak torque, free / fixed; black curve: no difference")
    legend_above_panels(figure, panels[0, -1], 2)
    return figure
