"""How much room there is between the legs, and between the legs and the trunk, in closed form.

A leg is a thigh (hip to knee), a lower leg (knee to the foot's centre) and a foot, the trunk two beams: all of them
points at most a radius away from a segment. They are the capsules of solid legs in the MuJoCo model, where shank and
toe slide into each other and are one lower leg. NumPy and JAX alike, batched over leading axes, in the caller's
precision.
"""

import itertools
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.robot import specs
from bp2_rl.robot.kinematics import SIDE, foot_position, leg_origins
from bp2_rl.robot.specs import IDEAL, HardwareSpec

Array = Any  # NumPy or JAX

_LEG_RADII = specs.THIGH_RADIUS, specs.LOWER_LEG_RADIUS, specs.FOOT_RADIUS
_RADII = np.array([*_LEG_RADII * 4, specs.TRUNK_RADIUS, specs.TRUNK_RADIUS])  # m: leg by leg, then the two beams
_BEAM_ENDS = specs.TRUNK_REACH * np.array([[1.0], [-1.0]]) * [1.0, 0.0, 0.0]  # (2, 3) m, from the beams' middles
_BEAMS = np.array([[0.0, side * specs.TRUNK_LATERAL, 0.0] for side in (-1.0, 1.0)])  # (2, 3) m
_SMALLEST = 1e-12  # m2, and m4: keeps segments that are points, and parallel ones, from dividing by zero

_LEG_PAIRS = [(i, j) for i, j in itertools.combinations(range(12), 2) if i // 3 != j // 3]
_TRUNK_PAIRS = list(itertools.product(range(12), (12, 13)))
_PAIRS = np.array(_LEG_PAIRS + _TRUNK_PAIRS)  # of parts that may touch


class Clearance(NamedTuple):
    """The least distances between surfaces, m; below 0 they overlap by so much."""

    legs: Float[Any, "..."]  # of different legs
    trunk: Float[Any, "..."]  # of a leg and the trunk; mostly at the hip, where a thigh is always close

    @property
    def least(self) -> Float[Any, "..."]:
        """The lesser of both."""
        xp = self.legs.__array_namespace__()
        return xp.minimum(self.legs, self.trunk)


def clearance(
    joints: Float[Array, "... 4 3"], compression: Float[Array, "... 4"], hardware: HardwareSpec = IDEAL
) -> Clearance:
    """How close the closest two parts are, solid or not.

    Args:
        joints: rad, legs FR FL RR RL x (abad, hip, knee).
        compression: of each leg's spring, m.
        hardware: the robot, by its leg length and its tracks.
    """
    xp = joints.__array_namespace__()
    starts, ends = _segments(xp, joints, compression, hardware)
    first, second = _PAIRS[:, 0], _PAIRS[:, 1]
    apart = segment_distance(starts[..., first, :], ends[..., first, :], starts[..., second, :], ends[..., second, :])
    gaps = apart - xp.asarray(_RADII[_PAIRS].sum(axis=1), dtype=joints.dtype)
    between_legs = len(_LEG_PAIRS)
    return Clearance(xp.min(gaps[..., :between_legs], axis=-1), xp.min(gaps[..., between_legs:], axis=-1))


def segment_distance(
    p: Float[Array, "... 3"], p_end: Float[Array, "... 3"], q: Float[Array, "... 3"], q_end: Float[Array, "... 3"]
) -> Float[Array, "..."]:
    """Least distance between the points of two segments, either of which may be a point, m.

    The point of the first line that is nearest to the second, kept within its segment; then the point of the second
    that is nearest to that one, likewise; then again of the first (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    xp = p.__array_namespace__()
    along_p, along_q, between = p_end - p, q_end - q, p - q
    a, b, e = _dot(xp, along_p, along_p), _dot(xp, along_p, along_q), _dot(xp, along_q, along_q)
    c, f = _dot(xp, along_p, between), _dot(xp, along_q, between)
    s = xp.clip((b * f - c * e) / xp.maximum(a * e - b * b, _SMALLEST), 0.0, 1.0)
    t = xp.clip((b * s + f) / xp.maximum(e, _SMALLEST), 0.0, 1.0)
    s = xp.clip((b * t - c) / xp.maximum(a, _SMALLEST), 0.0, 1.0)
    gap = between + s[..., None] * along_p - t[..., None] * along_q
    return xp.sqrt(_dot(xp, gap, gap))


def _segments(
    xp: Any, joints: Float[Array, "... 4 3"], compression: Float[Array, "... 4"], hardware: HardwareSpec
) -> tuple[Float[Array, "... 14 3"], Float[Array, "... 14 3"]]:
    """Where every capsule's axis begins and ends, in the trunk frame, m."""
    abad, dtype = joints[..., 0], joints.dtype
    outwards = xp.asarray(SIDE * specs.THIGH_LATERAL, dtype=dtype)
    hips = xp.stack([xp.zeros_like(abad), outwards * xp.cos(abad), outwards * xp.sin(abad)], axis=-1)
    hips = hips + xp.asarray(leg_origins(hardware), dtype=dtype)
    knees = foot_position(joints, hardware.leg_length, hardware)  # what is left of a lower leg that is all compressed
    feet = foot_position(joints, compression + specs.FOOT_RADIUS, hardware)
    starts, ends = xp.stack([hips, knees, feet], axis=-2), xp.stack([knees, feet, feet], axis=-2)
    batch = joints.shape[:-2]

    def with_beams(legs: Array, end: int) -> Array:
        beams = xp.broadcast_to(xp.asarray(_BEAMS + _BEAM_ENDS[end], dtype=dtype), (*batch, 2, 3))
        return xp.concatenate([legs.reshape(*batch, 12, 3), beams], axis=-2)

    return with_beams(starts, 0), with_beams(ends, 1)


def _dot(xp: Any, u: Float[Array, "... 3"], v: Float[Array, "... 3"]) -> Float[Array, "..."]:
    return xp.sum(u * v, axis=-1)
