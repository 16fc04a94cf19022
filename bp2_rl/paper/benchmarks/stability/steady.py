"""Steady running under noise, stride after stride: sections, spectra and touchdowns."""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.paper.benchmarks.stability.measured import (
    LandingMetrics,
    SectionMetrics,
    ShownStability,
    SignalMetrics,
)
from bp2_rl.paper.orbits.sections import (
    LEAST_POINTS,
    Drift,
    centroid_drift,
    inliers,
    sample,
    whole_cycles,
)
from bp2_rl.paper.orbits.spectrum import Spectrum, spectrum
from bp2_rl.paper.orbits.timing import LEAST_EVENTS, Jitter, jitter
from bp2_rl.robot import conventions
from bp2_rl.simulation.gait import TOUCH_FORCE, contacts, touchdowns
from bp2_rl.simulation.trajectory import Trajectory

PHASE_ZERO, LANDING = "the clock's phase is 0", "RR touches down"
LANDED = conventions.LEGS.index("RR")
SIGNALS = {
    "surge": "even",
    "sway": "odd",
    "heave": "even",
    "roll rate": "odd",
    "pitch rate": "even",
    "yaw rate": "odd",
}
LOOPS = 5  # strides that are drawn all along


@dataclasses.dataclass(frozen=True)
class Steady:
    """A robot that ran, with its clock."""

    run: Trajectory
    clock: Float[np.ndarray, " N"]  # cycles, on and on

    @property
    def angular_velocity(self) -> Float[np.ndarray, "N 3"]:
        """rad/s, in the body's frame."""
        return self.run.qvel[:, 3:6]

    def at_phase_zero(self) -> Float[np.ndarray, "n 3"]:
        """rad/s, each time the clock's phase is 0."""
        return sample(self.angular_velocity, whole_cycles(self.clock))

    def landings(self, leg: int) -> Float[np.ndarray, " n"]:
        """Samples at which a leg touches down, interpolated to where its force passes
        the threshold of `contacts`."""
        force, threshold = (
            self.run.foot_force[:, leg, 2],
            TOUCH_FORCE * self.run.mass * conventions.GRAVITY,
        )
        starts = touchdowns(contacts(self.run)[:, leg])
        before, after = force[starts - 1], force[starts]
        rises = after > before
        share = np.where(
            rises, (threshold - before) / np.where(rises, after - before, 1.0), 1.0
        )
        return starts - 1 + np.clip(share, 0.0, 1.0)

    def at_landing(self) -> Float[np.ndarray, "n 3"]:
        """rad/s, each time RR lands."""
        return sample(self.angular_velocity, self.landings(LANDED))

    def signals(self) -> dict[str, Float[np.ndarray, " N"]]:
        """The trunk's velocities, m/s and rad/s, in the frame of its heading or its
        own."""
        forward, left = self.run.ground_velocity.T
        return dict(
            zip(
                SIGNALS,
                (forward, left, self.run.qvel[:, 2], *self.angular_velocity.T),
                strict=True,
            )
        )

    def spectra(self) -> dict[str, Spectrum]:
        """Return the spectrum of each signal."""
        return {
            name: spectrum(values, self.clock)
            for name, values in self.signals().items()
        }

    def timing(self, leg: int, period: float) -> Jitter | None:
        """Return the jitter of a leg's touchdowns; None where there are too few."""
        at = self.landings(leg)
        if len(at) < LEAST_EVENTS:
            return None
        phases = np.interp(at, np.arange(len(self.clock)), self.clock)
        return jitter(at * self.run.dt, phases, period, self.run.dt)


def measure_sections(
    noisy: list[Steady], quiet: Steady | None
) -> tuple[SectionMetrics, ...]:
    """Return the sections at the clock's phase 0 and at RR's touchdown, of robots that
    did not fall."""
    return tuple(
        section
        for taken, points in (
            (PHASE_ZERO, Steady.at_phase_zero),
            (LANDING, Steady.at_landing),
        )
        if (
            section := _section(
                taken, noisy, [points(one) for one in noisy], quiet and points(quiet)
            )
        )
    )


