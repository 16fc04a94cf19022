"""The paper's prescribed motion, and how much of what it shows hangs on a length that
it does not give (Fig. 3E)."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bp2_rl.base.plotting import INK, QUIET, WIDTH, styled
from bp2_rl.paper.pendulum.bp2 import LEG_LENGTH, reduced_frequency
from bp2_rl.paper.pendulum.settings import PendulumTorqueSettings
from bp2_rl.paper.pendulum.study import BEAM, PENDULUMS, PendulumStudy, remark
from bp2_rl.paper.pendulum.torque import PendulumCycle, drive, peak, root_mean_square

LENGTHS = (0.05, 10.0)  # m, of the curve over lengths
POINTS = 200  # of it
# W at which gravity is a part in 1e12 of inertia: the limit of long pendulums
FASTEST = 1e6
TAKES, ADDS = "#BFE3D6", "#F5D2BC"
TICKS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # m, of the length


@dataclasses.dataclass(frozen=True)
class LengthRow:
    """Torques with the beam free over those with it fixed, of each pendulum."""

    length: float  # m; infinite for the limit
    frequency: float  # W
    peak: tuple[float, float]
    root_mean_square: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Prescribed:
    """One motion: its cycle at one length, and the ratios at several."""

    mass_ratio: float
    phase: float  # rad, of the second ahead of the first
    shown: LengthRow
    cycle: PendulumCycle
    rows: tuple[LengthRow, ...]  # at the length shown, at BP2's leg, and in the limit
    lengths: Float[np.ndarray, " points"]  # m
    peaks: Float[np.ndarray, "points 2"]  # free over fixed
    root_mean_squares: Float[np.ndarray, "points 2"]

    def arrays(self) -> dict[str, Any]:
        """The curves: torques in m g l over an angle W t in rad, and ratios over the
        length in m."""
        cycle = {
            name: getattr(self.cycle, name)
            for name in ("angle", "theta", "fixed", "coupled", "free")
        }
        return cycle | {
            name: getattr(self, name)
            for name in ("lengths", "peaks", "root_mean_squares")
        }


def prescribe(
    mass_ratio: float, amplitude: float, phase: float, hertz: float, length: float
) -> Prescribed:
    """Two pendulums that swing alike, the second ahead by `phase`, `hertz` times a
    second."""
    lengths = np.geomspace(*LENGTHS, POINTS)
    printed = list(dict.fromkeys((length, LEG_LENGTH)))  # once, if they are the same

    def at(frequency: np.ndarray) -> PendulumCycle:
        return drive(
            np.array([0.0, phase]), np.array(amplitude), frequency, np.array(mass_ratio)
        )

    rows = [_row(one, reduced_frequency(hertz, one), at) for one in printed]
    curve = _ratios(at(np.array([reduced_frequency(hertz, one) for one in lengths])))
    return Prescribed(
        mass_ratio=mass_ratio,
        phase=phase,
        shown=rows[0],
        cycle=at(np.array(rows[0].frequency)),
        rows=(
            *rows,
            dataclasses.replace(_row(math.inf, FASTEST, at), frequency=math.inf),
        ),
        lengths=lengths,
        peaks=curve[0],
        root_mean_squares=curve[1],
    )


def _row(
    length: float, frequency: float, at: Callable[[np.ndarray], PendulumCycle]
) -> LengthRow:
    """The ratios of the motion that `at` makes at a W."""
    peaks, root_mean_squares = (
        (float(one), float(two)) for one, two in _ratios(at(np.array(frequency)))
    )
    return LengthRow(length, frequency, peaks, root_mean_squares)


def _ratios(
    cycle: PendulumCycle,
) -> tuple[Float[np.ndarray, "*many 2"], Float[np.ndarray, "*many 2"]]:
    """Return each pendulum's peak torque and root mean square torque, free over
    fixed."""
    return peak(cycle.free) / peak(cycle.fixed), root_mean_square(
        cycle.free
    ) / root_mean_square(cycle.fixed)


def compare_torques(settings: PendulumTorqueSettings) -> PendulumStudy:
    """Study what a free beam takes off the torques of a prescribed motion."""
    case = prescribe(
        settings.mass_ratio,
        settings.amplitude,
        settings.phase,
        settings.frequency,
        settings.length,
    )
    rows = []
    for row in case.rows:
        ratios = (
            " / ".join(f"{ratio:.3f}" for ratio in pair)
            for pair in (row.peak, row.root_mean_square)
        )
        rows.append((f"{row.length:g}", f"{row.frequency:.2f}", *ratios))
    columns = (
        "length, m",
        "W",
        "peak free / fixed, 1 / 2",
        "root mean square free / fixed, 1 / 2",
    )
    return PendulumStudy(
        columns, rows, {"lengths": case.rows}, case.arrays(), torque_figure(case)
    )


@styled
def torque_figure(case: Prescribed) -> Figure:
    """Torques over a cycle, shaded where coupling adds or takes (paper, Fig. 3E);
    below, ratios over the length."""
    figure = Figure(figsize=(WIDTH, 6.2), layout="constrained")
    top, low = np.asarray(figure.subfigures(2, 1, height_ratios=(1.25, 1.0)))
    pair, over = top.subplots(1, 2, sharey=True), low.subplots()
    cycle, shown = case.cycle, case.shown
    around = np.append(cycle.angle, 2.0 * math.pi) / (2.0 * math.pi)
    for pendulum, axes in enumerate(pair):
        fixed, free = (
            np.append(torque[:, pendulum], torque[0, pendulum])
            for torque in (cycle.fixed, cycle.free)
        )
        axes.fill_between(around, fixed, free, color=TAKES, linewidth=0)
        adds = np.abs(free) > np.abs(fixed)
        axes.fill_between(
            around, fixed, free, where=adds, color=ADDS, linewidth=0, interpolate=True
        )
        axes.plot(around, fixed, color=QUIET, linewidth=1.3, linestyle=(0, (4, 2)))
        axes.plot(around, free, color=PENDULUMS[pendulum], linewidth=2.0)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set(
            xlabel="Time / period",
            xlim=(0.0, 1.0),
            title=f"{'AB'[pendulum]}   Pendulum {pendulum + 1}",
        )
        remark(
            axes,
            f"free / fixed: peak {shown.peak[pendulum]:.3f}, r.m.s. {shown.root_mean_square[pendulum]:.3f}",
        )
    top_torque = float(np.max(np.abs((cycle.fixed, cycle.free))))
    pair[0].set(ylabel="Torque / (m g l)", ylim=(-1.1 * top_torque, 1.4 * top_torque))
    for values, label, color in (
        (case.peaks, "peak", PENDULUMS[0]),
        (case.root_mean_squares, "root mean square", BEAM),
    ):
        over.plot(case.lengths, values.max(axis=-1), color=color, label=label)
    within = sorted(
        (row for row in case.rows if LENGTHS[0] <= row.length <= LENGTHS[1]),
        key=lambda row: row.length,
    )
    for row, side in zip(within, ("right", "left"), strict=False):
        at = (row.length, max(row.peak))
        over.plot(*at, "o", color=PENDULUMS[0], ms=5)
        text = f"{max(row.peak):.3f} at {row.length:g} m (W = {row.frequency:.2f})"
        over.annotate(
            text, at, (0, 9), textcoords="offset points", ha=side, fontsize=8.5
        )
    limit = max(case.rows[-1].peak)
    over.axhline(
        limit,
        color=INK,
        linewidth=0.9,
        linestyle=(0, (4, 2)),
        label=f"peak, very long: {limit:.3f}",
    )
    over.set(
        xscale="log",
        xlabel="Length of a pendulum [m], which the paper does not give",
        ylabel="Free / fixed",
    )
    highest = max(1.0, limit, *(max(row.peak) for row in within))
    over.set(
        title="C   What the free beam leaves of the torque",
        xlim=LENGTHS,
        ylim=(0.0, 1.2 * highest),
    )
    over.set_xticks(TICKS, labels=[f"{tick:g}" for tick in TICKS])
    over.minorticks_off()
    over.legend(loc="lower right", ncols=3)
    handles = [
        Line2D([], [], color=PENDULUMS[0], linewidth=2.0, label="beam free, 1"),
        Line2D([], [], color=PENDULUMS[1], linewidth=2.0, label="beam free, 2"),
        Line2D(
            [],
            [],
            color=QUIET,
            linewidth=1.3,
            linestyle=(0, (4, 2)),
            label="beam fixed",
        ),
        Patch(color=TAKES, linewidth=0, label="coupling takes"),
        Patch(color=ADDS, linewidth=0, label="coupling adds"),
    ]
    top.legend(
        handles=handles,
        loc="outside upper center",
        ncols=5,
        handlelength=1.8,
        columnspacing=1.4,
    )
    return figure
