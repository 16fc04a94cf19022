"""What is said of coupling at each speed, in numbers, in words and in a table: shares
by source, what a still trunk would cost, and what hangs on the harmonics, the
coordinates and the instant that are looked at."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from rich.table import Table

from bp2_rl.optimiser.problem import motor_coordinates
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.coordinates import LINKS, decompose_links
from bp2_rl.paper.trajectories.coupling import (
    ENDS,
    THROUGH,
    WITHIN,
    Sources,
    covered_by,
    low_passed,
    split_sources,
    variance_above,
)
from bp2_rl.paper.trajectories.decomposition import (
    TERMS,
    Coupling,
    Decomposition,
    comparable,
    coupling_opposes,
)

HARMONICS = (2, 4, 8)
"""Torques are looked at up to these harmonics of the stride; a toe on its spring, 17
Hz, is the fifth or sixth."""
PAPER_INSTANT = 0.21  # T, at which the paper has the hip reverse


@dataclasses.dataclass(frozen=True)
class Torque:
    """What a kind of motor gives over a cycle, and would give on a trunk that is not
    accelerated."""

    peak: float  # Nm, of u
    fixed_peak: float  # Nm, of u~
    rms: float  # Nm, of u
    fixed_rms: float  # Nm, of u~
    saved: float  # Nm, by the trunk's acceleration where u~ peaks
    saved_by_limbs: float  # Nm, the other legs' part of that


@dataclasses.dataclass(frozen=True)
class Cutoff:
    """The hips' inertial torques kept to the first harmonics of the stride."""

    harmonics: int
    largest: dict[str, float]  # Nm, of the main one, by end
    covered_there: dict[str, float]  # the coupled one's share of that, by end
    opposing: float  # as in `Coupling`, over all hips' peaks
    covered: float  # as in `Coupling`, over all hips' peaks
    # of main, coupled and active torque of hind hips, the share beyond
    variance_above: dict[str, float]


@dataclasses.dataclass(frozen=True)
class VelocityForce:
    """The vertical force of velocities, C_z, over the weight; instants are shares of
    the cycle from a touchdown on."""

    peak: float
    instant: float
    at_quarter: float
    at_three_quarters: float


@dataclasses.dataclass(frozen=True)
class CouplingAccount:
    """What coupling does at one speed: shares are of the hips' main inertial torque,
    mean over its peaks."""

    speed: float  # m/s
    closure: float  # as `Sources.closure`
    opposing: float
    covered: float
    within: dict[str, float]  # `covered` by source, as in `WITHIN`
    through: dict[str, float]  # the trunk's part of it by source, as in `THROUGH`
    # Nm, mean magnitudes of the hips' main torque and of the parts of the coupled one
    mean: dict[str, float]
    torques: dict[str, Torque]  # by end and joint
    cutoffs: tuple[Cutoff, ...]
    # Nm, of a hip by its angle or a thigh by its own, by the name of the coordinates
    largest_main: dict[str, float]
    # `covered` of `Coupling`, by the name of the coordinates
    covered_in: dict[str, float]
    # Nm, terms of a hind hip at `PAPER_INSTANT` after its touchdown
    at_paper_instant: dict[str, float]
    # share of the cycle after a touchdown, at which a hind hip turns from backwards to
    # forwards
    reversal: float
    # share of the cycle at which the main torque of `HARMONICS`'s most turns it hardest
    hardest_turn: float
    velocity_force: VelocityForce