def _section(
    taken: str,
    noisy: list[Steady],
    sections: list[np.ndarray],
    quiet: np.ndarray | None,
) -> SectionMetrics | None:
    if not sections or min(map(len, sections)) < LEAST_POINTS:
        return None
    drifts = [centroid_drift(points) for points in sections]
    orbits = [
        float(np.sqrt(np.mean(np.sum(one.angular_velocity**2, axis=1))))
        for one in noisy
    ]
    pooled = inliers(
        np.concatenate([points - np.mean(points, axis=0) for points in sections])
    )
    still: Drift | None = (
        centroid_drift(quiet)
        if quiet is not None and len(quiet) >= LEAST_POINTS
        else None
    )
    return SectionMetrics(
        taken=taken,
        strides=min(drift.points for drift in drifts),
        moved=tuple(drift.moved for drift in drifts),
        scatter=tuple(drift.scatter for drift in drifts),
        over_scatter=tuple(drift.over_scatter for drift in drifts),
        floor=max(drift.floor for drift in drifts),
        over_orbit=tuple(
            drift.moved / orbit for drift, orbit in zip(drifts, orbits, strict=True)
        ),
        inliers=pooled.share,
        inlier_error=pooled.error,
        quiet_moved=still and still.moved,
        quiet_scatter=still and still.scatter,
    )


def measure_signals(
    noisy: list[Steady], quiet: Steady | None
) -> tuple[SignalMetrics, ...]:
    """Every signal's spectrum."""
    if not noisy:
        return ()
    spectra = [one.spectra() for one in noisy]
    still = {} if quiet is None else quiet.spectra()
    return tuple(
        SignalMetrics(
            name=name,
            symmetric=wanted,
            peak=float(np.median([each[name].peak for each in spectra])),
            leakage=float(np.mean([each[name].leakage(wanted) for each in spectra])),
            between=float(np.mean([each[name].between for each in spectra])),
            quiet_peak=still[name].peak if still else None,
            quiet_leakage=still[name].leakage(wanted) if still else None,
            quiet_between=still[name].between if still else None,
        )
        for name, wanted in SIGNALS.items()
    )


def measure_landings(
    noisy: list[Steady], quiet: Steady | None, period: float
) -> tuple[LandingMetrics, ...]:
    """Every leg's touchdowns; none of a leg that hardly lands."""
    found = []
    for leg, name in enumerate(conventions.LEGS):
        times = [time for one in noisy if (time := one.timing(leg, period)) is not None]
        if not times:
            continue
        still = quiet and quiet.timing(leg, period)
        found.append(
            LandingMetrics(
                leg=name,
                phase=float(
                    np.angle(
                        np.mean(np.exp(2j * np.pi * np.array([t.phase for t in times])))
                    )
                )
                / 2
                / np.pi
                % 1,
                jitter=float(np.median([t.jitter for t in times])),
                variability=float(np.median([t.variability for t in times])),
                floor=times[0].floor,
                quiet_jitter=still and still.jitter,
                quiet_variability=still and still.variability,
            )
        )
    return tuple(found)


def to_show(noisy: list[Steady], quiet: Steady | None, period: float) -> ShownStability:
    """What the figures need."""
    first, offsets = noisy[0] if noisy else None, []
    for leg in range(len(conventions.LEGS)) if first else ():
        at = first.landings(leg) if first else np.zeros(0)
        phases = (
            np.interp(at, np.arange(len(first.clock)), first.clock) if first else at
        )
        mean = (
            np.angle(np.mean(np.exp(2j * np.pi * phases))) / (2.0 * np.pi)
            if len(at)
            else 0.0
        )
        offsets.append(((phases - mean + 0.5) % 1.0 - 0.5) * period)
    loop = quiet and quiet.angular_velocity[-round(LOOPS * period / quiet.run.dt) :]
    return ShownStability(
        noisy=tuple(one.at_phase_zero() for one in noisy),
        quiet=quiet and quiet.at_phase_zero(),
        loop=loop,
        spectra=first.spectra() if first else {},
        landings=tuple(offsets),
    )
