"""Distances between the legs, and between the legs and the trunk, in closed form.

A leg is a thigh (hip to knee), a lower leg (knee to the foot's centre) and a foot, the
trunk two beams: all of them points at most a radius away from a segment. They are the
capsules of solid legs in the MuJoCo model, where shank and toe slide into each other
and are one lower leg. NumPy and JAX alike, batched over leading axes, in the caller's
precision.
"""

import itertools
from types import ModuleType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import Array
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.robot.kinematics import foot_position

# the legs of each pair
_FIRST, _SECOND = np.array(list(itertools.combinations(range(4), 2))).T
# m2, and m4: keeps segments that are points, and parallel ones, from dividing by zero
_SMALLEST = 1e-12


class Clearance(NamedTuple):
    """Least distances between the surfaces of legs and of leg and trunk, m; negative
    ones are overlaps."""

    legs: Float[Array, "..."]  # of different legs
    # of a leg and the trunk; mostly at the hip, where a thigh is always close
    trunk: Float[Array, "..."]

    @property
    def least(self) -> Float[Array, "..."]:
        """The lesser of the two distances, m."""
        xp = self.legs.__array_namespace__()
        return xp.minimum(self.legs, self.trunk)


def clearance(
    joints: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"],
    hardware: HardwareSpec = IDEAL,
) -> Clearance:
    """Return the least distances between legs, and between legs and trunk, in a pose,
    whether legs are solid or not.

    Args:
        joints: rad, legs FR FL RR RL x (abad, hip, knee).
        compression: of each leg's spring, m.
        hardware: the robot, by its leg length and its tracks.
    """
    xp, dtype = joints.__array_namespace__(), joints.dtype
    starts, ends = _segments(xp, joints, compression, hardware)
    anatomy = hardware.anatomy
    thickness, reach, lateral = anatomy.beams
    radii = np.stack(
        [
            np.full(4, anatomy.thigh_radius),
            np.full(4, anatomy.lower_radius),
            anatomy.geometry.foot_radius,
        ]
    )
    beam = np.array([[reach, -lateral, 0.0], [reach, lateral, 0.0]])
    beams = [
        xp.asarray(x.T.reshape(3, *[1] * joints.ndim, 2), dtype)
        for x in (beam, beam * [-1.0, 1.0, 1.0])
    ]
    between_legs = segment_distance(
        *(x[..., _FIRST, :, None] for x in (starts, ends)),
        *(x[..., _SECOND, None, :] for x in (starts, ends)),
    )
    to_beams = segment_distance(starts[..., None], ends[..., None], *beams)
    legs = between_legs - xp.asarray(
        (radii[:, None, _FIRST] + radii[None, :, _SECOND]).transpose(2, 0, 1), dtype
    )
    trunk = to_beams - xp.asarray(radii.T[:, :, None] + thickness, dtype)
    return Clearance(xp.min(legs, axis=(-3, -2, -1)), xp.min(trunk, axis=(-3, -2, -1)))


def segment_distance(
    p: Float[Array, "3 ..."],
    p_end: Float[Array, "3 ..."],
    q: Float[Array, "3 ..."],
    q_end: Float[Array, "3 ..."],
) -> Float[Array, "..."]:
    """Return the least distance between two segments, m, either of which may be a
    point; coordinates are the first axis.

    Take the point of the first line that is nearest to the second line, then the point
    of the second that is nearest to it, then again of the first, each kept within its
    segment (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    xp = p.__array_namespace__()
    along_p, along_q, between = p_end - p, q_end - q, p - q
    a, b, e = _dot(along_p, along_p), _dot(along_p, along_q), _dot(along_q, along_q)
    c, f = _dot(along_p, between), _dot(along_q, between)
    s = xp.clip((b * f - c * e) / xp.maximum(a * e - b * b, _SMALLEST), 0.0, 1.0)
    t = xp.clip((b * s + f) / xp.maximum(e, _SMALLEST), 0.0, 1.0)
    s = xp.clip((b * t - c) / xp.maximum(a, _SMALLEST), 0.0, 1.0)
    gap = between + s * along_p - t * along_q
    return xp.sqrt(_dot(gap, gap))


def _segments(
    xp: ModuleType,
    joints: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"],
    hardware: HardwareSpec,
) -> tuple[Float[Array, "3 ... 4 3"], Float[Array, "3 ... 4 3"]]:
    """Return start and end of thigh, lower leg and foot in the trunk frame, m;
    coordinates are the first axis."""
    geometry = hardware.anatomy.geometry.cast(xp, joints.dtype)
    abad, outwards, drop = joints[..., 0], geometry.lateral, geometry.drop
    cos, sin = xp.cos(abad), xp.sin(abad)
    hips = xp.stack(
        [xp.zeros_like(abad), outwards * cos + drop * sin, outwards * sin - drop * cos],
        axis=-1,
    )
    hips = hips + geometry.origins
    # a lower leg without length ends there
    knees = foot_position(joints, geometry.lower, hardware)
    feet = foot_position(joints, compression + geometry.foot_radius, hardware)
    starts = xp.stack([hips, knees, feet], axis=-2)
    ends = xp.stack([knees, feet, feet], axis=-2)
    return xp.moveaxis(starts, -1, 0), xp.moveaxis(ends, -1, 0)


def _dot(u: Float[Array, "3 ..."], v: Float[Array, "3 ..."]) -> Float[Array, "..."]:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