def account_coupling(solution: Solution) -> CouplingAccount:
    """Everything that is said of coupling at one speed."""
    sources = split_sources(solution)
    terms, links = sources.decomposition, decompose_links(solution)
    cycle, hips = terms.cycle, sources.motors("hip")
    weights = cycle.weights.ravel() / cycle.period
    coupling, thighs = coupling_opposes(terms), coupling_opposes(links, LINKS["hip"])
    parts = {
        "main": terms.forces[0][:, motor_coordinates(terms.legs)],
        **dict(zip(WITHIN, sources.within, strict=True)),
    }
    hind = cycle.hind_leg
    since = cycle.since_touchdown(hind)
    hip_angle = cycle.motion.q.reshape(len(since), -1)[
        :, terms.coordinates.index(f"{hind} hip")
    ]
    slow = low_passed(terms, HARMONICS[-1]).along("main inertial", f"{hind} hip")
    return CouplingAccount(
        speed=cycle.problem.speed,
        closure=sources.closure,
        opposing=coupling.opposing,
        covered=coupling.covered,
        within=_named(WITHIN, covered_by(sources, sources.within)),
        through=_named(THROUGH, covered_by(sources, sources.through)),
        mean={
            name: float(np.mean(weights @ np.abs(part[:, hips])))
            for name, part in parts.items()
        },
        torques={
            f"{end} {joint}": _torque(sources, sources.motors(joint, front), weights)
            for end, front in ENDS.items()
            for joint in ("hip", "knee")
        },
        cutoffs=tuple(_cut(terms, most) for most in HARMONICS),
        largest_main={"joints": _largest(coupling), "links": _largest(thighs)},
        covered_in={"joints": coupling.covered, "links": thighs.covered},
        at_paper_instant={
            term: float(
                np.interp(
                    PAPER_INSTANT,
                    np.sort(since),
                    terms.along(term, f"{hind} hip")[np.argsort(since)],
                )
            )
            for term in TERMS
        },
        reversal=float(since[np.argmax(hip_angle)]),  # where the hip is furthest back
        hardest_turn=float(since[np.argmin(slow)]),
        velocity_force=_velocity_force(terms),
    )


def account_family(solutions: Sequence[Solution]) -> list[CouplingAccount]:
    """`account_coupling` over speed.

    Raises:
        UserError: there are no solutions, or they differ in more than speed, scheme and
            mesh.
    """
    return [account_coupling(solution) for solution in comparable(solutions)]


def remarks(account: CouplingAccount) -> list[str]:
    """What the account of one speed says, in words, with the paper's figures beside
    ours."""
    within, trunk = (
        sum(list(account.within.values())[part]) for part in (slice(2), slice(2, None))
    )
    same, other = (account.through[name] for name in ("same pair", "other pair"))
    largest, covered, velocity = (
        account.largest_main,
        account.covered_in,
        account.velocity_force,
    )
    main, coupled, active = (
        account.at_paper_instant[term] for term in (*TERMS[:2], "active")
    )
    return [
        f"of the hips' main inertial torque at its peaks the leg's own knee and spring cover {within:.2f}, the trunk "
        f"{trunk:+.3f}, of which {same:+.3f} for the leg of the same pair and {other:+.3f} for the other pair",
        *(
            f"{name}: {_torque_remark(torque)}"
            for name, torque in account.torques.items()
        ),
        *(
            f"harmonics 1 to {cut.harmonics}: {_cut_remark(cut)}"
            for cut in account.cutoffs
        ),
        f"in angles of the joints a hip's main torque peaks at {largest['joints']:.0f} Nm and coupled covers "
        f"{covered['joints']:.2f}; in angles of the links it is {largest['links']:.0f} Nm and {covered['links']:.2f}",
        f"{PAPER_INSTANT} T after touchdown a hind hip has {main:.0f} Nm main, {coupled:.0f} coupled and {active:.0f} "
        f"active; it is turned hardest at {account.hardest_turn:.2f} T and reverses at {account.reversal:.2f} T",
        f"C_z / (m g) peaks with {velocity.peak:.2f} at {velocity.instant:.3f} T; at 3/4 T (paper: 1.19) it is "
        f"{velocity.at_three_quarters:.2f}",
    ]


