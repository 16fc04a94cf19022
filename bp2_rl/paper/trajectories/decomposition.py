"""The terms of the equations of motion along a gait cycle (paper,
"Inertial coupling in robot running", Eqs. continuous_dynamics, average force and force
ratio).

For every coordinate i

    M_ii qdd_i + sum_{j != i} M_ij qdd_j + centrifugal_i + Coriolis_i + G_i = (B u)_i +
    tau_p,i + (J^T F)_i

with u what gears and joints leave of the motors' torques; and at a touchdown, where
velocities jump by dv and the ground gives the impulse Lambda,

    M_ii dv_i + sum_{j != i} M_ij dv_j = (J^T Lambda)_i .

Both count in the average force: in the sense of distributions a jump is a force as
well, and only with it do gravity and the vertical ground reaction have the same mean.
Only `decompose` needs CasADi.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.signal import find_peaks

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.cycle import Cycle, whole_cycle
from bp2_rl.optimiser.solution import Solution

TERMS = (
    "main inertial",
    "coupled inertial",
    "centrifugal",
    "Coriolis",
    "gravity",
    "active",
    "passive",
    "ground reaction",
)
# with these signs the terms add up to zero
BALANCE = np.array([1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
# what trends are drawn of: the trunk's translation, and the motors' mean over legs
KINDS = ("x", "z", "hip", "knee")
PROMINENCE = 0.2  # of the largest magnitude: a peak counts that stands out by as much


@dataclasses.dataclass(frozen=True)
class Decomposition:
    """All terms of the equations of motion along a gait cycle. T terms (`TERMS`), N
    instants, n coordinates, K touchdowns."""

    cycle: Cycle
    coordinates: tuple[str, ...]  # "x", "z", "pitch", "FR hip", ...
    mass: Float[np.ndarray, "N n n"]
    forces: Float[np.ndarray, "T N n"]  # N, Nm
    # N s, Nm s: of inertia and ground as each segment begins, 0 if nothing lands
    impulses: Float[np.ndarray, "T K n"]

    @property
    def legs(self) -> tuple[str, ...]:
        """The legs' names, in the order of the coordinates."""
        return self.cycle.problem.stride.legs

    @property
    def time(self) -> Float[np.ndarray, " N"]:
        """The instants, s; where two segments meet there are two at once."""
        return self.cycle.time.ravel()

    @property
    def closure(self) -> float:
        """Largest sum of all terms, each with its sign of `BALANCE`, N or Nm: zero but
        for the solver's tolerance."""
        return float(np.max(np.abs(np.einsum("t,tki->ki", BALANCE, self.forces))))

    @property
    def velocity_force(self) -> Float[np.ndarray, " N"]:
        """Vertical centrifugal and Coriolis force together, over the robot's weight."""
        return (
            self.along("centrifugal", "z") + self.along("Coriolis", "z")
        ) / self.along("gravity", "z")

    def leg_at(self, front: bool) -> str:
        """Return the name of the first front or hind leg; left and right are mirror
        images."""
        return next(leg for leg in self.legs if leg.startswith("F") == front)

    def along(self, term: str, coordinate: str) -> Float[np.ndarray, " N"]:
        """Return one term at one coordinate along the cycle, N or Nm."""
        return self.forces[TERMS.index(term), :, self.coordinates.index(coordinate)]


@dataclasses.dataclass(frozen=True)
class Coupling:
    """Main and coupled inertial torque at the peaks of a joint's main torque. P peaks,
    all legs' together.

    Where there is no peak, the shares are nan.
    """

    main: Float[np.ndarray, " P"]  # Nm
    coupled: Float[np.ndarray, " P"]  # Nm

    @property
    def opposing(self) -> float:
        """Share of the peaks at which main and coupled inertial torque have opposite
        signs."""
        return _mean(self.main * self.coupled < 0.0)

    @property
    def covered(self) -> float:
        """Share of the main inertial torque that the coupled torque balances: mean over
        the peaks, less than zero where the coupled torque adds to the burden."""
        return _mean(-self.coupled / self.main)


@dataclasses.dataclass(frozen=True)
class Trends:
    """Average forces at each speed, and their shares. S speeds, T terms (`TERMS`), the
    columns of `KINDS`."""

    speeds: Float[np.ndarray, " S"]  # m/s, ascending
    average: Float[np.ndarray, "S T kinds"]  # N, Nm (paper, Eq. average force)
    share: Float[np.ndarray, "S T kinds"]  # (paper, Eq. force ratio)


