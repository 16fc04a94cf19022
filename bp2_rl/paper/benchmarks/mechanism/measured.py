"""What the mechanism benchmark measures of a run's forces."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from bp2_rl.paper.benchmarks.mechanism.forces import (
    JOINTS,
    TERMS,
    THROUGH,
    TRUNK,
    WITHIN,
    Forces,
)
from bp2_rl.paper.trajectories.coupling import ENDS
from bp2_rl.paper.trajectories.coupling_account import HARMONICS
from bp2_rl.paper.trajectories.decomposition import force_ratio, named, periodic_peaks
from bp2_rl.robot.conventions import LEGS

STRIDES = 8  # whole ones that are looked at, at most
HIPS = tuple(JOINTS.index(f"{leg} hip") for leg in LEGS)


@dataclasses.dataclass(frozen=True)
class Cut:
    """The hips' inertial torques kept to the first harmonics of the stride."""

    harmonics: int | None  # None: all
    largest: float  # Nm, of the main one
    # share of its peaks at which the coupled one has the other sign; None: no peaks
    opposing: float | None
    # share of it that the coupled one makes up for, mean over the peaks
    covered: float | None
    variance_above: float  # share of the main one's variance that is beyond


@dataclasses.dataclass(frozen=True)
class Motor:
    """What reaches a kind of joint of its motors' torque, and would have to on a trunk
    that is not accelerated."""

    peak: float  # Nm, of u
    fixed_peak: float  # Nm, of u~
    rms: float  # Nm, of u
    fixed_rms: float  # Nm, of u~


@dataclasses.dataclass(frozen=True)
class Decomposed:
    """A run's forces over whole strides; shares are of the hips' main inertial torque,
    mean over its peaks."""

    strides: int
    frequency: float  # Hz, of the stride
    closure: float  # largest gap in any ms over the largest term: see `Forces.closure`
    peaks: int  # of the hips' main torque
    covered: float
    within: dict[str, float]  # `covered` by source, as in `WITHIN`
    through: dict[str, float]  # the trunk's part of it by source, as in `THROUGH`
    cuts: tuple[Cut, ...]  # by harmonics, the last of all
    motors: dict[str, Motor]  # by end and joint
    # N, Nm: mean magnitudes by kind and term (paper, Eq. average force)
    average: dict[str, dict[str, float]]
    share: dict[str, dict[str, float]]  # of their sum (paper, Eq. force ratio)
    # over weight, greatest vertical C of the first eight harmonics
    velocity_force: float

    @property
    def legs(self) -> float:
        """What other legs cover through the trunk."""
        return self.through["same pair"] + self.through["other pair"]

    @property
    def own(self) -> float:
        """What the leg's own other joints and spring cover."""
        return sum(self.within[name] for name in WITHIN[:3])


@dataclasses.dataclass(frozen=True)
class MechanismAtSpeed:
    """One command."""

    commanded_speed: float  # m/s
    speed: float  # m/s, over the strides, or the mean of a run that has none
    fell_at: float | None  # s
    forces: Decomposed | None  # None of a run that fell or made no two strides


class MechanismRun(NamedTuple):
    """One command, and a stride of it for the figures."""

    at: MechanismAtSpeed
    # terms of the vertical, and of a hip and a knee of `LEG`
    stride: Float[np.ndarray, "T N 3"] | None


@dataclasses.dataclass(frozen=True)
class OptimisedMechanism:
    """The shipped library at the speed nearest to a run's."""

    speed: float  # m/s
    covered: float
    joint: float  # of it, by the leg's own other joint
    spring: float  # by its spring
    legs: float  # by other legs, through the trunk
    trunk: float  # through the trunk, by whatever
    peak: float  # Nm, of u, of any hip
    fixed_peak: float  # Nm, of u~

    @property
    def own(self) -> float:
        """What the leg itself covers."""
        return self.joint + self.spring


@dataclasses.dataclass(frozen=True)
class MechanismMetrics:
    """All of it."""

    speeds: tuple[MechanismAtSpeed, ...]
    # one a speed that was run; empty without CasADi
    optimiser: tuple[OptimisedMechanism, ...]

    @property
    def decomposed(self) -> tuple[tuple[MechanismAtSpeed, Decomposed], ...]:
        """The speeds that were run through."""
        return tuple((at, at.forces) for at in self.speeds if at.forces is not None)


