"""The terms of the equations of motion along a run, in three dimensions.

Mass matrix and bias forces are C MuJoCo's at the recorded states. For every coordinate
i of `qvel`

    M_ii a_i + sum_{j != i} M_ij a_j + centrifugal_i + Coriolis_i + G_i = active_i +
    passive_i + ground_i + stops_i

with G the bias force at rest, C = bias - G, and centrifugal what C is with one velocity
at a time, summed: C is quadratic. `active` is what gears and joints leave of the
motors' torque; `passive` are springs, their dampers and stops, and the air; `stops` are
the joints' limits and legs that touch each other.
"""

import dataclasses

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.paper.benchmarks.speeds import AtSpeed
from bp2_rl.paper.trajectories.decomposition import periodic_peaks, split_inertia
from bp2_rl.paper.trajectories.sources import (
    SAGITTAL_JOINTS,
    SPATIAL_BALANCE,
    SPATIAL_TERMS,
    Sources,
    TrunkAndLegs,
    split_sources,
)
from bp2_rl.robot import losses
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QVEL, NV, load_model
from bp2_rl.simulation.account import split_constraints
from bp2_rl.simulation.simulator import CONVERGED
from bp2_rl.simulation.trajectory import Trajectory

COORDINATES = TrunkAndLegs(
    trunk={
        "trunk x": (0,),
        "trunk z": (2,),
        "trunk pitch": (4,),
        "trunk sideways": (1, 3, 5),
    },
    legs=LEGS,
    of_leg=("abduction", "hip", "knee", "spring"),
    standing=(("FR", "RL"), ("FL", "RR")),
)


def closure(sources: Sources) -> Float[np.ndarray, " N"]:
    """Return the largest gap in the sums of terms and sources, over the largest term, at
    every instant."""
    unbalanced = np.einsum("t,tki->ki", SPATIAL_BALANCE, sources.terms)
    gap = np.maximum(sources.gap, np.max(np.abs(unbalanced), axis=-1))
    return gap / np.max(np.abs(sources.terms), axis=(0, 2))


def decompose_run(run: Trajectory) -> Sources:
    """Split the forces at every sample of a run on flat ground, under the recorded
    torques, by term and source."""
    model = load_model(run.hardware, visual=False)
    CONVERGED.apply(model)
    data = mujoco.MjData(model)
    resistance = Resistance.from_hardware(run.hardware)
    applied = np.zeros_like(run.qvel)
    if resistance is not None:
        applied = losses.generalized(
            losses.loss(resistance, run.qpos, run.qvel, run.torque), run.qvel
        )
    terms = np.zeros((len(SPATIAL_TERMS), len(run), NV))
    mass = np.zeros((len(run), NV, NV))
    acceleration = np.zeros((len(run), NV))
    for k in range(len(run)):
        data.qpos[:] = run.qpos[k]
        data.qvel[:] = run.qvel[k]
        data.ctrl[:] = run.torque[k]
        data.qfrc_applied[:] = applied[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass[k])
        acceleration[k] = data.qacc
        terms[2:, k] = _outer_terms(model, data)
    terms[:2] = split_inertia(mass, acceleration)
    return split_sources(COORDINATES, mass, acceleration, terms)


def _outer_terms(
    model: mujoco.MjModel, data: mujoco.MjData
) -> Float[np.ndarray, "T 22"]:
    """Return all terms but inertia at the state of the last `mj_forward`.

    Changes the velocities in `data`.
    """
    ground, legs, stops = np.zeros((3, NV))
    split_constraints(model, data, ground, legs, stops)
    at_motors = np.zeros(NV)
    at_motors[MOTOR_QVEL] = data.qfrc_applied[MOTOR_QVEL]
    bias = data.qfrc_bias.copy()
    velocity = data.qvel.copy()
    G = _bias(model, data, np.zeros(NV))
    centrifugal = sum(
        _bias(model, data, velocity * (np.arange(NV) == i)) - G for i in range(NV)
    )
    return np.stack(
        [
            centrifugal,
            bias - G - centrifugal,
            G,
            data.qfrc_actuator + at_motors,
            data.qfrc_passive + data.qfrc_applied - at_motors,
            ground,
            legs + stops,
        ]
    )


def _bias(
    model: mujoco.MjModel, data: mujoco.MjData, velocity: Float[np.ndarray, "22"]
) -> Float[np.ndarray, "22"]:
    """Return MuJoCo's bias forces at the given velocities, in the pose of `data`."""
    data.qvel[:] = velocity
    bias = np.zeros(NV)
    mujoco.mj_comVel(model, data)
    mujoco.mj_rne(model, data, 0, bias)
    return bias


# --- In numbers -----------------------------------------------------------------------

STRIDES = 8  # whole ones that are looked at, at most


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
    within: dict[str, float]  # `covered` by source, as `Sources.within`
    through: dict[str, float]  # the trunk's part of it, as `Sources.through`
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


def measure_forces(forces: Sources, strides: int, dt: float) -> Decomposed:
    """Return the metrics of `forces` over whole strides, sampled each `dt` s."""
    within = forces.covered(forces.within)
    through = forces.covered(forces.through)
    covered = sum(within.values())
    hips = forces.at_motors("main inertial")[:, forces.motors("hip")]
    torques = {
        f"{joint}, {name}": float(np.max(np.abs(torque[:, forces.motors(joint)])))
        for joint in SAGITTAL_JOINTS
        for name, torque in (("u", forces.active), ("ũ", forces.fixed))
    }
    return Decomposed(
        strides=strides,
        frequency=strides / (len(hips) * dt),
        closure=float(np.max(closure(forces))),
        peaks=len(periodic_peaks(hips)[0]),
        covered=covered,
        own=covered - sum(within[name] for name in COORDINATES.trunk),
        legs=through["same pair"] + through["other pair"],
        within=within,
        through=through,
        saved_at_hips=1.0 - torques["hip, u"] / torques["hip, ũ"],
        saved_at_knees=1.0 - torques["knee, u"] / torques["knee, ũ"],
        torques=torques,
    )
