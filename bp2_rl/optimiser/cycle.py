"""A whole gait cycle of a solution, and where the robot's links are along it. No CasADi
in here."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Num

from bp2_rl.optimiser.links import (
    LegLinks,
    Point,
    leg_bodies,
    leg_links,
    leg_of,
    trunk_body,
)
from bp2_rl.optimiser.problem import TRUNK, Problem, per_leg
from bp2_rl.optimiser.solution import Motion, Solution
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec

MOTOR_ARRAYS = "tau", "force", "impulse"  # arrays of a motion with two columns a leg


@dataclasses.dataclass(frozen=True)
class Cycle:
    """A gait cycle on its mesh; the last point of a segment and the first of the next
    are one instant."""

    problem: Problem
    standing: tuple[tuple[str, ...], ...]  # feet on the ground in each segment
    motion: Motion  # its segments are the whole cycle's

    @property
    def period(self) -> float:
        """Duration of the gait cycle, s."""
        return float(np.sum(self.motion.durations))

    @property
    def starts(self) -> Float[np.ndarray, " segments"]:
        """Time at which each segment begins, s."""
        return np.concatenate([[0.0], np.cumsum(self.motion.durations)[:-1]])

    @property
    def time(self) -> Float[np.ndarray, "segments points"]:
        """Times of the mesh's points, s."""
        return (
            self.starts[:, None] + self.motion.durations[:, None] * self.problem.points
        )

    @property
    def hind_leg(self) -> str:
        """Name of the hind leg that stands first."""
        return next(
            leg for feet in self.standing for leg in feet if not leg.startswith("F")
        )

    def since_touchdown(self, leg: str) -> Float[np.ndarray, " instants"]:
        """Return the time of every point since a leg's touchdown, as a share of the
        period from 0 to 1."""
        begin = next(
            start
            for start, feet in zip(self.starts, self.standing, strict=True)
            if leg in feet
        )
        return (self.time.ravel() - begin) / self.period % 1.0

    @property
    def weights(self) -> Float[np.ndarray, "segments points"]:
        """Quadrature weights, s, of the solution's scheme: np.sum(weights * f) is the
        integral of f over the cycle."""
        return self.motion.durations[:, None] * self.problem.quadrature


def whole_cycle(solution: Solution) -> Cycle:
    """Return the whole gait cycle of a solution: its stride, followed by the mirror
    image where the stride is half a cycle."""
    problem, solved = solution.problem, solution.motion
    stride = problem.stride
    if stride.cycles == 1.0:
        return Cycle(problem, stride.standing, solved)
    orders = dict.fromkeys("qva", stride.next_coordinates) | dict.fromkeys(
        MOTOR_ARRAYS, stride.next_motors
    )
    mirrored = {name: solved.arrays[name][..., order] for name, order in orders.items()}
    mirrored["q"][..., 0] += problem.speed * np.sum(solved.durations)
    mirrored["durations"] = solved.durations
    motion = Motion(
        **{
            name: np.concatenate([array, mirrored[name]])
            for name, array in solved.arrays.items()
        }
    )
    sides = dict(zip(stride.legs, stride.then, strict=True))
    standing = tuple(tuple(sides[leg] for leg in feet) for feet in stride.standing)
    return Cycle(problem, stride.standing + standing, motion)


def leg_points(
    q: Num[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> Num[np.ndarray, "... {len(legs)} 3 2"]:
    """Return hip, knee and sole of every leg in the plane, m, at coordinates q."""
    return np.stack(
        [_points(links[:3]) for links, _, _ in _legs(q, legs, hardware)], axis=-3
    )


def center_of_mass(
    q: Num[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> Num[np.ndarray, "... 2"]:
    """The robot's centre of mass, m: the mean of its bodies by their masses."""
    bodies = [trunk_body(np, hardware.anatomy, legs, (q[..., 0], q[..., 1], q[..., 2]))]
    for links, compression, name in _legs(q, legs, hardware):
        bodies += leg_bodies(np, leg_of(hardware.anatomy, name), links, compression)
    masses = np.array([body.mass for body in bodies])
    return np.einsum(
        "b,...bx->...x",
        masses / np.sum(masses),
        _points([body.centre for body in bodies]),
    )


def center_of_mass_velocity(
    q: Float[np.ndarray, "... nq"],
    v: Float[np.ndarray, "... nq"],
    legs: tuple[str, ...],
    hardware: HardwareSpec,
) -> Float[np.ndarray, "... 2"]:
    """Velocity of the robot's centre of mass, m/s: the derivative of its position along
    v.

    By a complex step, which is exact to rounding: nothing is subtracted.
    """
    step = 1e-30
    return np.imag(center_of_mass(q + 1j * step * v, legs, hardware)) / step


def robot_mass(problem: Problem) -> float:
    """Return the mass of a problem's model, kg: the model's share of the robot's
    links."""
    return problem.hardware.mass_scale * problem.share * problem.hardware.anatomy.mass


def cost_of_transport(solution: Solution) -> float:
    """Positive mechanical work of the motors over weight times distance,
    dimensionless."""
    cycle = whole_cycle(solution)
    motion, motors = cycle.motion, solution.problem.stride.motors
    power = np.sum(np.maximum(motion.tau * motion.v[..., motors], 0.0), axis=-1)
    distance = solution.problem.speed * cycle.period
    return float(np.sum(cycle.weights * power)) / (
        robot_mass(solution.problem) * conventions.GRAVITY * distance
    )


def _legs(
    q: Num[np.ndarray, "... nq"], legs: tuple[str, ...], hardware: HardwareSpec
) -> list[tuple[LegLinks, Num[np.ndarray, "..."], str]]:
    """Return the links, the spring's compression (m) and the name of every leg; the
    foot is the sole."""
    found, trunk = [], (q[..., 0], q[..., 1], q[..., 2])
    for i, name in enumerate(legs):
        leg, first = leg_of(hardware.anatomy, name), TRUNK + per_leg(hardware) * i
        compression = (
            q[..., first + 2] if hardware.anatomy.sprung else np.zeros_like(q[..., 0])
        )
        joints = q[..., first], q[..., first + 1]
        found.append(
            (
                leg_links(np, trunk, leg, joints, leg.lower_length - compression),
                compression,
                name,
            )
        )
    return found


def _points(points: Sequence[Point]) -> Num[np.ndarray, "... points 2"]:
    return np.stack([np.stack(point, axis=-1) for point in points], axis=-2)
