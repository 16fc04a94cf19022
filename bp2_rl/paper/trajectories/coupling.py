"""Sources of a joint's coupled inertial torque, and how much of the motors' torque
coupling through the trunk saves.

In the coordinates of `sagittal` the mass matrix has no entry between two legs. So of
what the paper calls coupled, at joint i of a leg,

    sum_{j != i} M_ij a_j = M_i,other a_other + M_i,spring a_spring + M_i,t a_t ,

the leg's other joint and its spring are the leg's own, and other limbs act through the
acceleration a_t of the trunk (x, z, pitch) alone. The trunk's rows of the equations of
motion say where that comes from,

    a_t = M_tt^-1 (sum_k (J_t^T F - M_t,k a_k) - G_t - C_t + tau_p,t) ,

so that M_i,t a_t has a part of every leg k's acceleration, of the ground, of gravity,
of velocities and of the air.

What coupling through the trunk saves is said without coordinates of the legs: the
torque of the same joint motion under the same ground forces on a trunk that is not
accelerated is u~ = u - M_i,t a_t, as the paper's u~ is that of pendulums on a beam that
stands still (Eq. active torque).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.optimiser.cycle import Cycle
from bp2_rl.optimiser.problem import TRUNK, motor_coordinates
from bp2_rl.optimiser.solution import Solution
from bp2_rl.optimiser.verify import StrideSummary, summarise
from bp2_rl.paper.figures.drawn import joined
from bp2_rl.paper.trajectories.decomposition import (
    KINDS,
    TERMS,
    THROUGH,
    Decomposition,
    TermMeans,
    Trends,
    comparable,
    coupling_opposes,
    decompose,
    evaluate,
    peak_velocity_force,
    periodic_peaks,
)

# of a hip the other joint is the knee
WITHIN = ("other joint", "spring", "trunk x", "trunk z", "trunk pitch")
_show_shares = joined("+.2f")
ENDS = {"fore": True, "hind": False}  # whether their legs are at the front


def _show_within(shares: dict[str, float]) -> str:
    knee, spring, *trunk = shares.values()
    return _show_shares((knee, spring, sum(trunk)))


def _show_through(shares: dict[str, float]) -> str:
    return _show_shares([shares[name] for name in THROUGH[:3]])


@dataclasses.dataclass(frozen=True)
class Sources:
    """The coupled inertial torque of every motor's joint by source. N instants, hip and
    knee of each leg in turn."""

    decomposition: Decomposition
    within: Float[np.ndarray, "5 N motors"]  # Nm: M_ij a_j, as in `WITHIN`
    through: Float[np.ndarray, "7 N motors"]  # Nm: parts of M_i,t a_t, as in `THROUGH`

    @property
    def trunk(self) -> Float[np.ndarray, "N motors"]:
        """Inertial torque of the trunk's acceleration at each hip and knee, M_i,t a_t,
        Nm."""
        return np.sum(self.within[2:], axis=0)

    @property
    def active(self) -> Float[np.ndarray, "N motors"]:
        """Motor torque at each hip and knee, u, Nm."""
        return self._of_motors("active")

    @property
    def fixed(self) -> Float[np.ndarray, "N motors"]:
        """Motor torque at each hip and knee on a trunk that is not accelerated, u~,
        Nm."""
        return self.active - self.trunk

    @property
    def closure(self) -> float:
        """The largest gap between coupled torque and the sum of its sources, of the
        trunk's part, too, as a share of the largest source."""
        gap = max(
            np.max(
                np.abs(
                    np.sum(self.within, axis=0) - self._of_motors("coupled inertial")
                )
            ),
            np.max(np.abs(np.sum(self.through, axis=0) - self.trunk)),
        )
        return float(
            gap / max(np.max(np.abs(self.within)), np.max(np.abs(self.through)))
        )

    def motors(self, joint: str, front: bool | None = None) -> list[int]:
        """Return the indices of all hip or all knee motors, of all legs or the front or
        hind legs."""
        legs = self.decomposition.legs
        return [
            2 * i + ("hip", "knee").index(joint)
            for i, leg in enumerate(legs)
            if front is None or leg.startswith("F") == front
        ]

    def _of_motors(self, term: str) -> Float[np.ndarray, "N motors"]:
        return self.decomposition.forces[TERMS.index(term)][
            :, motor_coordinates(self.decomposition.legs)
        ]


