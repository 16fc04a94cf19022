"""The collocation library: trot trajectories over a range of speeds, found by `bp2_rl.trajopt`, as a reference motion.

A library holds, for every speed, half a gait cycle: stance of FL and RR, then flight; left and right then change
places. Between its points the coordinates are the cubics through their values and rates, and torques are straight
lines. Between its speeds everything is blended at equal shares of a segment, so that touchdowns and lift-offs meet,
with weights that make the mean speed exactly the one commanded. Velocities jump at touchdown: that is the impact.

Beyond the library's greatest speed its motion stays what it is there. Below the least speed, backwards, sideways and
turning, the motion is that of the nearest speed with every foot displaced by what the ground moves otherwise in its
stance: p' = -v - omega x p, measured from mid-stance; a cubic brings the foot back during the swing. Around standing
still, steps shrink to nothing. All this happens to the centres of the spherical feet, with the trunk's pitch taken
out, so that no foot leaves the ground or enters it; only a leg that is all but straight cannot follow and stays above
it. Torques are those of straight running.
"""

import dataclasses
import functools
import hashlib
import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from bp2_rl.assets import asset_path
from bp2_rl.bounds import Within, check_bounds
from bp2_rl.errors import UserError
from bp2_rl.gait.kinematic import STANDING, TROT, _ground, _square_speed, _turn
from bp2_rl.gait.reference import Reference
from bp2_rl.robot import kinematics, specs

FORMAT = 1
SHIPPED = "reference_motions/bp2_trot.npz"  # below assets/
MEND = "make it anew with `bp2 trajopt library build`"

TRUNK, COORDINATES = 3, 15  # x, z, pitch; these and hip, knee and spring of each leg
STANDING_PAIR = np.array([1, 2])  # FL, RR: on the ground in the first segment
PERIODIC = 1e-4  # m or rad, by which segments may fail to join
ON_GROUND = 0.01  # m, by which a standing foot may miss the ground: legs 2 % longer than the library's miss it by more


@dataclasses.dataclass(frozen=True, eq=False)
class MotionLibrary:
    """Trajectories of S speeds, each of two segments (stance of FL and RR, flight) of K points equally spaced in time.

    Coordinates: x, z and pitch of the trunk, then hip, knee and spring of each leg. Where velocities jump, a segment's
    first point is after the impact and its last one before the next.
    """

    speeds: Float[np.ndarray, " S"]  # m/s, ascending
    durations: Float[np.ndarray, "S 2"]  # s; they add up to half a period
    q: Float[np.ndarray, "S 2 K 15"]  # m, rad
    v: Float[np.ndarray, "S 2 K 15"]  # m/s, rad/s
    tau: Float[np.ndarray, "S 2 K 8"]  # Nm, hip and knee of each leg
    force: Float[np.ndarray, "S 2 K 8"]  # N, (x, z) under each foot
    provenance: dict[str, Any]  # problem, versions and what was verified


def load_library(path: Path) -> MotionLibrary:
    """Read and check the library that `bp2 trajopt library build` wrote to `path`.

    Raises:
        UserError: there is no such file, it is broken or of another format, or its trajectories are no periodic trot.
    """
    shapes = {"speeds": "S", "durations": "S 2", "q": "S 2 K 15", "v": "S 2 K 15", "tau": "S 2 K 8", "force": "S 2 K 8"}
    contents = _read(path, ("format", "provenance", *shapes))
    if not np.array_equal(contents["format"], FORMAT):
        raise _broken(path, f"has format {contents['format']}, this version reads {FORMAT}")
    sizes = {"S": contents["speeds"].size, "K": contents["q"].shape[2] if contents["q"].ndim > 2 else 2}
    if min(sizes.values()) < 2:
        raise _broken(path, f"needs two speeds and two points a segment, has {sizes['S']} and {sizes['K']}")
    for name, wanted in shapes.items():
        array, shape = contents[name], tuple(sizes.get(size) or int(size) for size in wanted.split())
        if not np.issubdtype(array.dtype, np.floating) or array.shape != shape:
            raise _broken(path, f"holds {name} as {array.dtype} {array.shape}, not as floats {shape}")
        if not np.isfinite(array).all():
            raise _broken(path, f"holds numbers in {name} that are not finite")
    library = MotionLibrary(**{name: contents[name] for name in shapes}, provenance=_provenance(path, contents))
    if fault := _fault(library):
        raise _broken(path, fault)
    return library


