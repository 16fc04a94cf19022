"""Play reference motions without JAX: joint angles and speeds as functions of command
and gait phase.

The laws are those of `bp2_rl.reference` for one robot. The library's trot is leg by leg
in Python's own numbers, for which NumPy would be several times slower. The kinematic
trot is the very law of training. All numbers come from `reference.npz` and
`deploy.json`.

Time is complex: the imaginary part of a value carries its rate through every operation
(Squire and Trapp, "Using complex variables to estimate derivatives of real functions",
SIAM Review 40, 1998). The rates are exact to rounding, as no numbers that are alike are
subtracted. Comparisons are by the real part.
"""

import math
from cmath import cos, exp, sin, sqrt
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from bp2_rl.base.arrays import hermite_and_rate
from bp2_rl.base.files import ArraySpec
from bp2_rl.reference.stepping import TROT
from bp2_rl.reference.trot_law import TrotLaw
from bp2_rl.robot.anatomy import COSINE_MARGIN, SHORTEST_SQUARED, LegGeometry
from bp2_rl.robot.conventions import MIRRORED as IMAGE

from .contents import Settings

LATER = (TROT > 0.0).tolist()  # the legs that land half a cycle after the others
STEP = 1e-50  # s, imaginary; its square is nothing beside 1
COSINE_LIMIT = 1.0 - COSINE_MARGIN  # of a knee out of reach
LEAST_LEFT = 1e-7  # m, of reach
# of a row of the table: trunk, then three a leg, then two torques a leg
TRUNK, COORDINATES = 3, 15


LARGEST = 1e5
"""Largest absolute number allowed in `reference.npz`, enough for torques in Nm."""
SHAPES: Mapping[str, Mapping[str, tuple[int | str, ...]]] = {
    "collocation": {
        "strides": ("S", 5),
        "cubics": (2, "N", "S", 4, 23),
        "stand_feet": (4, 3),
        "leg_origins": (4, 3),
        "stand_torque": (4, 2),
    },
    "kinematic": dict.fromkeys(LegGeometry._fields, (4,))
    | {"origins": (4, 3), "nominal": (4, 2), "sole_clearance": (4,)},
    "none": {"pose": (12,)},
}
"""Shapes of the arrays in `reference.npz` for each kind of reference motion."""


class Pose(NamedTuple):
    """Joint angles, speeds and torques of the reference motion: FR, FL, RR, RL x abad,
    hip, knee."""

    position: np.ndarray  # (12) rad
    velocity: np.ndarray  # (12) rad/s
    torque: np.ndarray  # (12) Nm


def specs_of(settings: Settings) -> dict[str, ArraySpec]:
    """Return types and shapes of the arrays in `reference.npz` for a motion described
    in `deploy.json`."""
    return {
        name: ArraySpec(np.floating, shape)
        for name, shape in SHAPES.get(settings["kind"], {}).items()
    }


def load_motion(
    settings: Settings, arrays: Mapping[str, np.ndarray]
) -> "Trot | KinematicTrot | Stand":
    """Return the reference motion described in `deploy.json`, from the arrays of
    `reference.npz`.

    Raises:
        ValueError: a motion of another kind, or a number that no motion has.
    """
    kinds = {"collocation": Trot, "kinematic": KinematicTrot, "none": Stand}
    if settings["kind"] not in kinds:
        raise ValueError(
            f"reference motion {settings['kind']!r}: this controller plays {', '.join(kinds)}"
        )
    for name, array in arrays.items():
        if not np.all(np.abs(array) <= LARGEST):  # nor is NaN
            raise ValueError(
                f"reference.npz: {name} holds numbers that are not finite, or beyond {LARGEST:g}"
            )
    return kinds[settings["kind"]](settings, arrays)


class Stand:
    """A reference motion without a gait: one standing pose, and a phase of constant
    rate."""

    def __init__(self, settings: Settings, arrays: Mapping[str, np.ndarray]):
        self._rate = float(settings["phase_rate"])
        self._pose = Pose(arrays["pose"].astype(float), np.zeros(12), np.zeros(12))

    def phase_rate(self, command: Sequence[float]) -> float:
        """Return the phase's rate, cycles per second, the same for every command."""
        return self._rate

    def stepping(self, command: Sequence[float]) -> float:
        """Return 1 for every command, as `bp2_rl.reference.kinematic_trot` does."""
        return 1.0

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """Return the standing pose."""
        return self._pose


