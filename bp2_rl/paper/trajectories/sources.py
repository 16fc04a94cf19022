"""The split of a joint's coupled inertial torque by the accelerations that cause it, in
the plane and in space.

The mass matrix has no entry between two legs. So of what the paper calls coupled, at
joint i of a leg,

    sum_{j != i} M_ij a_j = M_i,other a_other + M_i,spring a_spring + M_i,t a_t ,

in space with an abduction as well, the leg's other joints are the leg's own, and other
limbs act through the acceleration a_t of the trunk alone. The trunk's rows of the
equations of motion say where that comes from,

    a_t = M_tt^-1 (sum_k (J_t^T F - M_t,k a_k) - G_t - C_t + tau_p,t) ,

so that M_i,t a_t has a part of every leg k's acceleration, of the ground, of gravity,
of velocities and of the air.

What coupling through the trunk saves is said without coordinates of the legs: the
torque of the same joint motion under the same ground forces on a trunk that is not
accelerated is u~ = u - M_i,t a_t, as the paper's u~ is that of pendulums on a beam that
stands still (Eq. active torque).
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from bp2_rl.paper.trajectories.decomposition import (
    BALANCE,
    TERMS,
    Coupling,
    periodic_peaks,
)

SAGITTAL_JOINTS = ("hip", "knee")  # of each leg
LIMBS = ("own leg", "same pair", "other pair")
ON_TRUNK = {
    "ground": ("ground reaction",),
    "gravity": ("gravity",),
    "velocities": ("centrifugal", "Coriolis"),
    "air": ("passive",),
    "stops": ("stops",),
}
"""Causes of the trunk's acceleration beside the limbs, each with its terms of the
equations of motion."""
SPATIAL_TERMS = (*TERMS, "stops")
SPATIAL_BALANCE = np.append(BALANCE, -1.0)  # with these signs the terms add up to zero


@dataclasses.dataclass(frozen=True)
class TrunkAndLegs:
    """The order of a robot's coordinates: the trunk's first, then each leg's."""

    trunk: Mapping[str, Sequence[int]]  # by name of the source
    legs: Sequence[str]
    of_leg: tuple[str, ...]  # with hip, knee and spring
    standing: Sequence[Sequence[str]]  # legs that stand together

    @property
    def starts(self) -> Int[np.ndarray, " legs"]:
        """Index of every leg's first coordinate."""
        trunk = sum(map(len, self.trunk.values()))
        return trunk + len(self.of_leg) * np.arange(len(self.legs))

    @property
    def motors(self) -> Int[np.ndarray, " motors"]:
        """Index of every hip's and knee's coordinate, leg by leg."""
        hips = self.starts + self.of_leg.index("hip")
        return np.stack([hips, hips + 1], axis=1).ravel()

    def relation(self, leg: str, source: str) -> str:
        """Return a leg's relation to another, by the names of `LIMBS`; a pair stands
        together."""
        if source == leg:
            return "own leg"
        together = any({leg, source} <= set(feet) for feet in self.standing)
        return "same pair" if together else "other pair"