@dataclasses.dataclass(frozen=True)
class TermMeans:
    """Average forces at one speed, by kind (`KINDS`) and term (`TERMS`)."""

    speed: float  # m/s
    average: dict[str, dict[str, float]]  # N, Nm
    share: dict[str, dict[str, float]]


def decompose(solution: Solution) -> Decomposition:
    """Return all terms of the equations of motion at every mesh point of a gait cycle,
    and the impulses of touchdowns.

    Raises:
        UserError: CasADi is not installed.
    """
    # here alone, so that what is decomposed can be read without CasADi
    from bp2_rl.optimiser import sagittal

    cycle = whole_cycle(solution)
    problem, motion = cycle.problem, cycle.motion
    p = sagittal.design_vector(problem.hardware)
    model = sagittal.model_of(problem)

    q, v, a, tau, F = (
        x.reshape(-1, x.shape[-1])
        for x in (motion.q, motion.v, motion.a, motion.tau, motion.force)
    )
    n = q.shape[-1]
    mass = evaluate(model.mass, q, p)
    main, coupled = split_inertia(mass, a)
    forces = np.empty((len(TERMS), *q.shape))
    forces[:] = (
        main,
        coupled,
        evaluate(model.centrifugal, q, v, p)[..., 0],
        evaluate(model.coriolis, q, v, p)[..., 0],
        evaluate(model.gravity, q, p)[..., 0],
        (tau - evaluate(model.resistance, v, tau, p)[..., 0])
        @ np.eye(n)[cycle.problem.stride.motors],
        evaluate(model.passive, q, v, p)[..., 0],
        np.einsum("kci,kc->ki", evaluate(model.contact_jacobian, q, p), F),
    )

    q = motion.q[:, 0]
    jump = motion.v[:, 0] - np.roll(motion.v[:, -1], 1, axis=0)
    impulses = np.zeros((len(TERMS), *q.shape))
    impulses[:2] = split_inertia(evaluate(model.mass, q, p), jump)
    impulses[-1] = np.einsum(
        "kci,kc->ki", evaluate(model.contact_jacobian, q, p), motion.impulse
    )
    stride = cycle.problem.stride
    joints = ("hip", "knee", "spring")[: stride.per_leg]
    of_legs = (f"{leg} {joint}" for leg in stride.legs for joint in joints)
    return Decomposition(cycle, ("x", "z", "pitch", *of_legs), mass, forces, impulses)


def average_force(decomposition: Decomposition) -> Float[np.ndarray, "T n"]:
    """Return the mean magnitudes of all terms over a gait cycle, N or Nm (paper, Eq.
    average force).

    The integral is the scheme's own quadrature; a touchdown adds the magnitude of its
    impulse.
    """
    cycle = decomposition.cycle
    flowing = np.einsum(
        "k,tki->ti", cycle.weights.ravel(), np.abs(decomposition.forces)
    )
    return (flowing + np.sum(np.abs(decomposition.impulses), axis=1)) / cycle.period


def force_ratio(average: Float[np.ndarray, "... T n"]) -> Float[np.ndarray, "... T n"]:
    """Return each term's share of the sum of all terms' average forces (paper, Eq.
    force ratio)."""
    return average / np.sum(average, axis=-2, keepdims=True)


def peak_velocity_force(decomposition: Decomposition) -> float:
    """Return the largest vertical velocity force over the weight: the paper's C_y / (m
    g)."""
    return float(np.max(np.abs(decomposition.velocity_force)))


def coupling_opposes(decomposition: Decomposition, joint: str = "hip") -> Coupling:
    """Return the coupled inertial torque at the peaks of a joint's main inertial torque,
    over all legs.

    A peak is a local maximum of the magnitude along the (periodic) cycle that stands
    out of its surroundings (prominence) by at least `PROMINENCE` of the largest.
    """
    columns = [
        decomposition.coordinates.index(f"{leg} {joint}") for leg in decomposition.legs
    ]
    main, coupled = decomposition.forces[:2, :, columns]
    peaks = periodic_peaks(main)
    return Coupling(main[peaks], coupled[peaks])


