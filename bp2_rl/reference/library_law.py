"""The law of the collocation gait (see `library.trot`), for training and for a robot's own computer alike.

Functions take arrays of NumPy or JAX and import neither JAX nor jaxtyping; a command is ("... 3"): m/s forward, m/s to
the left, rad/s. Rates are derivatives by time; who asks says how those of the joints are taken.
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from bp2_rl.base.arrays import Array
from bp2_rl.base.polynomials import cubic_and_slope, hermite_and_rate
from bp2_rl.reference.stepping import TROT, ground, square_speed, turn
from bp2_rl.reference.trot_law import Differentiate
from bp2_rl.robot.anatomy import LegGeometry

TRUNK, COORDINATES = 3, 15  # of a row: x, height and pitch of the trunk; with three numbers a leg


class BlendedStride(NamedTuple):
    """A stride between two of the library's speeds."""

    rows: Any  # (..., 2) indices of the two speeds
    weights: Any  # (..., 2)
    speed: Any  # (...) m/s
    stance: Any  # (...) s
    half: Any  # (...) s, half a period
    middle: Any  # (..., 4) m, x of each foot's centre in mid-stance, from the trunk's centre


class BlendedPose(NamedTuple):
    """The library's motion at one time, or its rates."""

    x: Any  # (...) m
    height: Any  # (...) m
    pitch: Any  # (...) rad
    feet: Any  # (..., 4, 2) m, x and z of the feet's centres from the trunk's centre, level
    spring: Any  # (..., 4) m
    torque: Any  # (..., 4, 2) Nm


class LibraryMotion(NamedTuple):
    """The gait at a command and a phase."""

    joints: Any  # (..., 4, 3) rad
    joint_rates: Any  # (..., 4, 3) rad/s
    torque: Any  # (..., 4, 2) Nm, hip and knee
    stepping: Any  # (...) 0 when standing, 1 on the move
    stride: BlendedStride
    moment: BlendedPose
    rate: BlendedPose
    since_touchdown: Any  # (..., 4) s


