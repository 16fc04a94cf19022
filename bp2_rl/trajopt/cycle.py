"""A whole gait cycle of a solution, and where the robot's links are along it. No CasADi in here."""

import dataclasses

import numpy as np

from bp2_rl.robot import specs
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.trajopt.problem import PER_LEG, TRUNK, Problem, motor_coordinates
from bp2_rl.trajopt.solution import Solution, Trajectory

QUARTER_MASS = specs.TRUNK_QUARTER_MASS + specs.THIGH_MASS + specs.SHANK_MASS + specs.TOE_MASS  # kg, Table S3


@dataclasses.dataclass(frozen=True)
class Cycle:
    """A gait cycle on its mesh; the last point of a segment and the first of the next are one instant."""

    problem: Problem
    standing: tuple[tuple[str, ...], ...]  # feet on the ground in each segment
    motion: Trajectory  # axes: segment of the whole cycle, point, then as in `Trajectory`

    @property
    def period(self) -> float:
        """Duration, s."""
        return float(np.sum(self.motion.durations))

    @property
    def starts(self) -> np.ndarray:
        """When each segment begins, (segments,) s."""
        return np.concatenate([[0.0], np.cumsum(self.motion.durations)[:-1]])

    @property
    def time(self) -> np.ndarray:
        """When the points are, (segments, points) s."""
        return self.starts[:, None] + self.motion.durations[:, None] * self.problem.points

    @property
    def weights(self) -> np.ndarray:
        """np.sum(weights * f) is the integral of f over the cycle as the scheme takes it, (segments, points) s."""
        return self.motion.durations[:, None] * _quadrature(self.problem)


def whole_cycle(solution: Solution) -> Cycle:
    """The solved stride, followed, where that is half a cycle, by its mirror image."""
    problem, solved = solution.problem, solution.trajectory
    stride = problem.stride
    if stride.cycles == 1.0:
        return Cycle(problem, stride.standing, solved)
    coordinates, motors = stride.next_coordinates, stride.next_motors
    q = solved.q[..., coordinates].copy()
    q[..., 0] += problem.speed * np.sum(solved.durations)
    mirrored = Trajectory(
        durations=solved.durations,
        q=q,
        v=solved.v[..., coordinates],
        a=solved.a[..., coordinates],
        tau=solved.tau[..., motors],
        force=solved.force[..., motors],
        impulse=solved.impulse[..., motors],
    )
    names = [field.name for field in dataclasses.fields(Trajectory)]
    motion = Trajectory(*(np.concatenate([getattr(solved, name), getattr(mirrored, name)]) for name in names))
    sides = dict(zip(stride.legs, stride.then, strict=True))
    standing = tuple(tuple(sides[leg] for leg in feet) for feet in stride.standing)
    return Cycle(problem, stride.standing + standing, motion)


def leg_points(q: np.ndarray, legs: tuple[str, ...], hardware: HardwareSpec) -> np.ndarray:
    """Hip, knee and sole of each leg in the plane, (..., legs, 3, 2) m, of coordinates q, (..., nq)."""
    hip, thigh, lower, compression = _links(q, legs)
    knee = hip + hardware.leg_length * _down(thigh)
    sole = knee + (hardware.leg_length - compression)[..., None] * _down(lower)
    return np.stack([hip, knee, sole], axis=-2)


def center_of_mass(q: np.ndarray, legs: tuple[str, ...], hardware: HardwareSpec) -> np.ndarray:
    """The robot's centre of mass, (..., 2) m: the mean of its bodies (Table S3) by their masses."""
    _, thigh, lower, _ = _links(q, legs)
    hip, knee, sole = np.moveaxis(leg_points(q, legs, hardware), -2, 0)
    bodies = (
        (specs.TRUNK_QUARTER_MASS, q[..., None, :2]),
        (specs.THIGH_MASS, hip + specs.THIGH_COM * _down(thigh)),
        (specs.SHANK_MASS, knee + (specs.SHANK_LENGTH + specs.SHANK_COM) * _down(lower)),
        (specs.TOE_MASS, sole + specs.TOE_COM * _down(lower)),
    )
    moment = sum((mass * np.mean(position, axis=-2) for mass, position in bodies), np.zeros(2))
    return moment / QUARTER_MASS


def center_of_mass_velocity(q: np.ndarray, v: np.ndarray, legs: tuple[str, ...], hardware: HardwareSpec) -> np.ndarray:
    """Velocity of the robot's centre of mass, (..., 2) m/s: the derivative of its position along v.

    By a complex step, which is exact to rounding: nothing is subtracted.
    """
    step = 1e-30
    return np.imag(center_of_mass(q + 1j * step * v, legs, hardware)) / step


def robot_mass(problem: Problem) -> float:
    """Mass of the model, kg: as many quarters of Table S3 as it has legs."""
    return problem.hardware.mass_scale * len(problem.stride.legs) * QUARTER_MASS


def cost_of_transport(solution: Solution) -> float:
    """Positive mechanical work of the motors over weight times distance, dimensionless."""
    cycle = whole_cycle(solution)
    motion, motors = cycle.motion, motor_coordinates(solution.problem.stride.legs)
    power = np.sum(np.maximum(motion.tau * motion.v[..., motors], 0.0), axis=-1)
    distance = solution.problem.speed * cycle.period
    return float(np.sum(cycle.weights * power)) / (robot_mass(solution.problem) * specs.GRAVITY * distance)


def _quadrature(problem: Problem) -> np.ndarray:
    """Weights of the mean over a segment's points: Simpson's rule, the trapezoidal one, or, as the paper's scheme
    takes forces for velocities, the left ends."""
    weights = np.ones(len(problem.points))
    if problem.scheme == "hermite-simpson":
        weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    elif problem.scheme == "trapezoid":
        weights[1:-1] = 2.0
    else:
        weights[-1] = 0.0
    return weights / np.sum(weights)


def _links(q: np.ndarray, legs: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each leg the hip's position (..., legs, 2), angles of thigh and lower leg, and the spring's compression."""
    hip, knee, spring = np.moveaxis(q[..., TRUNK:].reshape(*q.shape[:-1], len(legs), PER_LEG), -1, 0)
    fore_aft = np.array([specs.HIP_FORE_AFT if leg.startswith("F") else -specs.HIP_FORE_AFT for leg in legs])
    forward = np.stack([np.cos(q[..., 2]), -np.sin(q[..., 2])], axis=-1)
    thigh = q[..., 2:3] + hip
    return q[..., None, :2] + fore_aft[:, None] * forward[..., None, :], thigh, thigh + knee, spring


def _down(angle: np.ndarray) -> np.ndarray:
    """Unit vector (x, z) down a link whose angle about +y is `angle`."""
    return np.stack([-np.sin(angle), -np.cos(angle)], axis=-1)