def find_trends(solutions: Sequence[Solution]) -> Trends:
    """Return average forces and their shares over the solutions' speeds.

    `KINDS` stand for the four columns of the paper's Fig. robot_model_analysis, E to L.
    Its text says that F and J are vertical and G and K the hip's; the knee and the
    horizontal are what panels A to C and the plane leave.

    Raises:
        UserError: there are no solutions, or they differ in more than speed, scheme and
            mesh.
    """
    solutions = comparable(solutions)
    average = np.stack([_by_kind(decompose(solution)) for solution in solutions])
    return Trends(
        np.array([solution.problem.speed for solution in solutions]),
        average,
        force_ratio(average),
    )


def means_by_speed(trends: Trends) -> tuple[TermMeans, ...]:
    """Return the average forces and their shares at each speed, by kind and term."""
    return tuple(
        TermMeans(float(speed), _named(average), _named(share))
        for speed, average, share in zip(
            trends.speeds, trends.average, trends.share, strict=True
        )
    )


def _named(values: Float[np.ndarray, "T kinds"]) -> dict[str, dict[str, float]]:
    """Return values by kind of coordinate, and by the name of the term."""
    return {
        kind: dict(zip(TERMS, map(float, column), strict=True))
        for kind, column in zip(KINDS, values.T, strict=True)
    }


def comparable(solutions: Sequence[Solution]) -> list[Solution]:
    """Return solutions by ascending speed; refuse solutions that cannot be compared.

    Raises:
        UserError: there are none, two have one speed, or they differ in gait or
            hardware.
    """
    if not solutions:
        raise UserError("there are no solutions to compare: give at least one")
    ordered = sorted(solutions, key=lambda solution: solution.problem.speed)
    for one, other in itertools.pairwise(solution.problem for solution in ordered):
        if one.speed == other.speed:
            raise UserError(
                f"two solutions have the speed {other.speed:g} m/s: give one for each speed"
            )
        for name in ("gait", "hardware", "rotor_coupling"):
            if getattr(one, name) != getattr(other, name):
                raise UserError(
                    f"the solutions for {one.speed:g} and {other.speed:g} m/s differ in {name}: give solutions that "
                    "differ in speed only"
                )
    return ordered


def evaluate(
    function: Any, *arguments: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "rows m n"]:
    """Return a CasADi function's matrix at each row of its arguments, the last of which
    is the same for all."""
    *varying, p = arguments
    rows, (m, n) = len(varying[0]), function.size_out(0)
    columns = np.array(function.map(rows)(*(x.T for x in varying), p))
    return columns.reshape(m, rows, n).swapaxes(0, 1)


def split_inertia(
    M: Float[np.ndarray, "K n n"], a: Float[np.ndarray, "K n"]
) -> tuple[Float[np.ndarray, "K n"], Float[np.ndarray, "K n"]]:
    """Return main and coupled inertial forces, M_ii a_i and sum_{j != i} M_ij a_j, of
    accelerations or velocity jumps."""
    main = np.einsum("kii,ki->ki", M, a)
    return main, np.einsum("kij,kj->ki", M, a) - main


def periodic_peaks(
    values: Float[np.ndarray, "N columns"],
) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"]]:
    """Return the instants and columns of the peaks of a period's magnitudes that stand
    out by `PROMINENCE`."""
    size = len(values)
    found = [
        (instant - size, column)
        for column, height in enumerate(np.abs(values.T))
        for instant in find_peaks(
            np.tile(height, 3), prominence=PROMINENCE * np.max(height)
        )[0]
        if size <= instant < 2 * size
    ]
    instants, columns = np.array(found, int).reshape(-1, 2).T
    return instants, columns


def _mean(values: Shaped[np.ndarray, " P"]) -> float:
    """Return the mean of values, nan where there are none."""
    return float(np.mean(values)) if len(values) else math.nan


def _by_kind(decomposition: Decomposition) -> Float[np.ndarray, "T kinds"]:
    """Return average forces by term and kind of coordinate; a joint's is the mean over
    the legs."""
    average = average_force(decomposition)
    columns = [
        [
            i
            for i, name in enumerate(decomposition.coordinates)
            if name.split()[-1] == kind
        ]
        for kind in KINDS
    ]
    return np.stack([np.mean(average[:, column], axis=1) for column in columns], axis=1)
