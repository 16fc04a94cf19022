"""Metrics of stability, and their measurement in steady running under noise.

Definitions are in `bp2_rl.paper.orbits` and docs/notes/stability.md.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.paper.orbits.sections import (
    LEAST_EVENTS,
    LEAST_POINTS,
    Jitter,
    centroid_drift,
    inliers,
    jitter,
    sample,
    whole_cycles,
)
from bp2_rl.robot import conventions
from bp2_rl.simulation.gait import TOUCH_FORCE, contacts, touchdowns
from bp2_rl.simulation.trajectory import Trajectory

LOOPS = 5  # strides that are drawn all along


@dataclasses.dataclass(frozen=True)
class SectionMetrics:
    """Drift and scatter of the trunk's angular velocity, sampled at the gait clock's
    phase 0."""

    strides: int  # a robot
    # rad/s, of the centre from the first third to the last, each robot's
    moved: tuple[float, ...]
    # rad/s, each robot's root mean square distance from its centre
    scatter: tuple[float, ...]
    over_scatter: tuple[float, ...]  # D_c*, each robot's
    floor: float  # of D_c* for independent points
    inliers: float  # share, all robots' points about their own centres
    inlier_error: float  # of a Gaussian's share, one standard deviation


@dataclasses.dataclass(frozen=True)
class LandingMetrics:
    """Timing of a leg's touchdowns against the gait clock, as medians over robots."""

    leg: str = metric("Leg", form="s")
    phase: float = metric("Phase", form=".3f")  # cycles of the clock
    jitter: float = metric("Jitter", "ms")
    variability: float = metric("CV_f", form=".4f")
    floor: float = metric("Sampling alone", form=".4f")  # of CV_f


@dataclasses.dataclass(frozen=True)
class RadiusMetrics:
    """Spectral radius of a linear return map from stride to stride, with its
    interval."""

    what: str = metric("Fitted to", form="s")
    states: int = metric("States", form="d")
    radius: float = metric("Radius", form=".3f")
    low: float = metric("95 %, from", form=".3f")  # by bootstrap
    high: float = metric("to", form=".3f")
    # share of the variance that no linear map explains
    unexplained: float = metric("Not explained", form=".1%")

    def __str__(self) -> str:
        """Return the spectral radius with its interval, as text."""
        return f"{self.radius:.2f} ({self.low:.2f} to {self.high:.2f})"


@dataclasses.dataclass(frozen=True)
class PushMetrics:
    """Largest push survived at one phase, in one direction: a jump of the robot's
    velocity."""

    phase: float = metric("Phase of the clock")  # cycles
    direction: float = metric("Direction", "deg", ".0f")  # from forward to the left
    survived: float = metric("Survived", "m/s")
    fatal: float = metric("Fatal", "m/s")


def _show_interval(interval: tuple[float, float] | None) -> str:
    return "-" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpeedMetrics:
    """Stability metrics of running at one speed; None where not measured."""

    asked: float  # m/s
    # the nearest with a stride of a whole number of control steps
    commanded: float = metric(
        "Commanded speed", "m/s", meaning="a stride of {m.ticks} control steps"
    )
    ticks: int  # control steps a stride
    period: float  # s
    speed: float | None = metric("Mean speed", "m/s", meaning="made good")
    robots: int = metric("Robots", form="d", meaning="with noise", card=True)
    fell: int = metric("Fell", form="d", meaning="of these", card=True)
    strides: int | None = metric(
        "Strides", form="d", meaning="a robot, transient dropped", card=True
    )
    drift_over_scatter: float | None = metric(
        "D_c*", form=".3f", meaning="median; paper: 0.071, undefined", card=True
    )
    floor: float | None = metric(
        "... by chance", form=".3f", meaning="D_c* of independent strides", card=True
    )
    drift: float | None = metric(
        "Drift", "rad/s", ".3f", "D_c*, not divided by the scatter", card=True
    )
    scatter: float | None = metric("Scatter", "rad/s", ".3f", "about the mean, RMS")
    inliers: float | None = metric(
        "Inliers", form=".1%", meaning="any Gaussian has 95 %", card=True
    )
    radius_under_noise: float | None = metric(
        "Radius under noise", form=".3f", meaning="from stride to stride", card=True
    )
    radius_interval: tuple[float, float] | None = metric(
        "... interval", form=_show_interval, meaning="95 %, by bootstrap", card=True
    )
    touchdown_jitter: float | None = metric(
        "Touchdown jitter", "ms", meaning="worst leg, against the clock", card=True
    )
    variability: float | None = metric(
        "CV_f", form=".4f", meaning="worst leg; paper: 0.006, of any clock"
    )
    weakest_push: float | None = metric(
        "Weakest push", "m/s", meaning="survived at any phase and angle", card=True
    )
    sections: tuple[SectionMetrics, ...]
    landings: tuple[LandingMetrics, ...]
    # stride to stride under noise, then of deviations as large as the scatter
    radii: tuple[RadiusMetrics, ...]
    pushes: tuple[PushMetrics, ...]

    @property
    def is_steady(self) -> bool:
        """True if no robot fell and the return map under noise, where fitted,
        contracts."""
        certain = self.radius_interval is None or self.radius_interval[1] < 1.0
        return self.fell == 0 and certain


