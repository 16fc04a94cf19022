"""What the stability benchmark measures; definitions are in `bp2_rl.paper.orbits`."""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.orbits.spectrum import Spectrum


@dataclasses.dataclass(frozen=True)
class SectionMetrics:
    """A section of the trunk's angular velocity (roll, pitch, yaw rates), a point a
    stride."""

    taken: str  # when
    strides: int  # a robot
    # rad/s, of the centre from the first third to the last, each robot's
    moved: tuple[float, ...]
    # rad/s, each robot's root mean square distance from its centre
    scatter: tuple[float, ...]
    over_scatter: tuple[float, ...]  # D_c*, each robot's
    floor: float  # of that for independent points
    # moved over the root mean square of the angular velocity throughout the stride
    over_orbit: tuple[float, ...]
    inliers: float  # share, all robots' points about their own centres
    inlier_error: float  # of a Gaussian's share, one standard deviation
    quiet_moved: float | None  # rad/s, of the robot without noise; None if it fell
    quiet_scatter: float | None  # rad/s, without noise


@dataclasses.dataclass(frozen=True)
class SignalMetrics:
    """The spectrum of one of the trunk's velocities; means over robots."""

    name: str
    # harmonics that a gait has whose left and right are alike: `even` or `odd`
    symmetric: str
    peak: float  # strongest frequency over the stride's
    leakage: float  # share of the harmonics' power at the others
    between: float  # share of the variance that is at no harmonic
    quiet_peak: float | None  # the robot without noise
    quiet_leakage: float | None
    quiet_between: float | None


@dataclasses.dataclass(frozen=True)
class LandingMetrics:
    """How a leg's touchdowns keep time; medians over robots."""

    leg: str
    phase: float  # cycles of the clock
    jitter: float  # s
    variability: float  # CV_f
    floor: float  # of that, by sampling alone
    quiet_jitter: float | None  # s, the robot without noise
    quiet_variability: float | None


@dataclasses.dataclass(frozen=True)
class RadiusMetrics:
    """The largest multiplier of a map from stride to stride, fitted by least
    squares."""

    what: str
    states: int
    radius: float
    low: float  # 95 % of the bootstrap's draws
    high: float
    unexplained: float  # share of the variance that no linear map explains


@dataclasses.dataclass(frozen=True)
class MapMetrics:
    """The return map."""

    coordinates: int
    under_noise: RadiusMetrics  # stride to stride of the robots with noise
    deviations: tuple[RadiusMetrics, ...]  # of random deviations, by their size
    unsteered: RadiusMetrics | None  # of the largest deviations, without an operator
    # of deviations that are followed, over each coordinate's scatter under noise
    sizes: tuple[float, ...]
    # median distance over the initial one, by size, then stride
    growth: tuple[tuple[float, ...], ...]
    widths: tuple[float, ...]  # of differences, over the scatter
    # of the slope from each width to the next, median over directions
    changes: tuple[float | None, ...]
    width: float | None  # from which slopes change least
    by_differences: float | None  # radius by central differences of that width


@dataclasses.dataclass(frozen=True)
class PushMetrics:
    """The largest push survived, a jump of the whole robot's velocity."""

    phase: float  # cycles of the clock
    direction: float  # rad, from forward to the left
    survived: float  # m/s
    fatal: float  # m/s


@dataclasses.dataclass(frozen=True)
class SpeedMetrics:
    """One speed."""

    asked: float  # m/s
    # m/s, the nearest with a stride of a whole number of control steps
    commanded: float
    ticks: int  # control steps a stride
    period: float  # s
    speed: float | None  # m/s, made good in the mean; None if all fell
    robots: int  # with noise
    fell: int  # of these
    sections: tuple[SectionMetrics, ...]
    signals: tuple[SignalMetrics, ...]
    landings: tuple[LandingMetrics, ...]
    returns: MapMetrics | None
    pushes: tuple[PushMetrics, ...]

    @property
    def weakest_push(self) -> float | None:
        """m/s, the largest push that is survived whatever its phase and direction."""
        return min((push.survived for push in self.pushes), default=None)


@dataclasses.dataclass(frozen=True)
class StabilityMetrics:
    """All of it."""

    mass: float  # kg: a push of 1 m/s is an impulse of so many N s
    speeds: tuple[SpeedMetrics, ...]


@dataclasses.dataclass(frozen=True)
class ShownStability:
    """What the figures need of a speed beyond its metrics."""

    # rad/s, points where the clock's phase is 0, a robot each
    noisy: tuple[Float[np.ndarray, "n 3"], ...]
    quiet: Float[np.ndarray, "n 3"] | None
    # rad/s, the robot without noise all along a few strides
    loop: Float[np.ndarray, "m 3"] | None
    spectra: dict[str, Spectrum]  # of a robot with noise
    # s, touchdowns against their mean, by leg, of a robot with noise
    landings: tuple[Float[np.ndarray, " n"], ...]


@dataclasses.dataclass(frozen=True)
class SpeedResult:
    """One speed, measured and to be shown."""

    metrics: SpeedMetrics
    shown: ShownStability
