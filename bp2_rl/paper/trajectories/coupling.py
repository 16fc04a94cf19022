"""Whose acceleration a joint's coupled inertial torque comes from, and how much of the
motors' torque it saves.

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

import numpy as np
from jaxtyping import Complex, Float

from bp2_rl.optimiser.cycle import Cycle
from bp2_rl.optimiser.problem import TRUNK, motor_coordinates
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.decomposition import (
    TERMS,
    Decomposition,
    decompose,
    evaluate,
    periodic_peaks,
)

# of a hip the other joint is the knee
WITHIN = ("other joint", "spring", "trunk x", "trunk z", "trunk pitch")
THROUGH = (
    "own leg",
    "same pair",
    "other pair",
    "ground",
    "gravity",
    "velocities",
    "air",
)
ENDS = {"fore": True, "hind": False}  # whether their legs are at the front


@dataclasses.dataclass(frozen=True)
class Sources:
    """The coupled inertial torque of every motor's joint by source. N instants, hip and
    knee of each leg in turn."""

    decomposition: Decomposition
    within: Float[np.ndarray, "5 N motors"]  # Nm: M_ij a_j, as in `WITHIN`
    through: Float[np.ndarray, "7 N motors"]  # Nm: parts of M_i,t a_t, as in `THROUGH`

    @property
    def trunk(self) -> Float[np.ndarray, "N motors"]:
        """M_i,t a_t, Nm."""
        return np.sum(self.within[2:], axis=0)

    @property
    def active(self) -> Float[np.ndarray, "N motors"]:
        """u: the motors' torques, Nm."""
        return self._of_motors("active")

    @property
    def fixed(self) -> Float[np.ndarray, "N motors"]:
        """u~: the motors' torques on a trunk that is not accelerated, Nm."""
        return self.active - self.trunk

    @property
    def closure(self) -> float:
        """Largest gap between the coupled torque, or the trunk's part of it, and the
        sum of its sources, as a share of the largest source."""
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
        """Indices of the legs' motors of one joint: of all, or of those at the front or
        behind."""
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
    """The coupled inertial torques of hips and knees by source, at every mesh point of
    a whole gait cycle.

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
    """Share of a joint's main inertial torque that each part makes up for: mean over
    the peaks of all legs, as `Coupling.covered`, and like it nan where there is
    none."""
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
    """What is left of values along the cycle with harmonics of the stride beyond `most`
    taken away.

    It is linear, so terms that balance do so still. The impulses of touchdowns are not
    in it.
    """
    coefficients = _fourier(cycle, values, most)
    turns = np.exp(
        2j * np.pi * np.outer(np.arange(most + 1), cycle.time.ravel() / cycle.period)
    )
    twice = np.where(np.arange(most + 1) > 0, 2.0, 1.0)
    return np.real((twice * coefficients) @ turns)


def variance_above(cycle: Cycle, values: Float[np.ndarray, " N"], most: int) -> float:
    """Share of the values' variance over the cycle that is in harmonics of the stride
    beyond `most`."""
    coefficients = _fourier(cycle, values, most)
    variance = (
        np.sum(cycle.weights.ravel() / cycle.period * values**2)
        - np.abs(coefficients[0]) ** 2
    )
    return float(1.0 - 2.0 * np.sum(np.abs(coefficients[1:]) ** 2) / variance)


def low_passed(terms: Decomposition, most: int) -> Decomposition:
    """The terms with harmonics of the stride beyond `most` taken away, and without
    impulses."""
    forces = np.moveaxis(
        keep_harmonics(terms.cycle, np.moveaxis(terms.forces, 1, -1), most), -1, 1
    )
    return dataclasses.replace(
        terms, forces=forces, impulses=np.zeros_like(terms.impulses)
    )


def _relation(cycle: Cycle, leg: str, source: str) -> str:
    """What one leg is to another, by the names of `THROUGH`: of a pair are those that
    stand together."""
    if source == leg:
        return "own leg"
    return (
        "same pair"
        if any({leg, source} <= set(feet) for feet in cycle.standing)
        else "other pair"
    )


def _fourier(
    cycle: Cycle, values: Float[np.ndarray, "... N"], most: int
) -> Complex[np.ndarray, "... harmonics"]:
    """Fourier coefficients 0 to `most` of values along the cycle, by the scheme's
    quadrature."""
    turns = np.exp(
        -2j * np.pi * np.outer(cycle.time.ravel() / cycle.period, np.arange(most + 1))
    )
    return (values * cycle.weights.ravel() / cycle.period) @ turns