@dataclasses.dataclass(frozen=True)
class StabilityMetrics:
    """Stability metrics of running at all tested speeds."""

    mass: float  # kg: of a push of 1 m/s, the impulse in N s
    speeds: tuple[SpeedMetrics, ...]


@dataclasses.dataclass(frozen=True)
class SpeedResult:
    """Stability metrics at one speed, and the trunk's angular velocities that the
    figure of sections shows, rad/s."""

    metrics: SpeedMetrics
    noisy: tuple[Float[np.ndarray, "n 3"], ...]  # a robot each
    quiet: Float[np.ndarray, "n 3"] | None
    # the robot without noise all along a few strides
    loop: Float[np.ndarray, "m 3"] | None


@dataclasses.dataclass(frozen=True)
class Steady:
    """A robot's steady running: its trajectory, and its gait clock's phase."""

    run: Trajectory
    clock: Float[np.ndarray, " N"]  # cycles, on and on

    @property
    def angular_velocity(self) -> Float[np.ndarray, "N 3"]:
        """Angular velocity of the trunk in its own frame, rad/s."""
        return self.run.qvel[:, 3:6]

    def at_phase_zero(self) -> Float[np.ndarray, "n 3"]:
        """Return the trunk's angular velocity each time the gait clock's phase is 0,
        rad/s."""
        return sample(self.angular_velocity, whole_cycles(self.clock))

    def landings(self, leg: int) -> Float[np.ndarray, " n"]:
        """Return the instants of a leg's touchdowns, in samples, interpolated between
        samples.

        There its force passes the threshold of `contacts`.
        """
        force = self.run.foot_force[:, leg, 2]
        threshold = TOUCH_FORCE * self.run.mass * conventions.GRAVITY
        starts = touchdowns(contacts(self.run)[:, leg])
        before, after = force[starts - 1], force[starts]
        steps = np.where(after > before, after - before, 1.0)
        share = np.where(after > before, (threshold - before) / steps, 1.0)
        return starts - 1 + np.clip(share, 0.0, 1.0)

    def timing(self, leg: int, period: float) -> Jitter | None:
        """Return the jitter of a leg's touchdowns; None with too few touchdowns."""
        at = self.landings(leg)
        if len(at) < LEAST_EVENTS:
            return None
        phases = np.interp(at, np.arange(len(self.clock)), self.clock)
        return jitter(at * self.run.dt, phases, period, self.run.dt)


def measure_section(noisy: Sequence[Steady]) -> SectionMetrics | None:
    """Return drift and scatter of the sections of robots that did not fall; None with
    too few strides."""
    sections = [one.at_phase_zero() for one in noisy]
    if not sections or min(map(len, sections)) < LEAST_POINTS:
        return None
    drifts = [centroid_drift(points) for points in sections]
    own = [points - np.mean(points, axis=0) for points in sections]
    pooled = inliers(np.concatenate(own))
    return SectionMetrics(
        strides=min(drift.points for drift in drifts),
        moved=tuple(drift.moved for drift in drifts),
        scatter=tuple(drift.scatter for drift in drifts),
        over_scatter=tuple(drift.over_scatter for drift in drifts),
        floor=max(drift.floor for drift in drifts),
        inliers=pooled.share,
        inlier_error=pooled.error,
    )


def measure_landings(
    noisy: Sequence[Steady], period: float
) -> tuple[LandingMetrics, ...]:
    """Return the touchdown timing of every leg that lands often enough to be
    measured."""
    found = []
    for leg, name in enumerate(conventions.LEGS):
        times = [time for one in noisy if (time := one.timing(leg, period)) is not None]
        if not times:
            continue
        turns = np.exp(2j * np.pi * np.array([time.phase for time in times]))
        found.append(
            LandingMetrics(
                leg=name,
                phase=float(np.angle(np.mean(turns))) / (2.0 * np.pi) % 1.0,
                jitter=float(np.median([time.jitter for time in times])),
                variability=float(np.median([time.variability for time in times])),
                floor=times[0].floor,
            )
        )
    return tuple(found)


def with_sections(
    metrics: SpeedMetrics, noisy: Sequence[Steady], quiet: Steady | None
) -> SpeedResult:
    """Return the metrics with the angular velocities at the gait clock's phase 0."""
    return SpeedResult(
        metrics,
        noisy=tuple(one.at_phase_zero() for one in noisy),
        quiet=quiet and quiet.at_phase_zero(),
        loop=quiet
        and quiet.angular_velocity[-round(LOOPS * metrics.period / quiet.run.dt) :],
    )