class KinematicTrot:
    """Plays the kinematic trot, by the equations of `reference.trot_law` that training
    also uses.

    Args:
        settings: `reference` of `deploy.json`: the law's numbers.
        arrays: the law's arrays, and those of `LegGeometry`.
    """

    def __init__(self, settings: Settings, arrays: Mapping[str, np.ndarray]):
        legs = LegGeometry(
            **{name: arrays[name].astype(float) for name in LegGeometry._fields}
        )
        own = {
            name: arrays[name].astype(float) for name in ("nominal", "sole_clearance")
        }
        self._law = TrotLaw(
            legs=legs,
            **own,
            **{name: x for name, x in settings.items() if name != "kind"},
        )

    def phase_rate(self, command: Sequence[float]) -> float:
        """Return the gait's frequency, cycles per second, at a command (m/s forward,
        m/s left, rad/s)."""
        return float(self._law.phase_rate(np.array(command)))

    def stepping(self, command: Sequence[float]) -> float:
        """Return the share of full steps at a command: 0 when standing, 1 on the
        move."""
        return float(self._law.stepping(np.array(command)))

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """Return joint angles and speeds at a command and gait phase (cycles); torques
        are 0."""
        cycle = np.array(phase - math.floor(phase))
        q, qd, _, _ = self._law.joints(np.array(command), cycle, differentiate)
        return Pose(q.reshape(12), qd.reshape(12), np.zeros(12))


class _PlayedStride(NamedTuple):
    """A stride interpolated between two speeds of the library."""

    row: int  # of the lower speed
    weights: tuple[float, float]
    speed: float  # m/s
    stance: float  # s
    half: float  # s, half a period
    middle: tuple[float, float, float, float]  # m, x of each foot in mid-stance


class _PlayedLengths(NamedTuple):
    """The dimensions of a leg in `deploy.json`: lengths in m, angles in rad."""

    sag: float  # of the spring at rest
    thigh: float
    lower: float  # knee to the foot's centre, spring at rest
    lateral: float  # abduction axis to the leg's plane, to the left
    drop: float  # of the hip axis below the abduction axis
    bend: float  # sign of the knee's angle
    straight_knee: float  # at which the leg has no reach left