def measure_forces(forces: Forces, strides: int, dt: float) -> Decomposed:
    """The numbers of so many whole strides; dt in s."""
    main, coupled = forces.joints("main inertial"), forces.joints("coupled inertial")
    average = _by_kind(forces)
    share = force_ratio(average)
    velocities = (
        forces.terms[TERMS.index("centrifugal"), :, 2]
        + forces.terms[TERMS.index("Coriolis"), :, 2]
    )
    weight = np.mean(forces.terms[TERMS.index("gravity"), :, 2])
    within = _covered(main, forces.within)
    everything = Cut(
        None, float(np.max(np.abs(main[:, HIPS]))), *_at_peaks(main, coupled), 0.0
    )
    return Decomposed(
        strides=strides,
        frequency=strides / (len(main) * dt),
        closure=float(np.max(forces.closure)),
        peaks=sum(len(periodic_peaks(np.abs(main[:, hip]))) for hip in HIPS),
        covered=float(np.sum(within)),
        within=dict(zip(WITHIN, within, strict=True)),
        through=dict(zip(THROUGH, _covered(main, forces.through), strict=True)),
        cuts=(*(_cut(main, coupled, strides, most) for most in HARMONICS), everything),
        motors={
            f"{end} {joint}": _motor(forces, joint, front)
            for end, front in ENDS.items()
            for joint in ("hip", "knee")
        },
        average=named(TERMS, average),
        share=named(TERMS, share),
        velocity_force=float(
            np.max(np.abs(keep_harmonics(velocities[:, None], strides, HARMONICS[-1])))
            / weight
        ),
    )


def keep_harmonics(
    values: Float[np.ndarray, "N K"], strides: int, most: int
) -> Float[np.ndarray, "N K"]:
    """Values over whole strides without what is faster than `most` times the stride."""
    coefficients: Complex[np.ndarray, "F K"] = np.fft.rfft(values, axis=0)
    coefficients[round((most + 0.5) * strides) + 1 :] = 0.0
    return np.fft.irfft(coefficients, n=len(values), axis=0)


def _cut(
    main: Float[np.ndarray, "N 8"],
    coupled: Float[np.ndarray, "N 8"],
    strides: int,
    most: int,
) -> Cut:
    slow, other = (keep_harmonics(values, strides, most) for values in (main, coupled))
    hips = list(HIPS)
    beyond = 1.0 - np.sum(np.var(slow[:, hips], axis=0)) / np.sum(
        np.var(main[:, hips], axis=0)
    )
    return Cut(
        most,
        float(np.max(np.abs(slow[:, hips]))),
        *_at_peaks(slow, other),
        float(beyond),
    )


def _at_peaks(
    main: Float[np.ndarray, "N 8"], coupled: Float[np.ndarray, "N 8"]
) -> tuple[float | None, float | None]:
    """At how many of the hips' peaks the coupled torque opposes the main one, and how
    much of it it covers."""
    shares = np.concatenate(
        [
            -coupled[peaks, hip] / main[peaks, hip]
            for hip in HIPS
            for peaks in [periodic_peaks(np.abs(main[:, hip]))]
        ]
    )
    return (
        (float(np.mean(shares > 0.0)), float(np.mean(shares)))
        if len(shares)
        else (None, None)
    )


def _covered(
    main: Float[np.ndarray, "N 8"], parts: Float[np.ndarray, "K N 8"]
) -> list[float]:
    """Share of the hips' main torque that each part makes up for, mean over its
    peaks."""
    shares = [
        -parts[:, peaks, hip] / main[peaks, hip]
        for hip in HIPS
        for peaks in [periodic_peaks(np.abs(main[:, hip]))]
    ]
    return [float(share) for share in np.mean(np.concatenate(shares, axis=1), axis=1)]


def _motor(forces: Forces, joint: str, front: bool) -> Motor:
    columns = [
        i
        for i, name in enumerate(JOINTS)
        if name.endswith(joint) and name.startswith("F") == front
    ]
    u, fixed = forces.active[:, columns], forces.fixed[:, columns]
    peaks = [float(np.max(np.abs(torque))) for torque in (u, fixed)]
    return Motor(*peaks, *(float(np.sqrt(np.mean(torque**2))) for torque in (u, fixed)))


def _by_kind(forces: Forces) -> Float[np.ndarray, "T kinds"]:
    """Mean magnitudes of the trunk's x and z, and of hips and knees, mean over the
    legs."""
    mean = np.mean(np.abs(forces.terms), axis=1)
    trunk = mean[:, TRUNK]
    joints = [[6 + 4 * leg + joint for leg in range(4)] for joint in (1, 2)]
    return np.stack(
        [
            trunk[:, 0],
            trunk[:, 2],
            *(np.mean(mean[:, each], axis=1) for each in joints),
        ],
        axis=1,
    )
