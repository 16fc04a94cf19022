"""The effect of inertial coupling along a trajectory in the plane: the coupled torques
of hips and knees by source (`sources`), and what the motors save.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.optimiser.cycle import Cycle
from bp2_rl.optimiser.solution import Solution
from bp2_rl.optimiser.verify import StrideSummary, summarise
from bp2_rl.paper.figures.drawn import joined
from bp2_rl.paper.trajectories.decomposition import (
    KINDS,
    TERMS,
    Decomposition,
    TermMeans,
    Trends,
    coupling_opposes,
    decompose,
    peak_velocity_force,
)
from bp2_rl.paper.trajectories.sources import (
    LIMBS,
    SAGITTAL_JOINTS,
    Sources,
    TrunkAndLegs,
    split_sources,
)

_show_shares = joined("+.2f")
ENDS = {"fore": True, "hind": False}  # whether their legs are at the front


def _show_within(shares: dict[str, float]) -> str:
    knee, spring, *trunk = shares.values()
    return _show_shares((knee, spring, sum(trunk)))


def _show_through(shares: dict[str, float]) -> str:
    return _show_shares([shares[name] for name in LIMBS])


def split_planar(terms: Decomposition) -> Sources:
    """Split the coupled inertial torques along a gait cycle by source."""
    cycle = terms.cycle
    trunk = {"trunk x": (0,), "trunk z": (1,), "trunk pitch": (2,)}
    robot = TrunkAndLegs(trunk, terms.legs, ("hip", "knee", "spring"), cycle.standing)
    acceleration = cycle.motion.a.reshape(terms.forces.shape[1:])
    return split_sources(robot, terms.mass, acceleration, terms.forces)


def closure(sources: Sources) -> float:
    """Return the largest gap between coupled torque and the sum of its sources, of the
    trunk's part, too, as a share of the largest source."""
    parts = *sources.within.values(), *sources.through.values()
    return float(np.max(sources.gap) / np.max(np.abs(parts)))


def keep_harmonics(
    cycle: Cycle, values: Float[np.ndarray, "... N"], most: int
) -> Float[np.ndarray, "... N"]:
    """Return values along the cycle without the stride's harmonics beyond `most`.

    It is linear, so terms that balance do so still. The impulses of touchdowns are not
    in it.
    """
    turns = np.exp(
        2j * np.pi * np.outer(np.arange(most + 1), cycle.time.ravel() / cycle.period)
    )
    # by the scheme's quadrature
    coefficients = (values * cycle.weights.ravel() / cycle.period) @ turns.conj().T
    twice = np.where(np.arange(most + 1) > 0, 2.0, 1.0)
    return np.real((twice * coefficients) @ turns)


HARMONICS = (2, 4, 8)
"""Numbers of the stride's harmonics to which torques are kept; a toe on its spring, 17
Hz, is the fifth or sixth harmonic."""
PAPER_INSTANT = 0.21  # T, at which the paper has the hip reverse


@dataclasses.dataclass(frozen=True)
class Torque:
    """Peak and RMS torque of a kind of motor over a cycle, u, and on a trunk that is
    not accelerated, u~."""

    name: str = metric("Motors", form="s")
    peak: float = metric("Peak of u", "Nm", ".1f")
    fixed_peak: float = metric("Of ũ", "Nm", ".1f")
    rms: float = metric("RMS of u", "Nm", ".1f")
    fixed_rms: float = metric("RMS of ũ", "Nm", ".1f")
    # by the trunk's acceleration where u~ peaks
    saved: float = metric("Trunk saves", "Nm", ".1f")
    saved_by_limbs: float = metric("Other legs' part", "Nm", ".1f")


@dataclasses.dataclass(frozen=True)
class Cutoff:
    """Greatest main inertial torque of the hips, kept to the first harmonics of the
    stride."""

    harmonics: int
    largest: dict[str, float]  # Nm, by end


@dataclasses.dataclass(frozen=True)
class VelocityForce:
    """Vertical centrifugal and Coriolis force, C_z, over the weight; instants are
    shares of the cycle from a touchdown on."""

    peak: float
    instant: float
    at_three_quarters: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class CouplingAccount:
    """Effects of inertial coupling at one speed. Shares are of the hips' main inertial
    torque, mean over its peaks."""

    speed: float = metric("Speed", "m/s", "g")
    closure: float = metric("Closure", form=".0e")  # as `closure`
    opposing: float = metric("Opposed at", form=".0%")  # of the peaks
    covered: float = metric("Covered")
    # `covered` by source, as `Sources.within`
    within: dict[str, float] = metric("By knee / spring / trunk", form=_show_within)
    # the trunk's part of it by source, as `Sources.through`
    through: dict[str, float] = metric(
        "Own leg / pair / other pair", form=_show_through
    )
    torques: dict[str, Torque]  # by end and joint
    cutoffs: tuple[Cutoff, ...]
    # Nm, of a hip by its angle, by the name of the coordinates
    largest_main: dict[str, float]
    # Nm, terms of a hind hip at `PAPER_INSTANT` after its touchdown
    at_paper_instant: dict[str, float]
    # share of the cycle after a touchdown, at which a hind hip turns from backwards to
    # forwards
    reversal: float = metric("Hip reverses at", "T")
    velocity_force: VelocityForce