@dataclasses.dataclass(frozen=True, eq=False)
class LibraryLaw:
    """A library of trots, on a robot's legs."""

    strides: Any  # (S, 5), speed (m/s), durations of stance and flight (s), x of fore and hind foot in mid-stance (m)
    cubics: Any  # (2, N, S, 4, 23), coefficients of the rows by the share of an interval, in two segments
    legs: LegGeometry
    straightest: Any  # (4), rad, each knee's angle at which the leg is the longest
    feet: Any  # (4, 3), m, centres of the standing feet from the trunk's centre
    sag: Any  # (4), m, of the springs in a stand
    torque: Any  # (4, 2), Nm, of hip and knee in a stand
    circle: float  # m, distance of the outermost foot from the trunk's centre
    stepping_speed: float  # m/s, below which steps shrink

    def phase_rate(self, command: Array) -> Any:
        """Cycles per second at this command."""
        return 0.5 / self.stride(command).half

    def forward(self, command: Array) -> Any:
        """Forward speed of the motion, m/s: that commanded, up to the library's greatest."""
        xp = command.__array_namespace__()
        return xp.minimum(command[..., 0], self.strides[-1, 0].astype(command.dtype))

    def stepping(self, command: Array) -> Any:
        """0 when standing, 1 from `stepping_speed` on, with a continuous derivative."""
        xp = command.__array_namespace__()
        y = xp.minimum(square_speed(command, self.circle) / self.stepping_speed**2, 1.0)
        return y * (2.0 - y)

    def stride(self, command: Array) -> BlendedStride:
        """Where the command lies between the library's speeds, and the stride there.

        The mean speed of motions blended with weights w is that of their strides' sums, (w_0 s_0 + w_1 s_1) /
        (w_0 T_0 + w_1 T_1) with s = u T: it is the one wanted, u, if w_1 / w_0 = T_0 (u - u_0) / T_1 (u_1 - u).
        """
        xp = command.__array_namespace__()
        strides = xp.asarray(self.strides, dtype=command.dtype)
        speed = xp.clip(command[..., 0], strides[0, 0], strides[-1, 0])
        row = xp.sum(strides[1:-1, 0] <= speed[..., None], axis=-1)
        rows = row[..., None] + xp.arange(2)
        ends = _at(strides, rows)
        half = ends[..., 1] + ends[..., 2]
        away = xp.stack([ends[..., 1, 0] - speed, speed - ends[..., 0, 0]], axis=-1) * half[..., ::-1]
        weights = away / xp.sum(away, axis=-1, keepdims=True)
        _, stance, flight, fore, hind = xp.moveaxis(xp.sum(weights[..., None] * ends, axis=-2), -1, 0)
        middle = xp.stack([fore, fore, hind, hind], axis=-1)
        return BlendedStride(rows, weights, speed, stance, stance + flight, middle)

    def motion(self, command: Array, phase: Array, differentiate: Differentiate) -> LibraryMotion:
        """The gait at this command and phase (cycles); `differentiate` takes the joints' rates."""
        xp, stride, stepping = command.__array_namespace__(), self.stride(command), self.stepping(command)
        cycle = phase - xp.floor(phase)
        mirrored = cycle >= 0.5
        since = (2.0 * cycle - mirrored) * stride.half  # s, since the last pair of feet landed
        moment, rate = self._sample(stride, since, mirrored)
        other_pair = mirrored[..., None] ^ xp.asarray(TROT > 0.0)
        since_touchdown = since[..., None] + xp.where(other_pair, stride.half[..., None], 0.0)
        displaced, displaced_rate = self._displacement(command, stride, stepping, since_touchdown)
        (q,), (qd,) = differentiate(
            lambda *moving: (self._joints(stepping, *moving),),
            (moment.feet, moment.spring, moment.pitch, displaced),
            (rate.feet, rate.spring, rate.pitch, displaced_rate),
        )
        torque = mix(stepping[..., None, None], self.torque, moment.torque)
        return LibraryMotion(q, qd, torque, stepping, stride, moment, rate, since_touchdown)

    def _sample(self, stride: BlendedStride, since: Any, mirrored: Any) -> tuple[BlendedPose, BlendedPose]:
        """The blended motion `since` seconds after a touchdown, and its rates, with left and right in their places."""
        xp = stride.middle.__array_namespace__()
        cubics = xp.asarray(self.cubics, dtype=since.dtype)
        intervals = cubics.shape[1]
        in_flight = since >= stride.stance
        duration = xp.where(in_flight, stride.half - stride.stance, stride.stance)
        position = xp.where(in_flight, since - stride.stance, since) / duration * intervals
        interval = xp.clip(position.astype(xp.int32), 0, intervals - 1)
        u = (position - interval)[..., None]
        ends = _at(cubics, (in_flight.astype(xp.int32)[..., None], interval[..., None], stride.rows))
        c = xp.sum(stride.weights[..., None, None] * ends, axis=-3)
        value, slope = cubic_and_slope(u, (c[..., 0, :], c[..., 1, :], c[..., 2, :], c[..., 3, :]))
        return _moment(value, mirrored), _moment(slope * (intervals / duration)[..., None], mirrored)

    def _displacement(
        self, command: Array, stride: BlendedStride, stepping: Any, since_touchdown: Array
    ) -> tuple[Any, Any]:
        """How far each foot is, seen from above, from where the library has it, m ("... 4 2"), and its rate.

        In stance, what the ground does beyond the library's speed; in the swing, the cubic that joins its ends.
        """
        xp = command.__array_namespace__()
        stand = xp.asarray(self.feet, dtype=since_touchdown.dtype)
        middle = xp.stack(
            [mix(stepping[..., None], stand[:, 0], stride.middle), xp.broadcast_to(stand[:, 1], stride.middle.shape)],
            axis=-1,
        )[..., None, :, :]
        v = xp.stack([self.forward(command), command[..., 1]], axis=-1)[..., None, :]
        omega, library_speed = command[..., None, 2:], (stepping * stride.speed)[..., None, None]

        stance, swing = stride.stance[..., None], (2.0 * stride.half - stride.stance)[..., None]
        in_stance = since_touchdown < stance
        half = xp.broadcast_to(stance / 2.0, since_touchdown.shape)
        tau = xp.stack([xp.where(in_stance, since_touchdown - half, 0.0), half, -half], axis=-2)
        there = turn(-omega * tau, middle) + ground(xp.zeros_like(stand[:, :2]), v, omega, tau)
        x, y = there[..., 0], there[..., 1]
        drift = xp.stack([x - middle[..., 0] + library_speed * tau, y - middle[..., 1]], axis=-1)
        drift_rate = xp.stack([library_speed - v[..., :1] + omega * y, -v[..., 1:] - omega * x], axis=-1)

        s = (since_touchdown - stance) / swing
        returning, returning_rate = hermite_and_rate(
            xp.where(in_stance, 0.0, s)[..., None],
            swing[..., None],
            *(drift[..., 1, :, :], drift[..., 2, :, :]),
            *(drift_rate[..., 1, :, :], drift_rate[..., 2, :, :]),
        )
        stays = in_stance[..., None]
        return (
            xp.where(stays, drift[..., 0, :, :], returning),
            xp.where(stays, drift_rate[..., 0, :, :], returning_rate),
        )

    def _joints(self, stepping: Any, feet: Array, spring: Any, pitch: Any, displaced: Array) -> Any:
        """Joint angles that put the feet between standing and the library's motion, and `displaced`, within reach."""
        xp = feet.__array_namespace__()
        x, z = feet[..., 0], feet[..., 1]
        at_rest = xp.asarray(self.feet, dtype=x.dtype)
        placed = xp.stack([x, xp.broadcast_to(at_rest[:, 1], x.shape), z], axis=-1)
        placed = mix(stepping[..., None, None], at_rest, placed)
        moved = xp.stack([displaced[..., 0], displaced[..., 1], xp.zeros_like(displaced[..., 0])], axis=-1)
        anyway, wanted = _from_level(xp.stack([placed, placed + moved]), stepping * pitch)
        radius = xp.asarray(self.legs.foot_radius, dtype=x.dtype)
        centre = mix(stepping[..., None], self.sag, spring) + radius  # short of the lower leg's end
        return self.legs.joint_angles(self._within_reach(anyway, wanted, centre), centre)

    def _within_reach(self, anyway: Array, wanted: Array, compression: Array) -> Any:
        """Feet displaced from `anyway` towards `wanted`, from the trunk's centre, with no knee beyond its range.

        A displacement that takes more than half of what is left of the reach gets the other half only by and by; so no
        leg straightens in a jerk. Legs that have no reach left keep their length.
        """
        xp, dtype = wanted.__array_namespace__(), wanted.dtype
        legs = self.legs.cast(xp, dtype)
        thigh, lower = legs.thigh, legs.lower - compression
        hip = xp.asarray(self.legs.hips, dtype=dtype)
        now, then = (xp.sqrt(xp.sum((feet - hip) ** 2, axis=-1)) for feet in (anyway, wanted))
        cosine = xp.asarray(np.cos(self.straightest), dtype=dtype)
        straight = thigh**2 + lower**2 + 2.0 * thigh * lower * cosine + legs.lateral**2
        half_left = xp.maximum((xp.sqrt(straight) - now) / 2.0, 1e-7)
        longer = then - now
        beyond = xp.maximum(longer - half_left, 0.0)
        reached = now + xp.minimum(longer, half_left) + half_left * (1.0 - xp.exp(-beyond / half_left))
        return hip + (reached / then)[..., None] * (wanted - hip)


