"""A whole gait cycle of a solution, and where the robot's links are along it. No CasADi in here."""

import dataclasses

import numpy as np
from jaxtyping import Float, Num

from bp2_rl.optimiser.links import LegLinks, down_link, hip_fore_aft, leg_bodies, leg_links
from bp2_rl.optimiser.problem import PER_LEG, TRUNK, Problem, motor_coordinates
from bp2_rl.optimiser.solution import Motion, Solution
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import HardwareSpec

MOTOR_ARRAYS = "tau", "force", "impulse"  # arrays of a motion with two columns a leg


@dataclasses.dataclass(frozen=True)
class Cycle:
    """A gait cycle on its mesh; the last point of a segment and the first of the next are one instant."""

    problem: Problem
    standing: tuple[tuple[str, ...], ...]  # feet on the ground in each segment
    motion: Motion  # its segments are the whole cycle's

    @property
    def period(self) -> float:
        """Duration, s."""
        return float(np.sum(self.motion.durations))

    @property
    def starts(self) -> Float[np.ndarray, " segments"]:
        """When each segment begins, s."""
        return np.concatenate([[0.0], np.cumsum(self.motion.durations)[:-1]])

    @property
    def time(self) -> Float[np.ndarray, "segments points"]:
        """When the points are, s."""
        return self.starts[:, None] + self.motion.durations[:, None] * self.problem.points

    @property
    def hind_leg(self) -> str:
        """The hind leg that stands first."""
        return next(leg for feet in self.standing for leg in feet if not leg.startswith("F"))

    def since_touchdown(self, leg: str) -> Float[np.ndarray, " instants"]:
        """How long after a leg's touchdown the points are, as shares of the period from 0 to 1."""
        begin = next(start for start, feet in zip(self.starts, self.standing, strict=True) if leg in feet)
        return (self.time.ravel() - begin) / self.period % 1.0

    @property
    def weights(self) -> Float[np.ndarray, "segments points"]:
        """np.sum(weights * f) is the integral of f over the cycle as the scheme takes it, s."""
        return self.motion.durations[:, None] * self.problem.quadrature


def whole_cycle(solution: Solution) -> Cycle:
    """The solved stride, followed, where that is half a cycle, by its mirror image."""
    problem, solved = solution.problem, solution.motion
    stride = problem.stride
    if stride.cycles == 1.0:
        return Cycle(problem, stride.standing, solved)
    orders = dict.fromkeys("qva", stride.next_coordinates) | dict.fromkeys(MOTOR_ARRAYS, stride.next_motors)
    mirrored = {name: solved.arrays[name][..., order] for name, order in orders.items()}
    mirrored["q"][..., 0] += problem.speed * np.sum(solved.durations)
    mirrored["durations"] = solved.durations
    motion = Motion(**{name: np.concatenate([array, mirrored[name]]) for name, array in solved.arrays.items()})
    sides = dict(zip(stride.legs, stride.then, strict=True))
    standing = tuple(tuple(sides[leg] for leg in feet) for feet in stride.standing)
    return Cycle(problem, stride.standing + standing, motion)


def leg_points(
    q: Num[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> Num[np.ndarray, "... {len(legs)} 3 2"]:
    """Hip, knee and sole of each leg in the plane at coordinates q, m."""
    links, lower = _links(q, legs, hardware)
    sole = down_link(np, links.knee, links.lower, lower)
    return np.stack([np.stack(point, axis=-1) for point in (links.hip, links.knee, sole)], axis=-2)


def center_of_mass(
    q: Num[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> Num[np.ndarray, "... 2"]:
    """The robot's centre of mass, m: the mean of its bodies (Table S3) by their masses."""
    moment = hardware.bp2.trunk_quarter_mass * q[..., :2]
    for mass, _, centre, _ in leg_bodies(np, *_links(q, legs, hardware), hardware):
        moment = moment + mass * np.mean(np.stack(centre, axis=-1), axis=-2)
    return moment / bp2.QUARTER_MASS


def center_of_mass_velocity(
    q: Float[np.ndarray, "... nq"], v: Float[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> Float[np.ndarray, "... 2"]:
    """Velocity of the robot's centre of mass, m/s: the derivative of its position along v.

    By a complex step, which is exact to rounding: nothing is subtracted.
    """
    step = 1e-30
    return np.imag(center_of_mass(q + 1j * step * v, legs, hardware)) / step


def robot_mass(problem: Problem) -> float:
    """Mass of the model, kg: as many quarters of Table S3 as it has legs."""
    return problem.hardware.mass_scale * len(problem.stride.legs) * bp2.QUARTER_MASS


def cost_of_transport(solution: Solution) -> float:
    """Positive mechanical work of the motors over weight times distance, dimensionless."""
    cycle = whole_cycle(solution)
    motion, motors = cycle.motion, motor_coordinates(solution.problem.stride.legs)
    power = np.sum(np.maximum(motion.tau * motion.v[..., motors], 0.0), axis=-1)
    distance = solution.problem.speed * cycle.period
    return float(np.sum(cycle.weights * power)) / (robot_mass(solution.problem) * conventions.GRAVITY * distance)


def _links(
    q: Num[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> tuple[LegLinks, Num[np.ndarray, "... legs"]]:
    """The legs' links, each part (..., legs), and how far each sole is from its knee, m."""
    hip, knee, spring = np.moveaxis(q[..., TRUNK:].reshape(*q.shape[:-1], len(legs), PER_LEG), -1, 0)
    trunk = q[..., :1], q[..., 1:2], q[..., 2:3]
    fore_aft = np.array([hip_fore_aft(leg) for leg in legs])
    return leg_links(np, trunk, fore_aft, (hip, knee), hardware.bp2.leg_length), hardware.bp2.leg_length - spring
