"""The torques that move pendulums as one wants, with the beam free and with it fixed
(paper, Fig. 3 E).

The motion is the paper's: th_i = A sin(W t + phi_i), W the frequency over w0. It is
looked at over one cycle, in which the beam's momentum stays zero. The paper does not
give the pendulums' length, so the ratios are shown over it.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import FALL, FRONT, QUIET, WIDTH, styled
from bp2_rl.paper.figures.drawn import (
    Drawn,
    drawn_rows,
    joined,
    legend_above_panels,
    remark,
)
from bp2_rl.paper.pendulum import beam
from bp2_rl.paper.pendulum.settings import (
    LEG_LENGTH,
    PendulumTorqueSettings,
    reduced_frequency,
)

SAMPLES = 256
"""Samples of a cycle. A peak between two samples is found to 1e-7 of its height."""
# W at which gravity is a part in 1e12 of inertia: the limit of long pendulums
FASTEST = 1e6
TAKES, ADDS = "#BFE3D6", "#F5D2BC"  # colours of what coupling takes and adds
PENDULUMS = FRONT, FALL


@dataclasses.dataclass(frozen=True)
class PendulumCycle:
    """Angles, rates and torques of pendulums over one cycle of a motion; axes are
    systems, then time, then pendulums."""

    angle: Float[np.ndarray, " samples"]  # W t, rad
    theta: Float[np.ndarray, "*many samples pendulums"]
    rate: Float[np.ndarray, "*many samples pendulums"]
    # u~, torque with the beam fixed, in m g l
    fixed: Float[np.ndarray, "*many samples pendulums"]
    # u^c, what the free beam adds
    coupled: Float[np.ndarray, "*many samples pendulums"]

    @property
    def free(self) -> Float[np.ndarray, "*many samples pendulums"]:
        """Torque of every pendulum with the beam free, u, in m g l."""
        return self.fixed + self.coupled


def drive(
    phase: Float[np.ndarray, "*#many pendulums"],
    amplitude: Float[np.ndarray, "*#many"],
    frequency: Float[np.ndarray, "*#many"],
    mass_ratio: Float[np.ndarray, "*#many"],
) -> PendulumCycle:
    """Return the torques of pendulums that swing alike but for their phases.

    Args:
        phase: of each pendulum, rad.
        amplitude: A, rad.
        frequency: W, over w0.
        mass_ratio: R.
    """
    angle = np.arange(SAMPLES) * (2.0 * np.pi / SAMPLES)
    amplitude, frequency, mass_ratio = (
        np.asarray(values)[..., None] for values in (amplitude, frequency, mass_ratio)
    )
    turned = angle[:, None] + phase[..., None, :]
    swing = amplitude[..., None] * np.sin(turned)
    rate = (amplitude * frequency)[..., None] * np.cos(turned)
    acceleration = -(frequency[..., None] ** 2) * swing
    theta, rate, acceleration = np.broadcast_arrays(swing, rate, acceleration)
    fixed = beam.fixed_torque(theta, acceleration)
    coupled = beam.coupled_torque(theta, rate, acceleration, mass_ratio)
    return PendulumCycle(angle, theta, rate, fixed, coupled)


def peak(
    torque: Float[np.ndarray, "*many samples pendulums"],
) -> Float[np.ndarray, "*many pendulums"]:
    """Return the greatest magnitude of torques over a cycle, between samples too."""
    at = np.argmax(np.abs(torque), axis=-2, keepdims=True)
    samples = ((at + step) % torque.shape[-2] for step in (-2, -1, 0, 1, 2))
    far, before, here, after, beyond = (
        np.take_along_axis(torque, at, axis=-2)[..., 0, :] for at in samples
    )
    # Derivatives by the sample, right to its fourth power; the third to its second.
    slope = (8.0 * (after - before) - (beyond - far)) / 12.0
    bend = (16.0 * (after + before) - (beyond + far) - 30.0 * here) / 12.0
    third = (beyond - far) / 2.0 - (after - before)
    # where the cubic through them is level; a torque that is the same throughout stays
    # put
    top = np.zeros_like(here)
    for _ in range(2):
        climb = slope + top * (bend + top * third / 2.0)
        fall = bend + top * third
        top -= np.divide(climb, fall, out=np.zeros_like(here), where=fall != 0.0)
    return np.abs(here + top * (slope + top * (bend / 2.0 + top * third / 6.0)))


def root_mean_square(
    torque: Float[np.ndarray, "*many samples pendulums"],
) -> Float[np.ndarray, "*many pendulums"]:
    """Return the root mean square of torques over a cycle."""
    return np.sqrt(np.mean(torque**2, axis=-2))


# --- The paper's motion ---------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class LengthRow:
    """Torque ratios of both pendulums at one length, beam free over beam fixed."""

    length: float = metric("Length", "m", "g")  # infinite for the limit
    frequency: float = metric("W", form=".2f")
    peak: tuple[float, float] = metric("Peak free / fixed, 1 / 2", form=joined(".3f"))
    root_mean_square: tuple[float, float] = metric(
        "Root mean square free / fixed", form=joined(".3f")
    )


@dataclasses.dataclass(frozen=True)
class Prescribed:
    """A prescribed motion: its cycle at one pendulum length, and the torque ratios at
    several."""

    cycle: PendulumCycle
    rows: tuple[LengthRow, ...]  # at the length shown, at BP2's leg, and in the limit


def prescribe(
    mass_ratio: float, amplitude: float, phase: float, hertz: float, length: float
) -> Prescribed:
    """Return the torques of two pendulums that swing alike at `hertz`, the second ahead
    by `phase`."""
    printed = list(dict.fromkeys((length, LEG_LENGTH)))  # once, if they are the same

    def at(frequency: Float[np.ndarray, "*many"]) -> PendulumCycle:
        return drive(
            np.array([0.0, phase]), np.array(amplitude), frequency, np.array(mass_ratio)
        )

    rows = [_row(one, reduced_frequency(hertz, one), at) for one in printed]
    limit = dataclasses.replace(_row(math.inf, FASTEST, at), frequency=math.inf)
    cycle = at(np.array(rows[0].frequency))
    return Prescribed(cycle, (*rows, limit))


def _row(
    length: float, frequency: float, at: Callable[[np.ndarray], PendulumCycle]
) -> LengthRow:
    """Return the torque ratios of the motion that `at` makes at a frequency W."""
    cycle = at(np.array(frequency))
    peaks, root_mean_squares = (
        (float(one), float(two))
        for one, two in (
            measured(cycle.free) / measured(cycle.fixed)
            for measured in (peak, root_mean_square)
        )
    )
    return LengthRow(length, frequency, peaks, root_mean_squares)


def compare_torques(settings: PendulumTorqueSettings) -> Drawn:
    """Draw and tabulate how a free beam changes the torques of a prescribed motion."""
    case = prescribe(
        settings.mass_ratio,
        settings.amplitude,
        settings.phase,
        settings.frequency,
        settings.length,
    )
    return drawn_rows("lengths", case.rows, torque=torque_figure(case))


@styled
def torque_figure(case: Prescribed) -> Figure:
    """Draw torques over a cycle, shaded where coupling adds to or takes from the torque
    (paper, Fig. 3 E)."""
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    pair = figure.subplots(1, 2).tolist()
    cycle = case.cycle
    shown = case.rows[0]
    top = float(np.max(np.abs((cycle.fixed, cycle.free))))
    around = np.append(cycle.angle, 2.0 * math.pi) / (2.0 * math.pi)
    for pendulum, axes in enumerate(pair):
        fixed, free = (
            np.append(torque[:, pendulum], torque[0, pendulum])
            for torque in (cycle.fixed, cycle.free)
        )
        less = np.abs(free) <= np.abs(fixed)
        for where, color, label in (
            (less, TAKES, "coupling takes"),
            (~less, ADDS, "coupling adds"),
        ):
            axes.fill_between(
                around,
                fixed,
                free,
                where=where,
                color=color,
                linewidth=0,
                interpolate=True,
                label=label,
            )
        axes.plot(around, fixed, color=QUIET, linestyle=(0, (4, 2)), label="beam fixed")
        axes.plot(around, free, color=PENDULUMS[pendulum], linewidth=2, label="free")
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set(
            title=f"{'AB'[pendulum]}   Pendulum {pendulum + 1}",
            xlabel="Time / period",
            ylabel="Torque / (m g l)",
            xlim=(0.0, 1.0),
            ylim=(-1.1 * top, 1.4 * top),
        )
        remark(
            axes,
            f"free / fixed: peak {shown.peak[pendulum]:.3f}, r.m.s. {shown.root_mean_square[pendulum]:.3f}",
        )
    legend_above_panels(figure, pair[0], 4)
    return figure
