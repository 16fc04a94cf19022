"""Reference motions played back without JAX: which joint angles and speeds belong to a command and a phase.

The laws are those of `bp2_rl.reference` for one robot. The library's trot is leg by leg in Python's own floats: for
numbers as few as these NumPy would be several times slower; its rates are by hand what forward differentiation makes of
them there. The kinematic trot is the very law of training. All numbers come from `reference.npz` and `deploy.json`.
"""

import math
from collections.abc import Mapping, Sequence
from math import atan2, cos, exp, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from bp2_rl.base.polynomials import hermite_and_rate
from bp2_rl.reference.trot_law import TrotLaw
from bp2_rl.robot.anatomy import LegGeometry

from .complex_step import differentiate

LATER = (True, False, False, True)  # the legs that land half a cycle after the others
IMAGE = (1, 0, 3, 2)  # each leg's mirror image
COSINE_LIMIT = 1.0 - 1e-6  # of a knee out of reach
LEAST_SQUARE = 1e-8  # m2, of a length that is divided by
LEAST_LEFT = 1e-7  # m, of reach
TRUNK, COORDINATES = 3, 15  # of a row of the table: trunk, then three a leg, then two torques a leg


class Pose(NamedTuple):
    """Joint angles, speeds and torques of the reference motion: FR, FL, RR, RL x abad, hip, knee."""

    position: np.ndarray  # (12) rad
    velocity: np.ndarray  # (12) rad/s
    torque: np.ndarray  # (12) Nm


def load_motion(settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> "Trot | KinematicTrot | Stand":
    """The motion that `deploy.json` describes in `reference`, of the arrays in `reference.npz`.

    Raises:
        ValueError: a motion of another kind.
    """
    kinds = {"collocation": Trot, "kinematic": KinematicTrot, "none": Stand}
    if settings["kind"] not in kinds:
        raise ValueError(f"reference motion {settings['kind']!r}: this controller plays {', '.join(kinds)}")
    return kinds[settings["kind"]](settings, arrays)


class Stand:
    """No gait: one pose, and a phase that goes round at one rate."""

    def __init__(self, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]):
        self._rate = float(settings["phase_rate"])
        self._pose = Pose(arrays["pose"].astype(float), np.zeros(12), np.zeros(12))

    def phase_rate(self, command: Sequence[float]) -> float:
        """Cycles per second."""
        return self._rate

    def stepping(self, command: Sequence[float]) -> float:
        """Return 1 for every command, as `bp2_rl.reference.standing` does."""
        return 1.0

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """Return the standing pose."""
        return self._pose


class KinematicTrot:
    """The kinematic trot of `bp2_rl.reference.trot_law`, whose numbers are those of the robot.

    Args:
        settings: `reference` of `deploy.json`: the law's numbers.
        arrays: the law's arrays, and those of `LegGeometry`.
    """

    def __init__(self, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]):
        legs = LegGeometry(**{name: arrays[name].astype(float) for name in LegGeometry._fields})
        own = {name: arrays[name].astype(float) for name in ("nominal", "sole_clearance")}
        self._law = TrotLaw(legs=legs, **own, **{name: x for name, x in settings.items() if name != "kind"})

    def phase_rate(self, command: Sequence[float]) -> float:
        """Cycles per second at this command (m/s forward, m/s to the left, rad/s)."""
        return float(self._law.phase_rate(np.array(command)))

    def stepping(self, command: Sequence[float]) -> float:
        """0 when standing, 1 on the move."""
        return float(self._law.stepping(np.array(command)))

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """The joints at this command and phase (cycles); the law knows no torques."""
        cycle = np.array(phase - math.floor(phase))
        q, qd, _, _ = self._law.joints(np.array(command), cycle, differentiate)
        return Pose(q.reshape(12), qd.reshape(12), np.zeros(12))


class _PlayedStride(NamedTuple):
    """A stride between two of the library's speeds."""

    row: int  # of the lower speed
    weights: tuple[float, float]
    speed: float  # m/s
    stance: float  # s
    half: float  # s, half a period
    middle: tuple[float, float, float, float]  # m, x of each foot in mid-stance


