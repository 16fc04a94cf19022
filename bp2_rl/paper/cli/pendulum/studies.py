"""What each command of pendulums computes, as it is printed, drawn and left in a folder."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.paper.cli.pendulum.settings import (
    PendulumGaitsSettings,
    PendulumMapSettings,
    PendulumSectionsSettings,
    PendulumSimulateSettings,
    PendulumTorqueSettings,
    PendulumTrappingSettings,
    driven_frequency,
)
from bp2_rl.paper.pendulum import bp2
from bp2_rl.paper.pendulum.exchange import EVEN, exchanges
from bp2_rl.paper.pendulum.figures.exchange import exchange_figure
from bp2_rl.paper.pendulum.figures.gaits import gaits_figure
from bp2_rl.paper.pendulum.figures.reduction import reduction_figure
from bp2_rl.paper.pendulum.figures.sections import sections_figure
from bp2_rl.paper.pendulum.figures.torque import torque_figure
from bp2_rl.paper.pendulum.figures.trapping import trapping_figure
from bp2_rl.paper.pendulum.gaits import compare_gaits
from bp2_rl.paper.pendulum.prescribed import prescribe
from bp2_rl.paper.pendulum.reduction import reduction_maps
from bp2_rl.paper.pendulum.sections import sections
from bp2_rl.paper.pendulum.trapping import MASS_RATIOS, sweep_ratios, thresholds


class PendulumStudy(NamedTuple):
    """A command's table, numbers, curves and picture."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    results: Mapping[str, Sequence[Any]]  # dataclasses, by name: the numbers that picture and table show
    arrays: Mapping[str, Any]  # what the picture's curves are drawn from
    figure: Figure


def simulate(settings: PendulumSimulateSettings) -> PendulumStudy:
    """Study how evenly two pendulums share the energy of one."""
    runs = exchanges(settings.amplitude, settings.mass_ratio, settings.periods)
    rows = []
    for one in (run.sharing for run in runs):
        even = "never" if one.even_after is None else f"{one.even_after:.1f} T0"
        means, moving = (" / ".join(f"{mean:.3f}" for mean in pair) for pair in (one.mean, one.mean_in_beam_frame))
        kept = f"{one.energy_drift:.0e} / {one.momentum_drift:.0e}"
        rows.append((f"{one.mass_ratio:g}", means, f"{one.mean_beam:.3f}", even, f"{one.beat:.2f} T0", moving, kept))
    columns = ["R", "means of 1 / 2, m g l", "of the beam", f"within {EVEN:g} after"]
    columns += ["small beat", "seen from the beam", "drift of E / p"]
    arrays = {"time": runs[0].time} | _numbered(run.arrays() for run in runs)
    return PendulumStudy(columns, rows, {"mass_ratios": [run.sharing for run in runs]}, arrays, exchange_figure(runs))


def cut_sections(settings: PendulumSectionsSettings) -> PendulumStudy:
    """Study how far apart the paths of two pendulums are."""
    found = sections(settings.amplitude, settings.mass_ratio, settings.periods, settings.instant)
    rows = []
    for path in (section.path for section in found):
        angles = (f"{low:+.2f} to {high:+.2f}" for low, high in path.angles)
        apart = "-" if path.apart is None else f"{path.apart:.3f}"
        rows.append((f"{path.mass_ratio:g}", str(path.points), *angles, apart))
    columns = ("R", "points", "angles of 1, rad", "angles of 2, rad", "paths apart")
    arrays = _numbered({"theta": section.theta, "rate": section.rate} for section in found)
    results = {"mass_ratios": [section.path for section in found]}
    return PendulumStudy(columns, rows, results, arrays, sections_figure(found, settings.instant))


def compare_torques(settings: PendulumTorqueSettings) -> PendulumStudy:
    """Study what a free beam takes off the torques of a prescribed motion."""
    case = prescribe(settings.mass_ratio, settings.amplitude, settings.phase, settings.frequency, settings.length)
    rows = []
    for row in case.rows:
        ratios = (" / ".join(f"{ratio:.3f}" for ratio in pair) for pair in (row.peak, row.root_mean_square))
        rows.append((f"{row.length:g}", f"{row.frequency:.2f}", *ratios))
    columns = ("length, m", "W", "peak free / fixed, 1 / 2", "root mean square likewise")
    return PendulumStudy(columns, rows, {"lengths": case.rows}, case.arrays(), torque_figure(case))


def map_reduction(settings: PendulumMapSettings) -> PendulumStudy:
    """Study where a free beam helps, for each mass ratio and for BP2."""
    frequency = driven_frequency(settings.frequency, settings.length)
    robot = bp2.reduced_frequency(bp2.STRIDE_FREQUENCY, bp2.LEG_LENGTH)
    maps = [reduction_maps(ratio, frequency) for ratio in settings.mass_ratio]
    maps.append(reduction_maps(bp2.MASS_RATIO, robot))
    rows = []
    for one in (one.reduction for one in maps):
        spots = (" ".join(f"{ratio:.2f}" for ratio in ratios) for ratios in (one.at_small_amplitude, one.at_one_radian))
        worst = f"{one.greatest:.3f} at {one.greatest_at[0]:.2f}, {one.greatest_at[1]:.2f}"
        rows.append((f"{one.mass_ratio:.3g}", f"{one.boundary:.4f}", f"{one.boundary_error:.0e}", *spots, worst))
    columns = ("R", "helps: W", "W^2 off", "small swings, 0 to pi", "1 rad, 0 to pi", "worst, phase, rad")
    arrays = {name: getattr(maps[0], name) for name in ("phases", "frequencies", "amplitudes")}
    arrays |= _numbered({"over_frequency": one.over_frequency, "over_amplitude": one.over_amplitude} for one in maps)
    return PendulumStudy(
        columns, rows, {"mass_ratios": [one.reduction for one in maps]}, arrays, reduction_figure(maps)
    )


def find_trapping(settings: PendulumTrappingSettings) -> PendulumStudy:
    """Study from which mass ratio on a swing stays with its pendulum."""
    ratios = np.geomspace(*MASS_RATIOS, settings.points)
    sweeps = [sweep_ratios(amplitude, ratios, settings.periods) for amplitude in settings.amplitude]
    found = list(thresholds(sorted(settings.thresholds)))
    rows = [
        (f"{one.amplitude:.3f}", *(f"{x:.1f}" for x in (one.exchanges, one.traps, one.law)), f"{one.off_law:.2f}")
        for one in found
    ]
    columns = ("amplitude, rad", "still exchanges at R", "is trapped at R", "law, 32 / A^2", "measured / law")
    arrays = {"mass_ratio": ratios} | _numbered(
        {"mean": one.mean, "mean_beam": one.mean_beam, "greatest": one.greatest} for one in sweeps
    )
    return PendulumStudy(columns, rows, {"sweeps": sweeps, "thresholds": found}, arrays, trapping_figure(sweeps, found))


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
    return PendulumStudy(columns, rows, {"gaits": named}, found.arrays(), gaits_figure(found))


STUDIES = {
    "simulate": simulate,
    "sections": cut_sections,
    "torque": compare_torques,
    "map": map_reduction,
    "trapping": find_trapping,
    "gaits": gain_by_gait,
}
"""By the name of the command."""


def _numbered(systems: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the arrays of several systems, each array's name followed by its system's place."""
    return {f"{name}_{place}": values for place, arrays in enumerate(systems) for name, values in arrays.items()}
