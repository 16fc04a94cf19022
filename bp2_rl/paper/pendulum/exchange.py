"""How two pendulums share a swing: one is let go, the other hangs (paper, Fig.
model_analysis C)."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.integrate import cumulative_simpson

from bp2_rl.base.plotting import FAINT, INK, WIDTH, styled
from bp2_rl.paper.pendulum import beam, exact
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, SwingMotion, swing
from bp2_rl.paper.pendulum.settings import PendulumExchangeSettings
from bp2_rl.paper.pendulum.study import BEAM, PENDULUMS, PendulumStudy, numbered, remark

SAMPLES = 100  # of a natural period
EVEN = 0.05  # of m g l: means that differ by less are called even
PAPER_PERIODS = 6.0
PAPER_MEAN = 0.25
"""The paper's: "near-equipartition, about 0.25, within roughly six natural periods"."""


@dataclasses.dataclass(frozen=True)
class Sharing:
    """What came of one mass ratio. Energies in m g l, times in T0."""

    mass_ratio: float
    energy: float  # of the release
    # of each pendulum since the release, as seen from the ground
    mean: tuple[float, float]
    mean_beam: float
    mean_in_beam_frame: tuple[float, float]
    # from when on the means differ by less than EVEN; None if they never do
    even_after: float | None
    beat: float  # T_b of small swings
    # of the energy, each pendulum's and the beam's, of small swings
    small_swing_shares: tuple[float, float]
    energy_drift: float  # greatest error of what is kept
    momentum_drift: float


@dataclasses.dataclass(frozen=True)
class Exchange:
    """One mass ratio over time; arrays by sample."""

    sharing: Sharing
    time: Float[np.ndarray, " samples"]  # in T0
    energies: beam.Energies
    means: beam.Energies  # from the release to each time

    def arrays(self) -> dict[str, Any]:
        """The curves: `energy_` and `mean_`, of each kind of energy."""
        kinds = {"energy": self.energies, "mean": self.means}
        parts = [field.name for field in dataclasses.fields(beam.Energies)]
        return {
            f"{kind}_{part}": getattr(values, part)
            for kind, values in kinds.items()
            for part in parts
        }


def exchanges(
    amplitude: float, mass_ratios: Sequence[float], periods: float
) -> list[Exchange]:
    """Let one pendulum go at `amplitude` and watch both for so many natural periods,
    for each mass ratio."""
    time = np.linspace(0.0, periods * NATURAL_PERIOD, round(periods * SAMPLES) + 1)
    motion = swing(
        np.tile((amplitude, 0.0), (len(mass_ratios), 1)), np.array(mass_ratios), time
    )
    return [_exchange(motion, system) for system in range(len(mass_ratios))]


def _exchange(motion: SwingMotion, system: int) -> Exchange:
    """Return the exchange of energy in one of several systems."""
    time, mass_ratio = motion.time, motion.mass_ratio[system]
    state = (
        motion.theta[:, system],
        motion.rate[:, system],
        motion.beam_rate[:, system],
        mass_ratio[None],
    )
    energies, momentum = beam.energies(*state), beam.momentum(*state)
    parts = (getattr(energies, field.name) for field in dataclasses.fields(energies))
    means = beam.Energies(*(_running_mean(time, part) for part in parts))
    kept = energies.pendulums.sum(axis=-1) + energies.beam
    uneven = np.flatnonzero(
        np.abs(means.pendulums[:, 0] - means.pendulums[:, 1]) >= EVEN
    )
    last = int(uneven[-1]) if len(uneven) else 0
    sharing = Sharing(
        mass_ratio=float(mass_ratio),
        energy=float(kept[0]),
        mean=_pair(means.pendulums[-1]),
        mean_beam=float(means.beam[-1]),
        mean_in_beam_frame=_pair(means.beam_frame[-1]),
        even_after=None
        if last == len(time) - 1
        else float(time[last] / NATURAL_PERIOD),
        beat=exact.beat_period(float(mass_ratio)),
        small_swing_shares=exact.shares(float(mass_ratio)),
        energy_drift=float(np.max(np.abs(kept - kept[0]))),
        momentum_drift=float(np.max(np.abs(momentum))),
    )
    return Exchange(sharing, time / NATURAL_PERIOD, energies, means)


def _running_mean(time: Float[np.ndarray, " samples"], values: Any) -> Any:
    """From the release to each time; at the release the value itself."""
    so_far = time[1:].reshape(-1, *(1,) * (values.ndim - 1))
    return np.concatenate(
        (values[:1], cumulative_simpson(values, x=time, axis=0) / so_far)
    )