def by_leg(coordinates: Any) -> Any:
    """(..., 12) -> (..., 4 legs, 3)."""
    return coordinates.reshape(*coordinates.shape[:-1], 4, 3)


def mirror(legs: Any) -> Any:
    """(..., 4 legs, n) with left and right in each other's place."""
    xp = legs.__array_namespace__()
    pairs = legs.reshape(*legs.shape[:-2], 2, 2, legs.shape[-1])
    return xp.flip(pairs, axis=-2).reshape(legs.shape)


def mix(share: Any, zero: Any, one: Array) -> Any:
    """From `zero` to `one`, in the precision of `one`."""
    zero = one.__array_namespace__().asarray(zero, dtype=one.dtype)
    return zero + share * (one - zero)


def _at(array: Any, where: Any) -> Any:
    """Entries of an array at indices that are within it, which JAX need not look at."""
    return array.at[where].get(mode="promise_in_bounds") if hasattr(array, "at") else array[where]


def _moment(values: Array, mirrored: Any) -> BlendedPose:
    """The parts of a row ("... 23")."""
    xp = values.__array_namespace__()

    def placed(legs: Any) -> Any:
        return xp.where(mirrored[..., None, None], mirror(legs), legs)

    legs = placed(by_leg(values[..., TRUNK:COORDINATES]))
    torque = placed(values[..., COORDINATES:].reshape(*values.shape[:-1], 4, 2))
    return BlendedPose(values[..., 0], values[..., 1], values[..., 2], legs[..., :2], legs[..., 2], torque)


def _from_level(p: Array, pitch: Any) -> Any:
    """p ("... 4 3"), of legs, from a level frame to one pitched by `pitch`, nose down."""
    xp = p.__array_namespace__()
    c, s = xp.cos(pitch)[..., None], xp.sin(pitch)[..., None]
    return xp.stack([c * p[..., 0] - s * p[..., 2], p[..., 1], c * p[..., 2] + s * p[..., 0]], axis=-1)
