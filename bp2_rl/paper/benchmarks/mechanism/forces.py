"""The terms of the equations of motion along a run, in three dimensions.

Mass matrix and bias forces are C MuJoCo's at the recorded states. For every coordinate
i of `qvel`

    M_ii a_i + sum_{j != i} M_ij a_j + centrifugal_i + Coriolis_i + G_i = active_i +
    passive_i + ground_i + stops_i

with G the bias force at rest, C = bias - G, and centrifugal what C is with one velocity
at a time, summed: C is quadratic. `active` is what gears and joints leave of the
motors' torque; `passive` are springs, their dampers and stops, and the air; `stops` are
the joints' limits and legs that touch each other.

As in the plane (`trajopt.coupling`) the mass matrix joins no two legs: other limbs act
on a joint through the trunk's acceleration alone.
"""

import dataclasses

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.paper.benchmarks.speeds import AtSpeed
from bp2_rl.paper.trajectories.decomposition import BALANCE as PLANAR_BALANCE
from bp2_rl.paper.trajectories.decomposition import TERMS as PLANAR_TERMS
from bp2_rl.paper.trajectories.decomposition import THROUGH as PLANAR_THROUGH
from bp2_rl.paper.trajectories.decomposition import periodic_peaks, split_inertia
from bp2_rl.robot import losses
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QVEL, NV, load_model
from bp2_rl.simulation.account import split_constraints
from bp2_rl.simulation.simulator import CONVERGED
from bp2_rl.simulation.trajectory import Trajectory

TERMS = (*PLANAR_TERMS, "stops")
BALANCE = np.append(PLANAR_BALANCE, -1.0)  # with these signs the terms add up to zero
WITHIN = (
    "other joint",
    "spring",
    "abduction",
    "trunk x",
    "trunk z",
    "trunk pitch",
    "trunk sideways",
)
"""Coordinates whose acceleration causes a hip's or knee's coupled inertial torque.
Sideways are y, roll and yaw."""
THROUGH = (*PLANAR_THROUGH, "stops")
"""Causes of the trunk's acceleration; a pair is two legs across, such as FR and RL."""
TRUNK = slice(0, 6)
JOINTS = tuple(f"{leg} {joint}" for leg in LEGS for joint in ("hip", "knee"))
# abad, hip, knee, spring
OF_LEG = tuple(slice(6 + 4 * leg, 10 + 4 * leg) for leg in range(4))
HIPS_AND_KNEES = np.array([6 + 4 * leg + joint for leg in range(4) for joint in (1, 2)])
ACROSS = (3, 2, 1, 0)  # FR and RL, FL and RR


@dataclasses.dataclass(frozen=True)
class Forces:
    """Terms of the equations of motion along a run, and sources of the inertial
    torques.

    T terms (`TERMS`), N milliseconds; joints as in `JOINTS`.
    """

    terms: Float[np.ndarray, "T N 22"]  # N, Nm
    within: Float[np.ndarray, "7 N 8"]  # Nm: M_ij a_j, as in `WITHIN`
    # Nm: parts of M_i,trunk a_trunk, as in `THROUGH`
    through: Float[np.ndarray, "8 N 8"]

    @property
    def closure(self) -> Float[np.ndarray, " N"]:
        """Largest gap in the sums of terms and of sources at each sample, over the
        largest term."""
        coupled = self.joints("coupled inertial")
        gaps = (
            np.einsum("t,tki->ki", BALANCE, self.terms),
            np.sum(self.within, axis=0) - coupled,
            np.sum(self.through, axis=0) - self.trunk,
        )
        gap = np.max([np.max(np.abs(each), axis=-1) for each in gaps], axis=0)
        return gap / np.max(np.abs(self.terms), axis=(0, 2))

    @property
    def trunk(self) -> Float[np.ndarray, "N 8"]:
        """Inertial torque of the trunk's acceleration at each hip and knee, M_i,trunk
        a_trunk, Nm."""
        return np.sum(self.within[3:], axis=0)

    @property
    def active(self) -> Float[np.ndarray, "N 8"]:
        """Motor torque that reaches each hip and knee through gears and joints, u,
        Nm."""
        return self.joints("active")

    @property
    def fixed(self) -> Float[np.ndarray, "N 8"]:
        """Motor torque that each hip and knee would take on a trunk without
        acceleration, u~, Nm.

        The ground forces stay.
        """
        return self.active - self.trunk

    def joints(self, term: str) -> Float[np.ndarray, "N 8"]:
        """Return one term of the equations of motion at every hip and knee, Nm."""
        return self.terms[TERMS.index(term)][:, HIPS_AND_KNEES]