class _PlayedLengths(NamedTuple):
    """The numbers of a leg in `deploy.json`: lengths in m, angles in rad."""

    sag: float  # of the spring at rest
    thigh: float
    lower: float  # knee to the foot's centre, spring at rest
    lateral: float  # abduction axis to the leg's plane, to the left
    drop: float  # of the hip axis below the abduction axis
    bend: float  # sign of the knee's angle
    straight_knee: float  # at which the leg has no reach left


class _PlayedLeg(NamedTuple):
    """A leg of the library at one time, stepping as far as commanded: each a value and its rate."""

    x: tuple[float, float]  # m, of the foot, level, from the trunk's centre
    z: tuple[float, float]
    lower: tuple[float, float]  # m, knee to the foot's centre
    pitch: tuple[float, float]  # rad


class Trot:
    """A library of trots between its speeds and beyond them: `bp2_rl.reference.library.trot` says how.

    Args:
        settings: `reference` of `deploy.json`: lengths in m, speeds in m/s, angles in rad.
        arrays: `strides` (S 5), `cubics` (2 N S 4 23), `stand_feet` and `leg_origins` (4 3), `stand_torque` (4 2).
    """

    def __init__(self, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]):
        self._strides, self._cubics = arrays["strides"].astype(float).tolist(), arrays["cubics"].astype(float)
        self._rest, self._hips = arrays["stand_feet"].tolist(), arrays["leg_origins"].tolist()
        self._rest_torque = arrays["stand_torque"].astype(float)
        self._stepping_speed, self._foot_circle = settings["stepping_speed"], settings["foot_circle"]
        self._legs = [_PlayedLengths(**leg) for leg in settings["legs"]]

    def phase_rate(self, command: Sequence[float]) -> float:
        """Cycles per second at this command (m/s forward, m/s to the left, rad/s)."""
        return 0.5 / self._stride(command).half

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """The joints at this command and phase (cycles)."""
        stride, stepping = self._stride(command), self.stepping(command)
        cycle = phase - math.floor(phase)
        mirrored = cycle >= 0.5
        since = (2.0 * cycle - mirrored) * stride.half  # s, since the last pair of feet landed
        row, rates = self._sample(stride, since)
        value, rate = row.tolist(), rates.tolist()
        pitch = stepping * value[2], stepping * rate[2]
        q, qd = np.empty((4, 3)), np.empty((4, 3))
        for leg in range(4):
            at = TRUNK + 3 * (IMAGE[leg] if mirrored else leg)
            rest_x, _, rest_z = self._rest[leg]
            sag = self._legs[leg].sag
            spring = sag + stepping * (value[at + 2] - sag)
            moment = _PlayedLeg(
                x=(rest_x + stepping * (value[at] - rest_x), stepping * rate[at]),
                z=(rest_z + stepping * (value[at + 1] - rest_z), stepping * rate[at + 1]),
                lower=(self._legs[leg].lower - spring, -stepping * rate[at + 2]),
                pitch=pitch,
            )
            since_touchdown = since + stride.half if LATER[leg] != mirrored else since
            displaced = self._displacement(leg, command, stride, stepping, since_touchdown)
            q[leg], qd[leg] = self._joints(leg, moment, *displaced)
        torque = row[COORDINATES:].reshape(4, 2)
        torque = self._rest_torque + stepping * ((torque[list(IMAGE)] if mirrored else torque) - self._rest_torque)
        feedforward = np.concatenate([np.zeros((4, 1)), torque], axis=1)
        return Pose(q.reshape(12), qd.reshape(12), feedforward.reshape(12))

    def stepping(self, command: Sequence[float]) -> float:
        """0 when standing, 1 from the stepping speed on."""
        vx, vy, omega = command
        y = min((vx**2 + vy**2 + (self._foot_circle * omega) ** 2) / self._stepping_speed**2, 1.0)
        return y * (2.0 - y)

    def _stride(self, command: Sequence[float]) -> _PlayedStride:
        """Where the command lies between the library's speeds; the weights make the mean speed the one commanded."""
        strides = self._strides
        speed = min(max(command[0], strides[0][0]), strides[-1][0])
        row = 0
        while row < len(strides) - 2 and strides[row + 1][0] <= speed:
            row += 1
        below, above = strides[row], strides[row + 1]
        away = (above[0] - speed) * (above[1] + above[2]), (speed - below[0]) * (below[1] + below[2])
        a, b = away[0] / (away[0] + away[1]), away[1] / (away[0] + away[1])
        stance, flight, fore, hind = (a * low + b * high for low, high in zip(below[1:], above[1:], strict=True))
        return _PlayedStride(row, (a, b), speed, stance, stance + flight, (fore, fore, hind, hind))

    def _sample(self, stride: _PlayedStride, since: float) -> tuple[np.ndarray, np.ndarray]:
        """The library's row of 23 so many seconds after a touchdown of FL and RR, and its rate."""
        in_flight = since >= stride.stance
        duration = stride.half - stride.stance if in_flight else stride.stance
        intervals = self._cubics.shape[1]
        position = (since - stride.stance if in_flight else since) / duration * intervals
        interval = min(max(int(position), 0), intervals - 1)
        u = position - interval
        ends = self._cubics[int(in_flight), interval, stride.row : stride.row + 2]
        c = stride.weights[0] * ends[0] + stride.weights[1] * ends[1]
        value = c[0] + u * (c[1] + u * (c[2] + u * c[3]))
        slope = c[1] + u * (2.0 * c[2] + u * 3.0 * c[3])
        return value, slope * (intervals / duration)

    def _displacement(
        self, leg: int, command: Sequence[float], stride: _PlayedStride, stepping: float, since: float
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """How far a foot is, seen from above, from where the library has it, (x, y) in m, and the rates.

        In stance, what the ground does beyond the library's speed; in the swing, the cubic that joins its ends.
        """
        vx, vy, omega = min(command[0], self._strides[-1][0]), command[1], command[2]
        library = stepping * stride.speed
        x0, y0 = self._rest[leg][0] + stepping * (stride.middle[leg] - self._rest[leg][0]), self._rest[leg][1]

        def drift(tau: float) -> tuple[float, float, float, float]:
            x, y = _ground(x0, y0, vx, vy, omega, tau)
            return x - x0 + library * tau, y - y0, library - vx + omega * y, -vy - omega * x

        if since < stride.stance:
            x, y, x_rate, y_rate = drift(since - stride.stance / 2.0)
            return (x, y), (x_rate, y_rate)
        time = 2.0 * stride.half - stride.stance
        s = (since - stride.stance) / time
        left, right = drift(stride.stance / 2.0), drift(-stride.stance / 2.0)
        x, x_rate = hermite_and_rate(s, time, left[0], right[0], left[2], right[2])
        y, y_rate = hermite_and_rate(s, time, left[1], right[1], left[3], right[3])
        return (x, y), (x_rate, y_rate)

    def _joints(
        self, leg: int, moment: _PlayedLeg, displaced: tuple[float, float], displaced_rate: tuple[float, float]
    ) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """(abad, hip, knee) that put a foot where the library has it and `displaced`, within reach; and their speeds.

        A displacement that takes more than half of what is left of the reach gets the other half only by and by.
        """
        (x, vx), (z, vz), (lower, lower_rate), (pitch, pitch_rate) = moment
        c, s, y, hip, lengths = cos(pitch), sin(pitch), self._rest[leg][1], self._hips[leg], self._legs[leg]
        thigh, extended = lengths.thigh, cos(lengths.straight_knee)

        def from_hip(x: float, y: float, vx: float, vy: float) -> tuple[float, ...]:
            """The foot in the pitched trunk's frame from its hip: position, rate; distance, rate."""
            along, up = c * x - s * z, c * z + s * x
            p, q, r = along - hip[0], y - hip[1], up - hip[2] + lengths.drop
            vp, vr = c * vx - s * vz - pitch_rate * up, c * vz + s * vx + pitch_rate * along
            distance = sqrt(p * p + q * q + r * r)
            return p, q, r, vp, vy, vr, distance, (p * vp + q * vy + r * vr) / distance

        *_, now, now_rate = from_hip(x, y, vx, 0.0)
        p, q, r, vp, vq, vr, then, then_rate = from_hip(
            x + displaced[0], y + displaced[1], vx + displaced_rate[0], displaced_rate[1]
        )
        straight = sqrt(thigh**2 + lower**2 + 2.0 * thigh * lower * extended + lengths.lateral**2)
        left = (straight - now) / 2.0  # half of it
        left_rate = ((lower + thigh * extended) * lower_rate / straight - now_rate) / 2.0
        if left < LEAST_LEFT:
            left, left_rate = LEAST_LEFT, 0.0
        beyond = then - now - left
        if beyond > 0.0:
            e = exp(-beyond / left)
            reached = now + left + left * (1.0 - e)
            beyond_rate = then_rate - now_rate - left_rate
            reached_rate = now_rate + left_rate * (2.0 - e) + e * (beyond_rate - beyond / left * left_rate)
            share = reached / then
            share_rate = (reached_rate - share * then_rate) / then
            vp, vq, vr = share * vp + share_rate * p, share * vq + share_rate * q, share * vr + share_rate * r
            p, q, r = share * p, share * q, share * r
        return _angles((p, q, r - lengths.drop), (vp, vq, vr), lower, lower_rate, lengths)


def _angles(
    foot: tuple[float, float, float],
    foot_rate: tuple[float, float, float],
    lower: float,
    lower_rate: float,
    leg: _PlayedLengths,
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The joints of a leg whose foot is there, seen from its abduction axis, and their speeds.

    `bp2_rl.robot.kinematics.joint_angles`, with rates.
    """
    (x, y, z), (vx, vy, vz), d, thigh = foot, foot_rate, leg.lateral, leg.thigh
    square = y * y + z * z - d * d
    h = sqrt(max(square, LEAST_SQUARE))
    vh = (y * vy + z * vz) / h if square > LEAST_SQUARE else 0.0
    abad, abad_rate = _angle(d * z + h * y, d * y - h * z, d * vz + vh * y + h * vy, d * vy - vh * z - h * vz)
    h -= leg.drop
    cosine = (x * x + h * h - thigh**2 - lower * lower) / (2.0 * thigh * lower)
    rate = (x * vx + h * vh - lower * lower_rate) / (thigh * lower) - cosine * lower_rate / lower
    if abs(cosine) > COSINE_LIMIT:
        cosine, rate = math.copysign(COSINE_LIMIT, cosine), 0.0
    sine = leg.bend * sqrt(1.0 - cosine * cosine)
    sine_rate = -cosine * rate / sine
    forward, forward_rate = _angle(-x, h, -vx, vh)
    bent, bent_rate = _angle(
        lower * sine,
        thigh + lower * cosine,
        lower_rate * sine + lower * sine_rate,
        lower_rate * cosine + lower * rate,
    )
    return (abad, forward - bent, atan2(sine, cosine)), (abad_rate, forward_rate - bent_rate, -rate / sine)


def _angle(y: float, x: float, y_rate: float, x_rate: float) -> tuple[float, float]:
    """The direction of (x, y), rad, and how it turns."""
    return atan2(y, x), (y_rate * x - y * x_rate) / (x * x + y * y)


def _ground(x: float, y: float, vx: float, vy: float, omega: float, tau: float) -> tuple[float, float]:
    """Where a point of the ground is, seen from the trunk, `tau` seconds after it was at (x, y)."""
    half = omega * tau / 2.0
    square = half * half
    chord = tau * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)))  # tau sinc(half)
    c, s, c2, s2 = cos(half), sin(half), cos(2.0 * half), sin(2.0 * half)
    return c2 * x + s2 * y - chord * (c * vx + s * vy), c2 * y - s2 * x - chord * (c * vy - s * vx)