def _read(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, nothing pickled."""
    try:
        with path.open("rb") as stream:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise _broken(path, "is no .npz file")
            if missing := [name for name in names if name not in file.files]:
                raise _broken(path, f"lacks {', '.join(missing)}")
            return {name: file[name] for name in names}
    except OSError as error:
        raise _broken(path, f"cannot be read ({error.strerror or error})") from error
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, UserError):
            raise
        raise _broken(path, "is broken") from error


def _provenance(path: Path, contents: dict[str, np.ndarray]) -> dict[str, Any]:
    try:
        provenance = json.loads(str(contents["provenance"]))
    except ValueError as error:
        raise _broken(path, "holds a provenance that is not JSON") from error
    if not isinstance(provenance, dict):
        raise _broken(path, "holds a provenance that is not a JSON object")
    return provenance


def _fault(library: MotionLibrary) -> str:
    """What keeps the trajectories from being periodic trots of ascending speeds, if anything."""
    speeds, durations, q = library.speeds, library.durations, library.q
    if not (speeds[0] > 0 and np.all(np.diff(speeds) > 0)):
        return "holds speeds that do not ascend from above 0"
    if not np.all(durations > 0):
        return "holds durations that are not above 0"
    again = np.concatenate([q[:, 0, 0, :TRUNK], _mirror(_by_leg(q[:, 0, 0, TRUNK:])).reshape(-1, 12)], axis=-1)
    again[:, 0] += speeds * durations.sum(axis=1)
    for where, gap in (("at lift-off", q[:, 1, 0] - q[:, 0, -1]), ("after half a cycle", q[:, 1, -1] - again)):
        worst = np.abs(gap).max(axis=1)
        if worst.max() > PERIODIC:
            return f"holds a motion at {speeds[worst.argmax()]:g} m/s whose ends do not meet {where}"
    return ""


def _broken(path: Path, fault: str) -> UserError:
    return UserError(f"motion library {path} {fault}: {MEND}")


@dataclasses.dataclass(frozen=True)
class CollocationConfig:
    """Which motion library is played, and how it grows out of standing."""

    path: str = ""  # of the library; empty: the one that ships
    start_speed: Annotated[float, Within(0.001, 100.0)] = 0.4  # m/s, below which steps shrink, to nothing when standing

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field; the library is read at first use."""
        check_bounds(self, "library.")

    @property
    def file(self) -> Path:
        """Where the library is."""
        return Path(self.path) if self.path else asset_path(SHIPPED)

    @property
    def sha256(self) -> str:
        """Checksum of the library's file, by which a policy knows the motion it was trained on.

        Raises:
            UserError: the file cannot be read.
        """
        try:
            return hashlib.sha256(self.file.read_bytes()).hexdigest()
        except OSError as error:
            raise UserError(f"motion library {self.file} cannot be read: {error.strerror}; {MEND}") from error


@dataclasses.dataclass(frozen=True)
class CollocationGait(CollocationConfig):
    """The `ReferenceMotion` that a motion library holds.

    The motion is that of the robot for which the library was made; of `hardware`, the leg length must be that robot's,
    and standing still takes mass and springs into account.
    """

    hardware: specs.HardwareSpec = specs.BP2

    @property
    def height(self) -> float:
        """Least over the speeds, standing included, of the trunk's mean height above the ground, m."""
        return min(self._table.height, _stand(self.hardware).height)

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Cycles per second at this command."""
        return 0.5 / self._stride(command).half

    def __call__(self, command: Float[Array, "... 3"], phase: Float[Array, "..."]) -> Reference:
        """The reference at this command and phase (see `ReferenceMotion`)."""
        stride, stepping, stand = self._stride(command), self._stepping(command), _stand(self.hardware)
        cycle = phase - jnp.floor(phase)
        mirrored = cycle >= 0.5
        since = (2.0 * cycle - mirrored) * stride.half  # s, since the last pair of feet landed
        moment, rate = self._sample(stride, since, mirrored)
        other_pair = mirrored[..., None] ^ jnp.asarray(TROT > 0.0)
        since_touchdown = since[..., None] + jnp.where(other_pair, stride.half[..., None], 0.0)
        displaced, displaced_rate = self._displacement(command, stride, stepping, since_touchdown)
        q, qd = jax.jvp(
            lambda moment, displaced: self._joints(stepping, moment, displaced),
            (moment, displaced),
            (rate, displaced_rate),
        )
        pitch, height_rate = stepping * moment.pitch, stepping * rate.height
        forward = self._forward(command) + stepping * (rate.x - stride.speed)
        standing = (since_touchdown < stride.stance[..., None]) | (stepping[..., None] < STANDING)
        torque = _mix(stepping[..., None, None], jnp.asarray(stand.torque, q.dtype), moment.torque)
        return Reference(
            joint_position=q.reshape(*phase.shape, 12),
            joint_velocity=qd.reshape(*phase.shape, 12),
            spring_compression=_mix(stepping[..., None], stand.sag, moment.spring),
            spring_velocity=stepping[..., None] * rate.spring,
            height=_mix(stepping, stand.height, moment.height),
            height_velocity=height_rate,
            up=jnp.stack([jnp.sin(pitch), jnp.zeros_like(pitch), jnp.cos(pitch)], axis=-1),
            pitch=pitch,
            pitch_rate=stepping * rate.pitch,
            velocity=jnp.stack([forward, command[..., 1], height_rate], axis=-1),
            contact=standing.astype(q.dtype),
            torque=jnp.pad(torque, [(0, 0)] * phase.ndim + [(0, 0), (1, 0)]).reshape(*phase.shape, 12),
        )

    @property
    def _table(self) -> "_Table":
        return _load_table(self.file, self.hardware.leg_length)

    def _forward(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Forward speed of the motion, m/s: that commanded, up to the library's greatest."""
        return jnp.minimum(command[..., 0], self._table.speeds[-1].astype(command.dtype))

    def _stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """0 when standing, 1 from `start_speed` on, with a continuous derivative."""
        y = jnp.minimum(_square_speed(command) / self.start_speed**2, 1.0)
        return y * (2.0 - y)

    def _stride(self, command: Float[Array, "... 3"]) -> "_Stride":
        """Where the command lies between the library's speeds, and the stride there.

        The mean speed of motions blended with weights w is that of their strides' sums, (w_0 s_0 + w_1 s_1) /
        (w_0 T_0 + w_1 T_1) with s = u T: it is the one wanted, u, if w_1 / w_0 = T_0 (u - u_0) / T_1 (u_1 - u).
        """
        table = self._table
        strides = jnp.asarray(table.strides, dtype=command.dtype)
        speed = jnp.clip(command[..., 0], strides[0, 0], strides[-1, 0])
        row = jnp.searchsorted(strides[1:-1, 0], speed, side="right", method="compare_all").astype(jnp.int32)
        rows = row[..., None] + jnp.arange(2, dtype=jnp.int32)
        ends = strides.at[rows].get(mode="promise_in_bounds")
        half = ends[..., 1] + ends[..., 2]
        away = jnp.stack([ends[..., 1, 0] - speed, speed - ends[..., 0, 0]], axis=-1) * half[..., ::-1]
        weights = away / jnp.sum(away, axis=-1, keepdims=True)
        _, stance, flight, fore, hind = jnp.moveaxis(jnp.sum(weights[..., None] * ends, axis=-2), -1, 0)
        return _Stride(rows, weights, speed, stance, stance + flight, jnp.stack([fore, fore, hind, hind], axis=-1))

    def _sample(
        self, stride: "_Stride", since: Float[Array, "..."], mirrored: Bool[Array, "..."]
    ) -> tuple["_Moment", "_Moment"]:
        """The blended motion `since` seconds after a touchdown, and its rates, with left and right in their places."""
        cubics = jnp.asarray(self._table.cubics, dtype=since.dtype)
        intervals = cubics.shape[1]
        in_flight = since >= stride.stance
        duration = jnp.where(in_flight, stride.half - stride.stance, stride.stance)
        position = jnp.where(in_flight, since - stride.stance, since) / duration * intervals
        interval = jnp.clip(position.astype(jnp.int32), 0, intervals - 1)
        u = (position - interval)[..., None]
        where = (in_flight.astype(jnp.int32)[..., None], interval[..., None], stride.rows)
        ends = cubics.at[where].get(mode="promise_in_bounds")
        c = jnp.sum(stride.weights[..., None, None] * ends, axis=-3)
        value = c[..., 0, :] + u * (c[..., 1, :] + u * (c[..., 2, :] + u * c[..., 3, :]))
        slope = c[..., 1, :] + u * (2.0 * c[..., 2, :] + u * 3.0 * c[..., 3, :])
        return _moment(value, mirrored), _moment(slope * (intervals / duration)[..., None], mirrored)

    def _displacement(
        self,
        command: Float[Array, "... 3"],
        stride: "_Stride",
        stepping: Float[Array, "..."],
        since_touchdown: Float[Array, "... 4"],
    ) -> tuple[Float[Array, "... 4 2"], Float[Array, "... 4 2"]]:
        """How far each foot is, seen from above, from where the library has it, m, and its rate.

        In stance, what the ground does beyond the library's speed; in the swing, the cubic that joins its ends.
        """
        stand = jnp.asarray(_stand(self.hardware).feet, dtype=since_touchdown.dtype)
        middle = jnp.stack(
            [_mix(stepping[..., None], stand[:, 0], stride.middle), jnp.broadcast_to(stand[:, 1], stride.middle.shape)],
            axis=-1,
        )[..., None, :, :]
        v = jnp.stack([self._forward(command), command[..., 1]], axis=-1)[..., None, :]
        omega, library_speed = command[..., None, 2:], (stepping * stride.speed)[..., None, None]

        stance, swing = stride.stance[..., None], (2.0 * stride.half - stride.stance)[..., None]
        in_stance = since_touchdown < stance
        half = jnp.broadcast_to(stance / 2.0, since_touchdown.shape)
        tau = jnp.stack([jnp.where(in_stance, since_touchdown - half, 0.0), half, -half], axis=-2)
        ground = _turn(-omega * tau, middle) + _ground(jnp.zeros_like(stand[:, :2]), v, omega, tau)
        x, y = ground[..., 0], ground[..., 1]
        drift = jnp.stack([x - middle[..., 0] + library_speed * tau, y - middle[..., 1]], axis=-1)
        drift_rate = jnp.stack([library_speed - v[..., :1] + omega * y, -v[..., 1:] - omega * x], axis=-1)

        s = (since_touchdown - stance) / swing
        returning, returning_rate = _joining_cubic(
            jnp.where(in_stance, 0.0, s)[..., None],
            swing[..., None],
            (drift[..., 1, :, :], drift_rate[..., 1, :, :]),
            (drift[..., 2, :, :], drift_rate[..., 2, :, :]),
        )
        stays = in_stance[..., None]
        return (
            jnp.where(stays, drift[..., 0, :, :], returning),
            jnp.where(stays, drift_rate[..., 0, :, :], returning_rate),
        )

    def _joints(
        self, stepping: Float[Array, "..."], moment: "_Moment", displaced: Float[Array, "... 4 2"]
    ) -> Float[Array, "... 4 3"]:
        """Joint angles that put the feet between standing and the library's motion, and `displaced`, within reach."""
        stand, length = _stand(self.hardware), self.hardware.leg_length
        x, z = moment.feet[..., 0], moment.feet[..., 1]
        at_rest = jnp.asarray(stand.feet, x.dtype)
        feet = jnp.stack([x, jnp.broadcast_to(at_rest[:, 1], x.shape), z], axis=-1)
        feet = _mix(stepping[..., None, None], at_rest, feet)
        displaced = jnp.pad(displaced, [(0, 0)] * (displaced.ndim - 1) + [(0, 1)])
        anyway, wanted = _from_level(jnp.stack([feet, feet + displaced]), stepping * moment.pitch)
        centre = _mix(stepping[..., None], stand.sag, moment.spring) + specs.FOOT_RADIUS  # short of the lower leg's end
        return kinematics.joint_angles(
            _within_reach(anyway, wanted, length, length - centre), centre, leg_length=length
        )


class _Table(NamedTuple):
    """A library made ready for interpolation."""

    strides: np.ndarray  # (S, 5) speed, durations of stance and flight, x of fore and hind foot in mid-stance
    cubics: np.ndarray  # (2, K - 1, S, 4, 23) coefficients by the share of an interval, of the parts of `_Moment`
    height: float  # m, least over the speeds of the trunk's mean height

    @property
    def speeds(self) -> np.ndarray:
        return self.strides[:, 0]


class _Stride(NamedTuple):
    """A stride between two of the library's speeds."""

    rows: Array  # (..., 2) indices of the two speeds
    weights: Array  # (..., 2)
    speed: Array  # (...) m/s
    stance: Array  # (...) s
    half: Array  # (...) s, half a period
    middle: Array  # (..., 4) m, x of each foot's centre in mid-stance, from the trunk's centre


class _Moment(NamedTuple):
    """The library's motion at one time, or its rates."""

    x: Array  # (...) m
    height: Array  # (...) m
    pitch: Array  # (...) rad
    feet: Array  # (..., 4, 2) m, x and z of the feet's centres from the trunk's centre, level
    spring: Array  # (..., 4) m
    torque: Array  # (..., 4, 2) Nm


class _Stand(NamedTuple):
    """Standing still: `specs.STAND_JOINTS` on springs that bear the weight, with legs without mass."""

    feet: np.ndarray  # (4, 3) m, centres of the feet from the trunk's centre
    sag: float  # m
    height: float  # m, of the trunk's centre
    torque: np.ndarray  # (2,) Nm, hip and knee


@functools.lru_cache(maxsize=8)
def _load_table(path: Path, leg_length: float) -> _Table:
    """The table of a library whose standing feet are on the ground with legs of this length."""
    library = load_library(path)
    q, v, tau = (array.astype(float) for array in (library.q, library.v, library.tau))
    places, rates = _with_feet(q, v, leg_length)
    off = np.abs(places[:, 0, :, 1:2] + _by_leg(places[:, 0, :, TRUNK:])[..., STANDING_PAIR, 1] - specs.FOOT_RADIUS)
    if off.max() > ON_GROUND:
        raise _broken(path, f"has standing feet {1e3 * off.max():.0f} mm off the ground with legs of {leg_length} m")
    durations = library.durations.astype(float)
    cubics = _cubics(durations, places, rates, tau)
    middle = _by_leg(_by_share(cubics[:, 0], 0.5)[:, TRUNK:COORDINATES])[:, STANDING_PAIR, 0]
    mean_height = np.sum(durations * q[..., 1].mean(axis=2), axis=1) / durations.sum(axis=1)
    return _Table(
        strides=np.column_stack([library.speeds.astype(float), durations, middle]),
        cubics=np.moveaxis(cubics, 0, 2),
        height=float(mean_height.min()),
    )


def _cubics(durations: np.ndarray, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Coefficients (S, 2, K - 1, 4, 23): Hermite's cubics of q and v, straight lines of tau."""
    h = (durations / (q.shape[2] - 1))[..., None, None]
    left, right, out, into = q[:, :, :-1], q[:, :, 1:], h * v[:, :, :-1], h * v[:, :, 1:]
    cubic = [left, out, 3.0 * (right - left) - 2.0 * out - into, 2.0 * (left - right) + out + into]
    line = [tau[:, :, :-1], np.diff(tau, axis=2)]
    line += [np.zeros_like(line[1])] * 2
    return np.concatenate([np.stack(cubic, axis=-2), np.stack(line, axis=-2)], axis=-1)


def _by_share(cubics: np.ndarray, share: float) -> np.ndarray:
    """What (..., K - 1, 4, n) coefficients say at a share of their segment."""
    position = share * cubics.shape[-3]
    interval = min(int(position), cubics.shape[-3] - 1)
    return np.sum(cubics[..., interval, :, :] * (position - interval) ** np.arange(4)[:, None], axis=-2)


def _with_feet(q: np.ndarray, v: np.ndarray, leg_length: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (..., 15) and rates with hip and knee replaced by (x, z) of the foot's centre and its rate."""
    (hip, knee, spring), (hip_rate, knee_rate, spring_rate) = (
        np.moveaxis(_by_leg(x[..., TRUNK:]), -1, 0) for x in (q, v)
    )
    pitch, pitch_rate = q[..., 2:3], v[..., 2:3]
    links = (  # along the trunk, down the thigh, down the lower leg: length, its rate, angle, its rate
        (kinematics.LEG_ORIGINS[:, 0], 0.0, pitch, pitch_rate),
        (leg_length, 0.0, pitch + hip + np.pi / 2, pitch_rate + hip_rate),
        (
            leg_length - specs.FOOT_RADIUS - spring,
            -spring_rate,
            pitch + hip + knee + np.pi / 2,
            pitch_rate + hip_rate + knee_rate,
        ),
    )
    x = np.sum([length * np.cos(angle) for length, _, angle, _ in links], axis=0)
    z = np.sum([-length * np.sin(angle) for length, _, angle, _ in links], axis=0)
    x_rate = np.sum([change * np.cos(at) - length * turn * np.sin(at) for length, change, at, turn in links], axis=0)
    z_rate = np.sum([-change * np.sin(at) - length * turn * np.cos(at) for length, change, at, turn in links], axis=0)

    def row(trunk: np.ndarray, *legs: np.ndarray) -> np.ndarray:
        return np.concatenate([trunk, np.stack(legs, axis=-1).reshape(*trunk.shape[:-1], -1)], axis=-1)

    return row(q[..., :TRUNK], x, z, spring), row(v[..., :TRUNK], x_rate, z_rate, spring_rate)


@functools.lru_cache(maxsize=8)
def _stand(hardware: specs.HardwareSpec) -> _Stand:
    load = hardware.mass_scale * specs.TOTAL_MASS * specs.GRAVITY / 4.0
    sag = load * math.cos(specs.STAND_HIP) / hardware.spring_stiffness
    lower = hardware.leg_length - sag - specs.FOOT_RADIUS
    angles = np.reshape(specs.STAND_JOINTS, (4, 3))
    feet = kinematics.foot_position(angles, np.full(4, sag + specs.FOOT_RADIUS), leg_length=hardware.leg_length)
    torque = load * math.sin(specs.STAND_HIP) * np.array([lower - hardware.leg_length, lower])
    return _Stand(feet, sag, specs.FOOT_RADIUS - float(feet[0, 2]), torque)


def _moment(values: Float[Array, "... 23"], mirrored: Bool[Array, "..."]) -> _Moment:
    """The parts of a row of the table."""

    def placed(legs: Array) -> Array:
        return jnp.where(mirrored[..., None, None], _mirror(legs), legs)

    legs = placed(_by_leg(values[..., TRUNK:COORDINATES]))
    torque = placed(values[..., COORDINATES:].reshape(*values.shape[:-1], 4, 2))
    return _Moment(values[..., 0], values[..., 1], values[..., 2], legs[..., :2], legs[..., 2], torque)


def _within_reach(
    anyway: Float[Array, "... 4 3"], wanted: Float[Array, "... 4 3"], thigh: float, lower: Float[Array, "... 4"]
) -> Float[Array, "... 4 3"]:
    """Feet displaced from `anyway` towards `wanted`, from the trunk's centre, with no knee beyond its range.

    A displacement that takes more than half of what is left of the reach gets the other half only by and by; so no
    leg straightens in a jerk. Legs that have no reach left keep their length.
    """
    hip = jnp.asarray(kinematics.LEG_ORIGINS, wanted.dtype)
    now, then = (jnp.sqrt(jnp.sum((feet - hip) ** 2, axis=-1)) for feet in (anyway, wanted))
    straight = thigh**2 + lower**2 + 2.0 * thigh * lower * math.cos(specs.KNEE_RANGE[1]) + specs.THIGH_LATERAL**2
    half_left = jnp.maximum((jnp.sqrt(straight) - now) / 2.0, 1e-7)
    longer = then - now
    beyond = jnp.maximum(longer - half_left, 0.0)
    reached = now + jnp.minimum(longer, half_left) + half_left * (1.0 - jnp.exp(-beyond / half_left))
    return hip + (reached / then)[..., None] * (wanted - hip)


def _joining_cubic(
    s: Float[Array, "... 1"],
    duration: Float[Array, "... 1"],
    start: tuple[Float[Array, "... 2"], Float[Array, "... 2"]],
    end: tuple[Float[Array, "... 2"], Float[Array, "... 2"]],
) -> tuple[Float[Array, "... 2"], Float[Array, "... 2"]]:
    """Value and rate, at the share `s` of a duration, of the cubic from one (value, rate) to another."""
    (a, out), (b, into) = start, end
    out, into, r = duration * out, duration * into, 1.0 - s
    value = a * r**2 * (1.0 + 2.0 * s) + b * s**2 * (3.0 - 2.0 * s) + out * s * r**2 - into * s**2 * r
    slope = 6.0 * s * r * (b - a) + out * r * (1.0 - 3.0 * s) - into * s * (2.0 - 3.0 * s)
    return value, slope / duration


def _mix(share: Float[Array, "..."], zero: Any, one: Float[Array, "..."]) -> Float[Array, "..."]:
    """From `zero` to `one`."""
    return zero + share * (one - zero)


def _from_level(p: Float[Array, "... 4 3"], pitch: Float[Array, "..."]) -> Float[Array, "... 4 3"]:
    """p, of legs, from a level frame to one pitched by `pitch`, nose down."""
    c, s = jnp.cos(pitch)[..., None], jnp.sin(pitch)[..., None]
    return jnp.stack([c * p[..., 0] - s * p[..., 2], p[..., 1], c * p[..., 2] + s * p[..., 0]], axis=-1)


def _by_leg(coordinates: Any) -> Any:
    """(..., 12) -> (..., 4 legs, 3); NumPy or JAX."""
    return coordinates.reshape(*coordinates.shape[:-1], 4, 3)


def _mirror(legs: Any) -> Any:
    """(..., 4 legs, n) with left and right in each other's place; NumPy or JAX."""
    xp = legs.__array_namespace__()
    pairs = legs.reshape(*legs.shape[:-2], 2, 2, legs.shape[-1])
    return xp.flip(pairs, axis=-2).reshape(legs.shape)