class Trot:
    """Plays the library of trots at any command, also between and beyond its speeds, as
    `bp2_rl.reference.library.trot` does.

    Args:
        settings: `reference` of `deploy.json`: lengths in m, speeds in m/s, angles in
            rad.
        arrays: `strides` (S 5), `cubics` (2 N S 4 23), `stand_feet` and `leg_origins`
            (4 3), `stand_torque` (4 2).
    """

    def __init__(self, settings: Settings, arrays: Mapping[str, np.ndarray]):
        self._strides = arrays["strides"].astype(float).tolist()
        self._cubics = arrays["cubics"].astype(float)
        self._rest = arrays["stand_feet"].tolist()
        self._hips = arrays["leg_origins"].tolist()
        self._rest_torque = arrays["stand_torque"].astype(float)
        self._stepping_speed = settings["stepping_speed"]
        self._foot_circle = settings["foot_circle"]
        self._legs = [
            _PlayedLengths(**leg)
            for leg, _ in zip(settings["legs"], LATER, strict=True)
        ]

    def phase_rate(self, command: Sequence[float]) -> float:
        """Return the gait's frequency, cycles per second, at a command (m/s forward,
        m/s left, rad/s)."""
        return 0.5 / self._stride(command).half

    def __call__(self, command: Sequence[float], phase: float) -> Pose:
        """Return joint angles, speeds and torques at a command and gait phase
        (cycles)."""
        stride, stepping = self._stride(command), self.stepping(command)
        cycle = phase - math.floor(phase)
        mirrored = cycle >= 0.5
        # s, since the last pair of feet landed
        now = complex((2.0 * cycle - mirrored) * stride.half, STEP)
        row = self._sample(stride, now)
        value = row.tolist()
        q = np.empty((4, 3), complex)
        for leg, lengths in enumerate(self._legs):
            at = TRUNK + 3 * (IMAGE[leg] if mirrored else leg)
            x, z, spring = (
                rest + stepping * (moved - rest)
                for rest, moved in zip(
                    (*self._rest[leg][::2], lengths.sag),
                    value[at : at + 3],
                    strict=True,
                )
            )
            moved_x, moved_y = self._displacement(
                leg,
                command,
                stride,
                stepping,
                now + stride.half if LATER[leg] != mirrored else now,
            )
            feet = (
                (x, self._rest[leg][1], z),
                (x + moved_x, self._rest[leg][1] + moved_y, z),
            )
            q[leg] = self._joints(
                leg, feet, lengths.lower - spring, stepping * value[2]
            )
        torque = np.real(row[COORDINATES:]).reshape(4, 2)
        torque = self._rest_torque + stepping * (
            (torque[list(IMAGE)] if mirrored else torque) - self._rest_torque
        )
        feedforward = np.concatenate([np.zeros((4, 1)), torque], axis=1)
        return Pose(
            np.real(q).reshape(12),
            np.imag(q).reshape(12) / STEP,
            feedforward.reshape(12),
        )

    def stepping(self, command: Sequence[float]) -> float:
        """Return the share of full steps at a command: 0 when standing, 1 from the
        stepping speed on."""
        vx, vy, omega = command
        y = min(
            (vx**2 + vy**2 + (self._foot_circle * omega) ** 2)
            / self._stepping_speed**2,
            1.0,
        )
        return y * (2.0 - y)

    def _stride(self, command: Sequence[float]) -> _PlayedStride:
        """Return the stride at a command, interpolated between the library's speeds to
        the commanded one."""
        strides = self._strides
        speed = min(max(command[0], strides[0][0]), strides[-1][0])
        row = 0
        while row < len(strides) - 2 and strides[row + 1][0] <= speed:
            row += 1
        below, above = strides[row], strides[row + 1]
        away = (
            (above[0] - speed) * (above[1] + above[2]),
            (speed - below[0]) * (below[1] + below[2]),
        )
        a, b = away[0] / (away[0] + away[1]), away[1] / (away[0] + away[1])
        stance, flight, fore, hind = (
            a * low + b * high for low, high in zip(below[1:], above[1:], strict=True)
        )
        return _PlayedStride(
            row, (a, b), speed, stance, stance + flight, (fore, fore, hind, hind)
        )

    def _sample(self, stride: _PlayedStride, since: complex) -> np.ndarray:
        """Return the library's row of 23 numbers at a time (s) after the touchdown of
        FL and RR."""
        in_flight = since.real >= stride.stance
        duration = stride.half - stride.stance if in_flight else stride.stance
        intervals = self._cubics.shape[1]
        position = (
            (since - stride.stance if in_flight else since) / duration * intervals
        )
        interval = min(max(int(position.real), 0), intervals - 1)
        u = position - interval
        ends = self._cubics[int(in_flight), interval, stride.row : stride.row + 2]
        c = stride.weights[0] * ends[0] + stride.weights[1] * ends[1]
        return c[0] + u * (c[1] + u * (c[2] + u * c[3]))

    def _displacement(
        self,
        leg: int,
        command: Sequence[float],
        stride: _PlayedStride,
        stepping: float,
        since: complex,
    ) -> tuple[complex, complex]:
        """Return the horizontal displacement of a foot from its place in the library,
        (x, y) in m.

        In stance, what the ground does beyond the library's speed; in the swing, the
        cubic that joins its ends.
        """
        vx, vy, omega = min(command[0], self._strides[-1][0]), command[1], command[2]
        library = stepping * stride.speed
        x0 = self._rest[leg][0] + stepping * (stride.middle[leg] - self._rest[leg][0])
        y0 = self._rest[leg][1]

        def drift(tau: complex) -> tuple[complex, complex]:
            x, y = _ground(x0, y0, vx, vy, omega, tau)
            return x - x0 + library * tau, y - y0

        half = stride.stance / 2.0
        if since.real < stride.stance:
            return drift(since - half)
        time = 2.0 * (stride.half - half)
        s = (since - stride.stance) / time
        ends = zip(drift(half + STEP * 1j), drift(-half + STEP * 1j), strict=True)
        x, y = (
            hermite_and_rate(s, time, a.real, b.real, a.imag / STEP, b.imag / STEP)[0]
            for a, b in ends
        )
        return x, y

    def _joints(
        self,
        leg: int,
        feet: Sequence[tuple[complex, complex, complex]],
        lower: complex,
        pitch: complex,
    ) -> tuple[complex, complex, complex]:
        """Return (abad, hip, knee), rad, that put a foot at its displaced position,
        kept within reach.

        A displacement that takes more than half of what is left of the reach gets the
        other half only by and by.
        """
        c, s, hip, lengths = cos(pitch), sin(pitch), self._hips[leg], self._legs[leg]
        thigh, extended = lengths.thigh, math.cos(lengths.straight_knee)
        # From the hip, in the pitched trunk's frame.
        (*_, now), (x, y, z, then) = (
            (px, py, pz, sqrt(px * px + py * py + pz * pz))
            for px, py, pz in (
                (
                    c * x - s * z - hip[0],
                    y - hip[1],
                    c * z + s * x - hip[2] + lengths.drop,
                )
                for x, y, z in feet
            )
        )
        straight = sqrt(
            thigh**2 + lower**2 + 2.0 * thigh * lower * extended + lengths.lateral**2
        )
        left = (straight - now) / 2.0  # half of it
        if left.real < LEAST_LEFT:
            left = complex(LEAST_LEFT)
        beyond = then - now - left
        if beyond.real > 0.0:
            share = (now + left + left * (1.0 - exp(-beyond / left))) / then
            x, y, z = share * x, share * y, share * z
        return _angles(x, y, z - lengths.drop, lower, lengths)