def account_coupling(solution: Solution) -> CouplingAccount:
    """Return the effects of inertial coupling in a solution.

    Raises:
        UserError: the robot's shanks are rigid; the sources are those of a leg with a
            spring.
    """
    if not solution.problem.hardware.anatomy.sprung:
        raise UserError(
            f"{solution.problem.hardware.anatomy.name} has rigid shanks: coupling is split for legs whose shanks are springs"
        )
    terms = decompose(solution)
    sources = split_planar(terms)
    cycle = terms.cycle
    coupling = coupling_opposes(terms)
    hind = f"{cycle.hind_leg} hip"
    since = cycle.since_touchdown(cycle.hind_leg)
    order = np.argsort(since)
    angles = cycle.motion.q.reshape(len(since), -1)
    hip_angle = angles[:, terms.coordinates.index(hind)]
    return CouplingAccount(
        speed=cycle.problem.speed,
        closure=closure(sources),
        opposing=coupling.opposing,
        covered=coupling.covered,
        within=sources.covered(sources.within),
        through=sources.covered(sources.through),
        torques={
            f"{end} {joint}": _torque(cycle, sources, f"{end} {joint}")
            for end in ENDS
            for joint in SAGITTAL_JOINTS
        },
        cutoffs=tuple(_cut(terms, most) for most in HARMONICS),
        largest_main={"joints": float(np.max(np.abs(coupling.main), initial=0.0))},
        at_paper_instant={
            term: float(
                np.interp(PAPER_INSTANT, since[order], terms.along(term, hind)[order])
            )
            for term in TERMS
        },
        reversal=float(since[np.argmax(hip_angle)]),  # where the hip is furthest back
        velocity_force=_velocity_force(terms),
    )


def _cut(terms: Decomposition, most: int) -> Cutoff:
    largest = {}
    for end, front in ENDS.items():
        main = terms.along("main inertial", f"{terms.leg_at(front)} hip")
        kept = keep_harmonics(terms.cycle, main, most)
        largest[end] = float(np.max(np.abs(kept)))
    return Cutoff(most, largest)


def _torque(cycle: Cycle, sources: Sources, name: str) -> Torque:
    end, joint = name.split()
    motors = sources.motors(joint, ENDS[end])
    weights = cycle.weights.ravel() / cycle.period
    u, fixed = sources.active[:, motors], sources.fixed[:, motors]
    instant, motor = np.unravel_index(np.argmax(np.abs(fixed)), fixed.shape)
    limbs = sources.through["same pair"] + sources.through["other pair"]
    against = -np.sign(fixed[instant, motor])
    return Torque(
        name,
        peak=float(np.max(np.abs(u))),
        fixed_peak=float(np.max(np.abs(fixed))),
        rms=float(np.sqrt(np.mean(weights @ u**2))),
        fixed_rms=float(np.sqrt(np.mean(weights @ fixed**2))),
        saved=float(against * (u - fixed)[instant, motor]),
        saved_by_limbs=float(against * limbs[:, motors][instant, motor]),
    )


def _velocity_force(terms: Decomposition) -> VelocityForce:
    over_weight = terms.velocity_force
    share = terms.time / terms.cycle.period
    peak = np.argmax(np.abs(over_weight))
    late = float(np.interp(0.75, share, over_weight))
    return VelocityForce(float(over_weight[peak]), float(share[peak]), late)


# --- All numbers of the figures of a family -------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShownStride(StrideSummary):
    """Numbers of the trajectory that the figures show, and of the trends over speed."""

    speed: float  # m/s
    closure: float  # N or Nm, of the equations of motion
    velocity_force: float  # peak of the vertical C over weight
    horizontal_impulse: float  # N s, of the ground over the cycle: 0
    vertical_impulse: float  # of the ground over the cycle, over that of gravity: 1
    # least ratio of the two's vertical means over all speeds, or the inverse of the
    # greatest
    gravity_to_ground: float


@dataclasses.dataclass(frozen=True)
class FigureNumbers:
    """All numbers of the figures of a family of trajectories."""

    shown: ShownStride
    means: tuple[TermMeans, ...]  # by speed
    by_speed: tuple[CouplingAccount, ...]


def number_shown(
    solution: Solution, terms: Decomposition, trends: Trends
) -> ShownStride:
    """Return the numbers of the trajectory that the figures show, and of the trends
    over speed."""
    weights = terms.cycle.weights.ravel()
    ground = TERMS.index("ground reaction")
    x, z = (terms.coordinates.index(name) for name in ("x", "z"))
    pushed = weights @ terms.forces[ground] + np.sum(terms.impulses[ground], axis=0)
    weight = weights @ terms.along("gravity", "z")
    gravity, reaction = (
        trends.average[:, TERMS.index(name), KINDS.index("z")]
        for name in ("gravity", "ground reaction")
    )
    ratio = gravity / reaction
    return ShownStride(
        speed=solution.problem.speed,
        **vars(summarise(solution)),
        closure=terms.closure,
        velocity_force=peak_velocity_force(terms),
        horizontal_impulse=float(pushed[x]),
        vertical_impulse=float(pushed[z] / weight),
        gravity_to_ground=float(np.min(np.minimum(ratio, 1.0 / ratio))),
    )