def decompose_run(run: Trajectory) -> Forces:
    """Return all terms at every sample of a run on flat ground, under the recorded
    torques."""
    model = load_model(run.hardware, visual=False)
    CONVERGED.apply(model)
    data, floor = mujoco.MjData(model), int(model.geom("floor").id)
    resistance = Resistance.from_hardware(run.hardware)
    applied = np.zeros_like(run.qvel)
    if resistance is not None:
        applied = losses.generalized(
            losses.loss(resistance, run.qpos, run.qvel, run.torque), run.qvel
        )
    terms, within = (
        np.zeros((len(TERMS), len(run), NV)),
        np.zeros((len(WITHIN), len(run), 8)),
    )
    through, M = np.zeros((len(THROUGH), len(run), 8)), np.zeros((NV, NV))
    for k in range(len(run)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = (
            run.qpos[k],
            run.qvel[k],
            run.torque[k],
        )
        data.qfrc_applied[:] = applied[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        terms[:, k] = _terms(model, data, M, floor)
        within[:, k], through[:, k] = _sources(M, data.qacc, terms[:, k])
    return Forces(terms, within, through)


def _terms(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    M: Float[np.ndarray, "22 22"],
    floor: int,
) -> Float[np.ndarray, "T 22"]:
    """Return all terms of the equations of motion at the state of the last
    `mj_forward`.

    Changes the velocities in `data`.
    """
    terms = np.zeros((len(TERMS), NV))
    main, coupled = split_inertia(M[None], data.qacc[None])
    ground, legs, stops = np.zeros((3, NV))
    split_constraints(model, data, floor, ground, legs, stops)
    at_motors = np.zeros(NV)
    at_motors[MOTOR_QVEL] = data.qfrc_applied[MOTOR_QVEL]
    bias, velocity = data.qfrc_bias.copy(), data.qvel.copy()
    G = _bias(model, data, np.zeros(NV))
    centrifugal = sum(
        _bias(model, data, velocity * (np.arange(NV) == i)) - G for i in range(NV)
    )
    terms[:] = (
        main[0],
        coupled[0],
        centrifugal,
        bias - G - centrifugal,
        G,
        data.qfrc_actuator + at_motors,
        data.qfrc_passive + data.qfrc_applied - at_motors,
        ground,
        legs + stops,
    )
    return terms


def _bias(
    model: mujoco.MjModel, data: mujoco.MjData, velocity: Float[np.ndarray, "22"]
) -> Float[np.ndarray, "22"]:
    """Return MuJoCo's bias forces at the given velocities, in the pose of `data`."""
    data.qvel[:] = velocity
    bias = np.zeros(NV)
    mujoco.mj_comVel(model, data)
    mujoco.mj_rne(model, data, 0, bias)
    return bias


def _sources(
    M: Float[np.ndarray, "22 22"],
    a: Float[np.ndarray, "22"],
    terms: Float[np.ndarray, "T 22"],
) -> tuple[Float[np.ndarray, "7 8"], Float[np.ndarray, "8 8"]]:
    """Return the coupled inertial torques of hips and knees by source, and the trunk's
    part of them by cause, Nm."""
    i = HIPS_AND_KNEES
    partner, first = (
        i.reshape(4, 2)[:, ::-1].ravel(),
        np.repeat([leg.start for leg in OF_LEG], 2),
    )
    to_trunk = M[i, TRUNK] * a[TRUNK]
    of_leg = [M[i, j] * a[j] for j in (partner, first + 3, first)]
    within = np.stack(
        [
            *of_leg,
            to_trunk[:, 0],
            to_trunk[:, 2],
            to_trunk[:, 4],
            np.sum(to_trunk[:, [1, 3, 5]], axis=1),
        ]
    )

    # what forces on the trunk do at the joints
    arriving = M[i, TRUNK] @ np.linalg.inv(M[TRUNK, TRUNK])
    # source, leg, joint
    by_leg = -np.stack([arriving @ M[TRUNK, leg] @ a[leg] for leg in OF_LEG]).reshape(
        4, 4, 2
    )
    legs = np.arange(4)
    own, across = by_leg[legs, legs].ravel(), by_leg[np.array(ACROSS), legs].ravel()

    def at_joints(*names: str) -> Float[np.ndarray, "8"]:
        return arriving @ sum(terms[TERMS.index(name), TRUNK] for name in names)

    through = (
        own,
        across,
        np.sum(by_leg, axis=0).ravel() - own - across,
        at_joints("ground reaction"),
        -at_joints("gravity"),
        -at_joints("centrifugal", "Coriolis"),
        at_joints("passive"),
        at_joints("stops"),
    )
    return within, np.stack(through)


# --- In numbers -----------------------------------------------------------------------

STRIDES = 8  # whole ones that are looked at, at most
HIPS = tuple(JOINTS.index(f"{leg} hip") for leg in LEGS)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decomposed:
    """Metrics of a run's inertial torques over whole strides, by source.

    Shares are of the hips' main inertial torque, mean over its peaks.
    """

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
    # Nm, greatest at any hip and knee: u, and ũ on a trunk that is not accelerated
    torques: dict[str, float]


@dataclasses.dataclass(frozen=True)
class MechanismAtSpeed(AtSpeed):
    """A run at one commanded speed, with its inertial torques by source."""

    forces: Decomposed | None  # None of a run that fell or made no two strides


@dataclasses.dataclass(frozen=True)
class MechanismMetrics:
    """A policy's runs at all commanded speeds, with their inertial torques by
    source."""

    speeds: tuple[MechanismAtSpeed, ...]

    @property
    def found(self) -> tuple[tuple[MechanismAtSpeed, Decomposed], ...]:
        """Runs whose torques could be split by source, each with its metrics."""
        return tuple((at, at.forces) for at in self.speeds if at.forces is not None)


def measure_forces(forces: Forces, strides: int, dt: float) -> Decomposed:
    """Return the metrics of `forces` over whole strides, sampled each `dt` s."""
    main = forces.joints("main inertial")
    peaks = [(periodic_peaks(np.abs(main[:, hip])), hip) for hip in HIPS]

    def cover(parts: Float[np.ndarray, "K N 8"]) -> list[float]:
        """Return the share of the hips' main inertial torque that each part
        balances."""
        shares = [-parts[:, at, hip] / main[at, hip] for at, hip in peaks]
        return np.mean(np.concatenate(shares, axis=1), axis=1).tolist()

    within, through = cover(forces.within), cover(forces.through)
    given = {"u": forces.active, "ũ": forces.fixed}
    torques = {
        f"{joint}, {name}": float(np.max(np.abs(torque[:, first::2])))
        for first, joint in enumerate(("hip", "knee"))
        for name, torque in given.items()
    }
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
        saved_at_hips=1.0 - torques["hip, u"] / torques["hip, ũ"],
        saved_at_knees=1.0 - torques["knee, u"] / torques["knee, ũ"],
        torques=torques,
    )