def tabulate(accounts: Sequence[CouplingAccount]) -> Table:
    """Shares of the hips' main inertial torque at its peaks by source, and the motors'
    peaks, over speed."""
    shares = (
        "covered",
        "own knee",
        "own spring",
        "trunk",
        "own leg",
        "same pair",
        "other pair",
    )
    table = Table("m/s", *shares, "u, ũ fore", "u, ũ hind")
    for account in accounts:
        knee, spring, *trunk = account.within.values()
        parts = (
            account.covered,
            knee,
            spring,
            sum(trunk),
            *(account.through[name] for name in THROUGH[:3]),
        )
        torques = [account.torques[f"{end} hip"] for end in ENDS]
        peaks = [f"{torque.peak:.0f}, {torque.fixed_peak:.0f}" for torque in torques]
        table.add_row(
            f"{account.speed:g}", *(f"{share:.2f}" for share in parts), *peaks
        )
    table.title = "Of the hips' main inertial torque at its peaks; from own leg on: through the trunk; peaks in Nm"
    return table


def _torque_remark(torque: Torque) -> str:
    return (
        f"u peaks at {torque.peak:.1f} Nm, on a trunk that is not accelerated at {torque.fixed_peak:.1f} Nm, where the "
        f"trunk saves {torque.saved:.1f} Nm, {torque.saved_by_limbs:.1f} of them for other legs; root mean squares "
        f"{torque.rms:.1f} and {torque.fixed_rms:.1f} Nm"
    )


def _cut_remark(cut: Cutoff) -> str:
    main, coupled, active = cut.variance_above.values()
    return (
        f"main peaks at {cut.largest['fore']:.0f} (fore) and {cut.largest['hind']:.0f} Nm (hind), coupled covers "
        f"{cut.covered_there['fore']:.2f} and {cut.covered_there['hind']:.2f} there; over all peaks it opposes at "
        f"{cut.opposing:.0%} and covers {cut.covered:.2f}; beyond are {main:.0%} of the main, {coupled:.0%} of the "
        f"coupled, {active:.0%} of the active torque's variance"
    )


def _cut(terms: Decomposition, most: int) -> Cutoff:
    kept = low_passed(terms, most)
    coupling, largest, covered = coupling_opposes(kept), {}, {}
    for end, front in ENDS.items():
        main, coupled = (
            kept.along(term, f"{terms.leg_at(front)} hip") for term in TERMS[:2]
        )
        peak = np.argmax(np.abs(main))
        largest[end], covered[end] = (
            float(np.abs(main[peak])),
            float(-coupled[peak] / main[peak]),
        )
    hind = f"{terms.cycle.hind_leg} hip"
    above = {
        term: variance_above(terms.cycle, terms.along(term, hind), most)
        for term in (*TERMS[:2], "active")
    }
    return Cutoff(most, largest, covered, coupling.opposing, coupling.covered, above)


def _torque(
    sources: Sources, motors: list[int], weights: Float[np.ndarray, " N"]
) -> Torque:
    u, fixed = sources.active[:, motors], sources.fixed[:, motors]
    peaks = [float(np.max(np.abs(x))) for x in (u, fixed)]
    means = [float(np.sqrt(np.mean(weights @ x**2))) for x in (u, fixed)]
    instant, motor = np.unravel_index(np.argmax(np.abs(fixed)), fixed.shape)
    # of the same and of the other pair
    limbs = sources.through[1][:, motors] + sources.through[2][:, motors]
    saved = [
        -float(np.sign(fixed[instant, motor]) * part[instant, motor])
        for part in (u - fixed, limbs)
    ]
    return Torque(*peaks, *means, *saved)


def _velocity_force(terms: Decomposition) -> VelocityForce:
    over_weight, share = terms.velocity_force, terms.time / terms.cycle.period
    peak = np.argmax(np.abs(over_weight))
    quarter, three_quarters = (
        float(np.interp(at, share, over_weight)) for at in (0.25, 0.75)
    )
    return VelocityForce(
        float(over_weight[peak]), float(share[peak]), quarter, three_quarters
    )


def _largest(coupling: Coupling) -> float:
    return float(np.max(np.abs(coupling.main), initial=0.0))


def _named(names: tuple[str, ...], values: Float[np.ndarray, " K"]) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
