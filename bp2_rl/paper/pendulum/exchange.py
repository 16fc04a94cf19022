"""How two pendulums share a swing: one is let go, the other hangs (paper, Fig. model_analysis C)."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import cumulative_simpson

from bp2_rl.paper.pendulum import beam, exact
from bp2_rl.paper.pendulum.swing import NATURAL_PERIOD, SwingMotion, swing

SAMPLES = 100  # of a natural period
EVEN = 0.05  # of m g l: means that differ by less are called even


@dataclasses.dataclass(frozen=True)
class Sharing:
    """What came of one mass ratio. Energies in m g l, times in T0."""

    mass_ratio: float
    energy: float  # of the release
    mean: tuple[float, float]  # of each pendulum since the release, as seen from the ground
    mean_beam: float
    mean_in_beam_frame: tuple[float, float]
    even_after: float | None  # from when on the means differ by less than EVEN; None if they never do
    beat: float  # T_b of small swings
    small_swing_shares: tuple[float, float]  # of the energy, each pendulum's and the beam's, of small swings
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
        return {f"{kind}_{part}": getattr(values, part) for kind, values in kinds.items() for part in parts}


def exchanges(amplitude: float, mass_ratios: Sequence[float], periods: float) -> list[Exchange]:
    """Let one pendulum go at `amplitude` and watch both for so many natural periods, for each mass ratio."""
    time = np.linspace(0.0, periods * NATURAL_PERIOD, round(periods * SAMPLES) + 1)
    motion = swing(np.tile((amplitude, 0.0), (len(mass_ratios), 1)), np.array(mass_ratios), time)
    return [_exchange(motion, system) for system in range(len(mass_ratios))]


def _exchange(motion: SwingMotion, system: int) -> Exchange:
    """Return the exchange of energy in one of several systems."""
    time, mass_ratio = motion.time, motion.mass_ratio[system]
    state = motion.theta[:, system], motion.rate[:, system], motion.beam_rate[:, system], mass_ratio[None]
    energies, momentum = beam.energies(*state), beam.momentum(*state)
    parts = (getattr(energies, field.name) for field in dataclasses.fields(energies))
    means = beam.Energies(*(_running_mean(time, part) for part in parts))
    kept = energies.pendulums.sum(axis=-1) + energies.beam
    uneven = np.flatnonzero(np.abs(means.pendulums[:, 0] - means.pendulums[:, 1]) >= EVEN)
    last = int(uneven[-1]) if len(uneven) else 0
    sharing = Sharing(
        mass_ratio=float(mass_ratio),
        energy=float(kept[0]),
        mean=_pair(means.pendulums[-1]),
        mean_beam=float(means.beam[-1]),
        mean_in_beam_frame=_pair(means.beam_frame[-1]),
        even_after=None if last == len(time) - 1 else float(time[last] / NATURAL_PERIOD),
        beat=exact.beat_period(float(mass_ratio)),
        small_swing_shares=exact.shares(float(mass_ratio)),
        energy_drift=float(np.max(np.abs(kept - kept[0]))),
        momentum_drift=float(np.max(np.abs(momentum))),
    )
    return Exchange(sharing, time / NATURAL_PERIOD, energies, means)


def _running_mean(time: Float[np.ndarray, " samples"], values: Any) -> Any:
    """From the release to each time; at the release the value itself."""
    so_far = time[1:].reshape(-1, *(1,) * (values.ndim - 1))
    return np.concatenate((values[:1], cumulative_simpson(values, x=time, axis=0) / so_far))


def _pair(values: Float[np.ndarray, " 2"]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