@dataclasses.dataclass(frozen=True)
class Sources:
    """Coupled inertial torques of hips and knees by source, and all terms of the motion.

    T terms (`SPATIAL_TERMS`, in the plane but the last), N instants, n coordinates.
    """

    coordinates: TrunkAndLegs
    terms: Float[np.ndarray, "T N n"]  # N, Nm
    within: dict[str, Float[np.ndarray, "N motors"]]  # Nm: M_ij a_j, by whose a_j
    through: dict[str, Float[np.ndarray, "N motors"]]  # Nm: parts of M_i,t a_t

    @property
    def trunk(self) -> Float[np.ndarray, "N motors"]:
        """Inertial torque of the trunk's acceleration at each hip and knee, M_i,t a_t,
        Nm."""
        return np.sum([self.within[name] for name in self.coordinates.trunk], axis=0)

    @property
    def active(self) -> Float[np.ndarray, "N motors"]:
        """Motor torque that reaches each hip and knee through gears and joints, u,
        Nm."""
        return self.at_motors("active")

    @property
    def fixed(self) -> Float[np.ndarray, "N motors"]:
        """Motor torque that each hip and knee would take on a trunk without
        acceleration, u~, Nm."""
        return self.active - self.trunk

    @property
    def gap(self) -> Float[np.ndarray, " N"]:
        """The largest gap between coupled torque and the sum of its sources, of the
        trunk's part, too, Nm."""
        within = np.sum(list(self.within.values()), axis=0)
        through = np.sum(list(self.through.values()), axis=0)
        gaps = within - self.at_motors("coupled inertial"), through - self.trunk
        return np.max(np.abs(gaps), axis=(0, 2))

    def at_motors(self, term: str) -> Float[np.ndarray, "N motors"]:
        """Return one term of the equations of motion at every hip and knee, Nm."""
        return self.terms[TERMS.index(term)][:, self.coordinates.motors]

    def motors(self, joint: str, front: bool | None = None) -> list[int]:
        """Return the indices of the motors of a joint, in all legs or at an end."""
        return [
            len(SAGITTAL_JOINTS) * i + SAGITTAL_JOINTS.index(joint)
            for i, leg in enumerate(self.coordinates.legs)
            if front is None or leg.startswith("F") == front
        ]

    def covered(
        self, parts: Mapping[str, Float[np.ndarray, "N motors"]], joint: str = "hip"
    ) -> dict[str, float]:
        """Return the share of a joint's main inertial torque that each part makes up
        for, in all legs, as `Coupling.covered`."""
        chosen = self.motors(joint)
        main = self.at_motors("main inertial")[:, chosen]
        peaks = periodic_peaks(main)
        return {
            name: Coupling(main[peaks], part[:, chosen][peaks]).covered
            for name, part in parts.items()
        }


def split_sources(
    coordinates: TrunkAndLegs,
    mass: Float[np.ndarray, "N n n"],
    acceleration: Float[np.ndarray, "N n"],
    terms: Float[np.ndarray, "T N n"],
) -> Sources:
    """Split the coupled inertial torques of hips and knees by source, at every instant
    of a motion."""
    joints, starts = coordinates.motors, coordinates.starts

    def due_to(columns: Int[np.ndarray, " motors"]) -> Float[np.ndarray, "N motors"]:
        return mass[:, joints, columns] * acceleration[:, columns]

    within = {"other joint": due_to(joints.reshape(-1, 2)[:, ::-1].ravel())}
    for i, name in reversed(list(enumerate(coordinates.of_leg))):
        if name not in SAGITTAL_JOINTS:
            within[name] = due_to(np.repeat(starts + i, len(SAGITTAL_JOINTS)))
    for name, own in coordinates.trunk.items():
        within[name] = np.sum([due_to(np.full_like(joints, i)) for i in own], axis=0)

    trunk = slice(starts[0])
    # what trunk forces do at the joints
    arriving = mass[:, joints, trunk] @ np.linalg.inv(mass[:, trunk, trunk])

    def at_joints(force: Float[np.ndarray, "N t"]) -> Float[np.ndarray, "N motors"]:
        return np.einsum("kmi,ki->km", arriving, force)

    through = {name: np.zeros((len(mass), len(joints))) for name in LIMBS}
    for source, start in zip(coordinates.legs, starts, strict=True):
        own = slice(start, start + len(coordinates.of_leg))
        pushed = np.einsum("kij,kj->ki", mass[:, trunk, own], acceleration[:, own])
        by_leg = -at_joints(pushed)
        for i, leg in enumerate(coordinates.legs):
            motors = slice(len(SAGITTAL_JOINTS) * i, len(SAGITTAL_JOINTS) * (i + 1))
            relation = coordinates.relation(leg, source)
            through[relation][:, motors] += by_leg[:, motors]
    known = SPATIAL_TERMS[: len(terms)]
    for name, of in ON_TRUNK.items():
        rows = [known.index(term) for term in of if term in known]
        if rows:
            force = -np.tensordot(SPATIAL_BALANCE[rows], terms[rows][..., trunk], 1)
            through[name] = at_joints(force)
    return Sources(coordinates, terms, within, through)