def _pair(values: Float[np.ndarray, " 2"]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def study_exchange(settings: PendulumExchangeSettings) -> PendulumStudy:
    """Study how evenly two pendulums share the energy of one."""
    runs = exchanges(settings.amplitude, settings.mass_ratio, settings.periods)
    rows = []
    for one in (run.sharing for run in runs):
        even = "never" if one.even_after is None else f"{one.even_after:.1f} T0"
        means, moving = (
            " / ".join(f"{mean:.3f}" for mean in pair)
            for pair in (one.mean, one.mean_in_beam_frame)
        )
        kept = f"{one.energy_drift:.0e} / {one.momentum_drift:.0e}"
        rows.append(
            (
                f"{one.mass_ratio:g}",
                means,
                f"{one.mean_beam:.3f}",
                even,
                f"{one.beat:.2f} T0",
                moving,
                kept,
            )
        )
    columns = ["R", "means of 1 / 2, m g l", "of the beam", f"within {EVEN:g} after"]
    columns += ["small beat", "seen from the beam", "drift of E / p"]
    arrays = {"time": runs[0].time} | numbered(run.arrays() for run in runs)
    return PendulumStudy(
        columns,
        rows,
        {"mass_ratios": [run.sharing for run in runs]},
        arrays,
        exchange_figure(runs),
    )


@styled
def exchange_figure(runs: Sequence[Exchange]) -> Figure:
    """Energies at each time and their means since the release (paper, Fig. 3C): a row
    for each mass ratio.

    Left as seen from the ground, where the three add up; right as seen from the beam.
    """
    figure = Figure(figsize=(WIDTH, 1.5 + 1.9 * len(runs)), layout="constrained")
    panels = figure.subplots(len(runs), 2, sharex=True, sharey=True, squeeze=False)
    for run, (ground, moving) in zip(runs, panels, strict=True):
        one = run.sharing
        for pendulum, color in enumerate(PENDULUMS):
            for axes, part in ((ground, "pendulums"), (moving, "beam_frame")):
                _draw(axes, run, part, color, pendulum)
        _draw(ground, run, "beam", BEAM)
        for axes in (ground, moving):
            axes.axvspan(0.0, PAPER_PERIODS, color=FAINT, alpha=0.7, linewidth=0)
            axes.axhline(PAPER_MEAN, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        means = [f"{mean:.3f}" for mean in one.mean]
        even = "never even"
        if one.even_after is not None:
            even = f"even after {one.even_after:.1f} $T_0$"
            ground.axvline(
                one.even_after, color=INK, linewidth=0.9, linestyle=(0, (1, 1.5))
            )
        remark(ground, f"means {' / '.join(means)}, beam {one.mean_beam:.3f}\n{even}")
        remark(
            moving,
            f"means {' / '.join(f'{mean:.3f}' for mean in one.mean_in_beam_frame)}",
        )
        ground.set_title(f"R = {one.mass_ratio:g}, seen from the ground")
        moving.set_title(f"R = {one.mass_ratio:g}, seen from the beam")
        ground.set_ylabel("Energy / (m g l)")
    top = max(
        float(getattr(run.energies, part).max())
        for run in runs
        for part in ("pendulums", "beam_frame")
    )
    panels[0, 0].set(xlim=(0.0, runs[0].time[-1]), ylim=(0.0, 1.35 * top))
    for axes in panels[-1]:
        axes.set_xlabel("Time / $T_0$")
    handles = [
        Line2D([], [], color=color, label=label)
        for color, label in zip(
            (*PENDULUMS, BEAM),
            ("pendulum 1, let go", "pendulum 2", "beam"),
            strict=True,
        )
    ]
    handles.append(
        Line2D(
            [],
            [],
            color=FAINT,
            linewidth=7.0,
            label=f"paper: {PAPER_PERIODS:g} periods",
        )
    )
    handles.append(
        Line2D(
            [],
            [],
            color=INK,
            linewidth=0.9,
            linestyle=(0, (4, 2)),
            label=f"paper: {PAPER_MEAN:g}",
        )
    )
    even = f"means even: within {EVEN:g} from here on"
    handles.append(
        Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (1, 1.5)), label=even)
    )
    figure.legend(
        handles=handles,
        loc="outside upper center",
        ncols=3,
        handlelength=1.6,
        columnspacing=1.6,
    )
    return figure


def _draw(axes: Axes, run: Exchange, part: str, color: str, *column: int) -> None:
    """One energy, light, and its mean since the release, bold."""
    energy, mean = (
        getattr(values, part)[(slice(None), *column)]
        for values in (run.energies, run.means)
    )
    axes.plot(run.time, energy, color=color, linewidth=0.6, alpha=0.35, zorder=2)
    axes.plot(run.time, mean, color=color, linewidth=2.0, zorder=3)
