"""The paper's prescribed motion, and how much of what it shows hangs on a length that it does not give (Fig. 3E)."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.pendulum.bp2 import LEG_LENGTH, reduced_frequency
from bp2_rl.paper.pendulum.torque import PendulumCycle, drive, peak, root_mean_square

LENGTHS = (0.05, 10.0)  # m, of the curve over lengths
POINTS = 200  # of it
FASTEST = 1e6  # W at which gravity is a part in 1e12 of inertia: the limit of long pendulums


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
        """The curves: torques in m g l over an angle W t in rad, and ratios over the length in m."""
        cycle = {name: getattr(self.cycle, name) for name in ("angle", "theta", "fixed", "coupled", "free")}
        return cycle | {name: getattr(self, name) for name in ("lengths", "peaks", "root_mean_squares")}


def prescribe(mass_ratio: float, amplitude: float, phase: float, hertz: float, length: float) -> Prescribed:
    """Two pendulums that swing alike, the second ahead by `phase`, `hertz` times a second."""
    lengths = np.geomspace(*LENGTHS, POINTS)
    printed = list(dict.fromkeys((length, LEG_LENGTH)))  # once, if they are the same

    def at(frequency: np.ndarray) -> PendulumCycle:
        return drive(np.array([0.0, phase]), np.array(amplitude), frequency, np.array(mass_ratio))

    rows = [_row(one, reduced_frequency(hertz, one), at) for one in printed]
    curve = _ratios(at(np.array([reduced_frequency(hertz, one) for one in lengths])))
    return Prescribed(
        mass_ratio=mass_ratio,
        phase=phase,
        shown=rows[0],
        cycle=at(np.array(rows[0].frequency)),
        rows=(*rows, dataclasses.replace(_row(math.inf, FASTEST, at), frequency=math.inf)),
        lengths=lengths,
        peaks=curve[0],
        root_mean_squares=curve[1],
    )


def _row(length: float, frequency: float, at: Callable[[np.ndarray], PendulumCycle]) -> LengthRow:
    """The ratios of the motion that `at` makes at a W."""
    peaks, root_mean_squares = ((float(one), float(two)) for one, two in _ratios(at(np.array(frequency))))
    return LengthRow(length, frequency, peaks, root_mean_squares)


def _ratios(cycle: PendulumCycle) -> tuple[Float[np.ndarray, "*many 2"], Float[np.ndarray, "*many 2"]]:
    """Return each pendulum's peak torque and root mean square torque, free over fixed."""
    return peak(cycle.free) / peak(cycle.fixed), root_mean_square(cycle.free) / root_mean_square(cycle.fixed)
