"""Whose inertia covers the hips' main torque along a run, in numbers."""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.paper.benchmarks.mechanism.forces import JOINTS, THROUGH, WITHIN, Forces
from bp2_rl.paper.benchmarks.speeds import AtSpeed
from bp2_rl.paper.trajectories.coupling import ENDS
from bp2_rl.paper.trajectories.decomposition import periodic_peaks
from bp2_rl.robot.conventions import LEGS

STRIDES = 8  # whole ones that are looked at, at most
MOVED = "hip", "knee"
HIPS = tuple(JOINTS.index(f"{leg} hip") for leg in LEGS)


@dataclasses.dataclass(frozen=True)
class Motor:
    """Torques at a kind of joint: u, of the motors, and ũ, which a trunk that is not
    accelerated would take."""

    name: str = metric("Joint", form="s")
    peak: float = metric("u peak", "Nm", ".1f")
    fixed_peak: float = metric("ũ peak", "Nm", ".1f")
    rms: float = metric("u rms", "Nm", ".1f")
    fixed_rms: float = metric("ũ rms", "Nm", ".1f")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decomposed:
    """A run's forces over whole strides; shares are of the hips' main inertial torque,
    mean over its peaks."""

    strides: int
    frequency: float  # Hz, of the stride
    closure: float = metric("Closure", form=".0e", meaning="gap / largest term, any ms")
    peaks: int  # of the hips' main torque
    covered: float = metric(
        "Covered",
        form=".0%",
        meaning="of the hips' main torque at its peaks",
        card=True,
    )
    own: float = metric(
        "By the leg itself",
        form=".0%",
        meaning="own knee, spring, abduction",
        card="covered_by_own_leg",
    )
    legs: float = metric(
        "By other legs",
        form="+.1%",
        meaning="through the trunk",
        card="covered_by_other_legs",
    )
    within: dict[str, float]  # `covered` by source, as in `WITHIN`
    through: dict[str, float]  # the trunk's part of it by source, as in `THROUGH`
    saved_at_hips: float = metric(
        "Trunk saves, hips",
        form="+.0%",
        meaning="of ũ's peak",
        card="trunk_saves_of_hip_peak",
    )
    saved_at_knees: float = metric(
        "Trunk saves, knees", form="+.0%", meaning="of ũ's peak"
    )
    motors: dict[str, Motor]  # by end and joint


@dataclasses.dataclass(frozen=True)
class MechanismAtSpeed(AtSpeed):
    """The forces of a run under one command."""

    forces: Decomposed | None  # None of a run that fell or made no two strides


@dataclasses.dataclass(frozen=True)
class MechanismMetrics:
    """The forces of the runs under all commands."""

    speeds: tuple[MechanismAtSpeed, ...]

    @property
    def found(self) -> tuple[tuple[MechanismAtSpeed, Decomposed], ...]:
        """The speeds that were run through."""
        return tuple((at, at.forces) for at in self.speeds if at.forces is not None)


def measure_forces(forces: Forces, strides: int, dt: float) -> Decomposed:
    """Measure the forces of whole strides, sampled each `dt` s."""
    main = forces.joints("main inertial")
    peaks = [(periodic_peaks(np.abs(main[:, hip])), hip) for hip in HIPS]

    def cover(parts: Float[np.ndarray, "K N 8"]) -> list[float]:
        """Return the share of the hips' main torque that each part makes up for."""
        shares = [-parts[:, at, hip] / main[at, hip] for at, hip in peaks]
        return np.mean(np.concatenate(shares, axis=1), axis=1).tolist()

    within, through = cover(forces.within), cover(forces.through)
    kinds = [(f"{end} {j}", j, front) for end, front in ENDS.items() for j in MOVED]
    motors = {name: _motor(forces, name, joint, front) for name, joint, front in kinds}
    return Decomposed(
        strides=strides,
        frequency=strides / (len(main) * dt),
        closure=float(np.max(forces.closure)),
        peaks=sum(len(at) for at, _ in peaks),
        covered=float(np.sum(within)),
        own=sum(within[:3]),
        legs=sum(through[1:3]),
        within=dict(zip(WITHIN, within, strict=True)),
        through=dict(zip(THROUGH, through, strict=True)),
        saved_at_hips=_saved(motors, "hip"),
        saved_at_knees=_saved(motors, "knee"),
        motors=motors,
    )


def _motor(forces: Forces, name: str, joint: str, front: bool) -> Motor:
    columns = [
        i
        for i, each in enumerate(JOINTS)
        if each.endswith(joint) and each.startswith("F") == front
    ]
    u, fixed = forces.active[:, columns], forces.fixed[:, columns]
    peak, fixed_peak = (float(np.max(np.abs(torque))) for torque in (u, fixed))
    rms, fixed_rms = (float(np.sqrt(np.mean(torque**2))) for torque in (u, fixed))
    return Motor(name, peak, fixed_peak, rms, fixed_rms)


def _saved(motors: dict[str, Motor], joint: str) -> float:
    """Return the share of the greatest ũ that the trunk's acceleration saves."""
    chosen = [motor for name, motor in motors.items() if name.endswith(joint)]
    fixed = max(motor.fixed_peak for motor in chosen)
    return 1.0 - max(motor.peak for motor in chosen) / fixed if fixed > 0.0 else 0.0