def split_sources(solution: Solution) -> Sources:
    """Split the coupled inertial torques of hips and knees by source, at every mesh
    point of a whole gait cycle.

    Raises:
        UserError: CasADi is not installed.
    """
    from bp2_rl.optimiser import sagittal  # here alone, as in `decompose`

    terms = decompose(solution)
    problem, motion, legs = terms.cycle.problem, terms.cycle.motion, terms.legs
    q, a = (x.reshape(-1, x.shape[-1]) for x in (motion.q, motion.a))
    M = evaluate(
        sagittal.model_of(problem).mass, q, sagittal.design_vector(problem.hardware)
    )

    joints = motor_coordinates(legs)
    partners = joints.reshape(-1, 2)[:, ::-1].ravel()  # the other joint of the leg
    springs = np.repeat(joints[1::2] + 1, 2)
    coordinates = [partners, springs, *(np.full_like(joints, i) for i in range(TRUNK))]
    within = np.stack([M[:, joints, j] * a[:, j] for j in coordinates])

    trunk = slice(TRUNK)
    # what trunk forces do at the joints
    arriving = M[:, joints, trunk] @ np.linalg.inv(M[:, trunk, trunk])

    def at_joints(force: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N motors"]:
        return np.einsum("kmi,ki->km", arriving, force)

    blocks = [slice(spring - 2, spring + 1) for spring in springs[::2]]
    by_leg = np.stack(
        [
            -at_joints(np.einsum("kij,kj->ki", M[:, trunk, own], a[:, own]))
            for own in blocks
        ]
    )
    related = [
        [_relation(terms.cycle, leg, source) for leg in legs for _ in range(2)]
        for source in legs
    ]
    limbs = [
        np.sum(by_leg * (np.array(related) == name)[:, None, :], axis=0)
        for name in THROUGH[:3]
    ]

    def along(name: str) -> Float[np.ndarray, "N 3"]:
        return terms.forces[TERMS.index(name), :, trunk]

    velocities = along("centrifugal") + along("Coriolis")
    others = (
        along("ground reaction"),
        -along("gravity"),
        -velocities,
        along("passive"),
    )
    return Sources(terms, within, np.stack([*limbs, *map(at_joints, others)]))


def covered_by(
    sources: Sources, parts: Float[np.ndarray, "K N motors"], joint: str = "hip"
) -> Float[np.ndarray, " K"]:
    """Return the share of a joint's main inertial torque that each part balances: mean
    over the peaks of all legs, as `Coupling.covered`; nan where there is none."""
    shares = []
    for leg, motor in zip(
        sources.decomposition.legs, sources.motors(joint), strict=True
    ):
        main = sources.decomposition.along("main inertial", f"{leg} {joint}")
        peaks = periodic_peaks(np.abs(main))
        shares.append(-parts[:, peaks, motor] / main[peaks])
    found = np.concatenate(shares, axis=1)
    return np.mean(found, axis=1) if found.size else np.full(len(parts), np.nan)


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


def _relation(cycle: Cycle, leg: str, source: str) -> str:
    """Return a leg's relation to another, by the names of `THROUGH`; a pair stands
    together."""
    if source == leg:
        return "own leg"
    return (
        "same pair"
        if any({leg, source} <= set(feet) for feet in cycle.standing)
        else "other pair"
    )


# --- What coupling does at a speed, in numbers ----------------------------------------

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
    closure: float = metric("Closure", form=".0e")  # as `Sources.closure`
    opposing: float = metric("Opposed at", form=".0%")  # of the peaks
    covered: float = metric("Covered")
    # `covered` by source, as in `WITHIN`
    within: dict[str, float] = metric("By knee / spring / trunk", form=_show_within)
    # the trunk's part of it by source, as in `THROUGH`
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
    """Return the effects of inertial coupling in a solution."""
    sources = split_sources(solution)
    terms, cycle = sources.decomposition, sources.decomposition.cycle
    coupling, hind = coupling_opposes(terms), f"{cycle.hind_leg} hip"
    since = cycle.since_touchdown(cycle.hind_leg)
    order = np.argsort(since)
    angles = cycle.motion.q.reshape(len(since), -1)
    hip_angle = angles[:, terms.coordinates.index(hind)]
    return CouplingAccount(
        speed=cycle.problem.speed,
        closure=sources.closure,
        opposing=coupling.opposing,
        covered=coupling.covered,
        within=_named(WITHIN, covered_by(sources, sources.within)),
        through=_named(THROUGH, covered_by(sources, sources.through)),
        torques={
            f"{end} {joint}": _torque(sources, f"{end} {joint}")
            for end in ENDS
            for joint in ("hip", "knee")
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


def account_family(solutions: Sequence[Solution]) -> list[CouplingAccount]:
    """Return the effects of inertial coupling in each solution, by ascending speed.

    Raises:
        UserError: there are no solutions, or they differ in more than speed, scheme and
            mesh.
    """
    return [account_coupling(solution) for solution in comparable(solutions)]


def _cut(terms: Decomposition, most: int) -> Cutoff:
    largest = {}
    for end, front in ENDS.items():
        main = terms.along("main inertial", f"{terms.leg_at(front)} hip")
        kept = keep_harmonics(terms.cycle, main, most)
        largest[end] = float(np.max(np.abs(kept)))
    return Cutoff(most, largest)


def _torque(sources: Sources, name: str) -> Torque:
    end, joint = name.split()
    motors, cycle = sources.motors(joint, ENDS[end]), sources.decomposition.cycle
    weights = cycle.weights.ravel() / cycle.period
    u, fixed = sources.active[:, motors], sources.fixed[:, motors]
    instant, motor = np.unravel_index(np.argmax(np.abs(fixed)), fixed.shape)
    # of the same and of the other pair
    limbs = sources.through[1][:, motors] + sources.through[2][:, motors]
    against = -np.sign(fixed[instant, motor])
    return Torque(
        name,
        peak=float(np.max(np.abs(u))),
        fixed_peak=float(np.max(np.abs(fixed))),
        rms=float(np.sqrt(np.mean(weights @ u**2))),
        fixed_rms=float(np.sqrt(np.mean(weights @ fixed**2))),
        saved=float(against * (u - fixed)[instant, motor]),
        saved_by_limbs=float(against * limbs[instant, motor]),
    )


def _velocity_force(terms: Decomposition) -> VelocityForce:
    over_weight, share = terms.velocity_force, terms.time / terms.cycle.period
    peak = np.argmax(np.abs(over_weight))
    late = float(np.interp(0.75, share, over_weight))
    return VelocityForce(float(over_weight[peak]), float(share[peak]), late)


def _named(names: tuple[str, ...], values: Float[np.ndarray, " K"]) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


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
    weights, ground = terms.cycle.weights.ravel(), TERMS.index("ground reaction")
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