def _angles(
    x: complex, y: complex, z: complex, lower: complex, leg: _PlayedLengths
) -> tuple[complex, complex, complex]:
    """Return a leg's joint angles, rad, for a foot position relative to its abduction
    axis, as `LegGeometry.joint_angles`."""
    d, thigh = leg.lateral, leg.thigh
    square = y * y + z * z - d * d
    h = sqrt(square if square.real > SHORTEST_SQUARED else SHORTEST_SQUARED)
    abad = _angle(d * z + h * y, d * y - h * z)
    h -= leg.drop
    cosine = (x * x + h * h - thigh**2 - lower * lower) / (2.0 * thigh * lower)
    if abs(cosine.real) > COSINE_LIMIT:
        cosine = complex(math.copysign(COSINE_LIMIT, cosine.real))
    sine = leg.bend * sqrt(1.0 - cosine * cosine)
    return (
        abad,
        _angle(-x, h) - _angle(lower * sine, thigh + lower * cosine),
        _angle(sine, cosine),
    )


def _angle(y: complex, x: complex) -> complex:
    """Return the direction of (x, y), rad, with its rate as the imaginary part."""
    turning = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    return complex(math.atan2(y.real, x.real), turning)


def _ground(
    x: float, y: float, vx: float, vy: float, omega: float, tau: complex
) -> tuple[complex, complex]:
    """Return the position of a ground point in the moving trunk's frame, `tau` seconds
    after it was at (x, y)."""
    half = omega * tau / 2.0
    square = half * half
    # tau sinc(half)
    chord = tau * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)))
    c, s, c2, s2 = cos(half), sin(half), cos(2.0 * half), sin(2.0 * half)
    return c2 * x + s2 * y - chord * (c * vx + s * vy), c2 * y - s2 * x - chord * (
        c * vy - s * vx
    )


# --- Rates of functions of NumPy's arrays ---------------------------------------------


def _atan2(y: Any, x: Any) -> Any:
    """Return the direction of (x, y), rad, for complex-step numbers, which NumPy's
    arctan2 does not take."""
    a, b = x.real, y.real
    return np.arctan2(b, a) + (y * a - x * b) / (a * a + b * b)


FUNCTIONS = SimpleNamespace(**vars(np) | {"atan2": _atan2})


class _ComplexStep(np.ndarray):
    """An array of complex-step numbers: values as real parts, rates as imaginary
    parts."""

    @property
    def __array_priority__(self) -> float:
        """Priority by which results with other arrays keep this class."""
        return 1.0

    def __array_namespace__(self, *, api_version: str | None = None) -> Any:
        del api_version
        return FUNCTIONS


def differentiate(
    function: Callable[..., tuple[np.ndarray, ...]],
    values: tuple[np.ndarray, ...],
    rates: tuple[np.ndarray, ...],
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Return a function's values, and their rates for given rates of its arguments, as
    `jax.jvp` does.

    The function takes its own functions from the `__array_namespace__()` of its
    arguments.
    """
    steps = (
        (value + 1j * STEP * rate).view(_ComplexStep)
        for value, rate in zip(values, rates, strict=True)
    )
    found: list[Any] = [np.asarray(result) for result in function(*steps)]
    return tuple(result.real for result in found), tuple(
        result.imag / STEP for result in found
    )
