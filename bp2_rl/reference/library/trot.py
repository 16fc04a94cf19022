"""The collocation gait: the motions of a library, between its speeds and beyond them,
as a reference motion.

A library holds, for every speed, half a gait cycle: stance of FL and RR, then flight;
left and right then change places. Between its points the coordinates are the cubics
through their values and rates, and torques are straight lines. Between its speeds
everything is blended at equal shares of a segment, so that touchdowns and lift-offs
meet, with weights that make the mean speed exactly the one commanded. Velocities jump
at touchdown: that is the impact.

Beyond the library's greatest speed its motion stays what it is there. Below the least
speed, backwards, sideways and turning, the motion is that of the nearest speed with
every foot displaced by what the ground moves otherwise in its
stance: p' = -v - omega x p, measured from mid-stance; a cubic brings the foot back
during the swing. Around standing still, steps shrink to nothing. All this happens to
the centres of the spherical feet, with the trunk's pitch taken out, so that no foot
leaves the ground or enters it; only a leg that is all but straight cannot follow and
stays above it. Torques are those of straight running.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from bp2_rl.base.arrays import cubic_and_slope, hermite_and_rate
from bp2_rl.reference.interface import Reference
from bp2_rl.reference.library.file import COORDINATES, TRUNK, by_leg, mirror
from bp2_rl.reference.library.table import LibraryTable, load_table
from bp2_rl.reference.stepping import (
    STANDING,
    TROT,
    foot_circle,
    ground,
    square_speed,
    turn,
)
from bp2_rl.robot import conventions, kinematics
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.settings.reference import CollocationConfig


@dataclasses.dataclass(frozen=True)
class CollocationGait(CollocationConfig):
    """The trots of a motion library, blended over speed, as a `ReferenceMotion`.

    The motion is that of the robot for which the library was made; of `hardware`, name
    and legs must be that robot's, and standing still takes mass and springs into
    account.
    """

    hardware: HardwareSpec = IDEAL

    @property
    def height(self) -> float:
        """Least over the speeds, standing included, of the trunk's mean height above
        the ground, m."""
        return min(self._table.height, _stand(self.hardware).height)

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the frequency of the gait at a command, cycles per second."""
        return 0.5 / self._stride(command).half

    def __call__(
        self, command: Float[Array, "... 3"], phase: Float[Array, "..."]
    ) -> Reference:
        """Return the reference at a command and a phase (see `ReferenceMotion`)."""
        stride = self._stride(command)
        stepping = self.stepping(command)
        stand = _stand(self.hardware)
        cycle = phase - jnp.floor(phase)
        mirrored = cycle >= 0.5
        # s, since the last pair of feet landed
        since = (2.0 * cycle - mirrored) * stride.half
        moment, rate = self._sample(stride, since, mirrored)
        other_pair = mirrored[..., None] ^ jnp.asarray(TROT > 0.0)
        since_touchdown = since[..., None] + jnp.where(
            other_pair, stride.half[..., None], 0.0
        )
        displaced, displaced_rate = self._displacement(
            command, stride, stepping, since_touchdown
        )
        q, qd = jax.jvp(
            lambda moment, displaced: self._joints(stepping, moment, displaced),
            (moment, displaced),
            (rate, displaced_rate),
        )
        pitch, height_rate = stepping * moment.pitch, stepping * rate.height
        forward = self._forward(command) + stepping * (rate.x - stride.speed)
        standing = (since_touchdown < stride.stance[..., None]) | (
            stepping[..., None] < STANDING
        )
        torque = _mix(
            stepping[..., None, None], jnp.asarray(stand.torque, q.dtype), moment.torque
        )
        return Reference(
            joint_position=q.reshape(*phase.shape, 12),
            joint_velocity=qd.reshape(*phase.shape, 12),
            spring_compression=_mix(stepping[..., None], stand.sag, moment.spring),
            spring_velocity=stepping[..., None] * rate.spring,
            height=_mix(stepping, stand.height, moment.height),
            height_velocity=height_rate,
            up=jnp.stack(
                [jnp.sin(pitch), jnp.zeros_like(pitch), jnp.cos(pitch)], axis=-1
            ),
            pitch=pitch,
            pitch_rate=stepping * rate.pitch,
            velocity=jnp.stack([forward, command[..., 1], height_rate], axis=-1),
            contact=standing.astype(q.dtype),
            torque=jnp.pad(torque, [(0, 0)] * phase.ndim + [(0, 0), (1, 0)]).reshape(
                *phase.shape, 12
            ),
        )

    @property
    def _table(self) -> LibraryTable:
        return load_table(self.file, self.hardware.anatomy)

    def _forward(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the forward speed of the motion, m/s: the commanded speed, up to the
        library's greatest."""
        return jnp.minimum(
            command[..., 0], self._table.speeds[-1].astype(command.dtype)
        )

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the size of the steps: 0 when standing, 1 from `stepping_speed` on,
        with a continuous derivative."""
        y = jnp.minimum(
            square_speed(command, foot_circle(self.hardware)) / self.stepping_speed**2,
            1.0,
        )
        return y * (2.0 - y)

    def _stride(self, command: Float[Array, "... 3"]) -> "_BlendedStride":
        """Return the stride at a command, blended from the library's strides at the two
        neighbouring speeds.

        The mean speed of motions blended with weights w is that of their strides' sums,
        (w_0 s_0 + w_1 s_1) / (w_0 T_0 + w_1 T_1) with s = u T: it is the one wanted, u,
        if w_1 / w_0 = T_0 (u - u_0) / T_1 (u_1 - u).
        """
        table = self._table
        strides = jnp.asarray(table.strides, dtype=command.dtype)
        speed = jnp.clip(command[..., 0], strides[0, 0], strides[-1, 0])
        row = jnp.searchsorted(
            strides[1:-1, 0], speed, side="right", method="compare_all"
        ).astype(jnp.int32)
        rows = row[..., None] + jnp.arange(2, dtype=jnp.int32)
        ends = strides.at[rows].get(mode="promise_in_bounds")
        half = ends[..., 1] + ends[..., 2]
        away = (
            jnp.stack([ends[..., 1, 0] - speed, speed - ends[..., 0, 0]], axis=-1)
            * half[..., ::-1]
        )
        weights = away / jnp.sum(away, axis=-1, keepdims=True)
        _, stance, flight, fore, hind = jnp.moveaxis(
            jnp.sum(weights[..., None] * ends, axis=-2), -1, 0
        )
        return _BlendedStride(
            rows,
            weights,
            speed,
            stance,
            stance + flight,
            jnp.stack([fore, fore, hind, hind], axis=-1),
        )

    def _sample(
        self,
        stride: "_BlendedStride",
        since: Float[Array, "..."],
        mirrored: Bool[Array, "..."],
    ) -> tuple["_BlendedPose", "_BlendedPose"]:
        """Return the blended pose `since` seconds after a touchdown, and its rates,
        with left and right exchanged where `mirrored`."""
        cubics = jnp.asarray(self._table.cubics, dtype=since.dtype)
        intervals = cubics.shape[1]
        in_flight = since >= stride.stance
        duration = jnp.where(in_flight, stride.half - stride.stance, stride.stance)
        position = (
            jnp.where(in_flight, since - stride.stance, since) / duration * intervals
        )
        interval = jnp.clip(position.astype(jnp.int32), 0, intervals - 1)
        u = (position - interval)[..., None]
        where = (
            in_flight.astype(jnp.int32)[..., None],
            interval[..., None],
            stride.rows,
        )
        ends = cubics.at[where].get(mode="promise_in_bounds")
        c = jnp.sum(stride.weights[..., None, None] * ends, axis=-3)
        value, slope = cubic_and_slope(
            u, (c[..., 0, :], c[..., 1, :], c[..., 2, :], c[..., 3, :])
        )
        return _moment(value, mirrored), _moment(
            slope * (intervals / duration)[..., None], mirrored
        )

    def _displacement(
        self,
        command: Float[Array, "... 3"],
        stride: "_BlendedStride",
        stepping: Float[Array, "..."],
        since_touchdown: Float[Array, "... 4"],
    ) -> tuple[Float[Array, "... 4 2"], Float[Array, "... 4 2"]]:
        """Return the horizontal displacement of every foot from its place in the
        library's motion, m, and its rate.

        In stance, what the ground does beyond the library's speed; in the swing, the
        cubic that joins its ends.
        """
        stand = jnp.asarray(_stand(self.hardware).feet, dtype=since_touchdown.dtype)
        middle = jnp.stack(
            [
                _mix(stepping[..., None], stand[:, 0], stride.middle),
                jnp.broadcast_to(stand[:, 1], stride.middle.shape),
            ],
            axis=-1,
        )[..., None, :, :]
        v = jnp.stack([self._forward(command), command[..., 1]], axis=-1)[..., None, :]
        omega = command[..., None, 2:]
        library_speed = (stepping * stride.speed)[..., None, None]

        stance = stride.stance[..., None]
        swing = (2.0 * stride.half - stride.stance)[..., None]
        in_stance = since_touchdown < stance
        half = jnp.broadcast_to(stance / 2.0, since_touchdown.shape)
        tau = jnp.stack(
            [jnp.where(in_stance, since_touchdown - half, 0.0), half, -half], axis=-2
        )
        place = turn(-omega * tau, middle) + ground(
            jnp.zeros_like(stand[:, :2]), v, omega, tau
        )
        x, y = place[..., 0], place[..., 1]
        drift = jnp.stack(
            [x - middle[..., 0] + library_speed * tau, y - middle[..., 1]], axis=-1
        )
        drift_rate = jnp.stack(
            [library_speed - v[..., :1] + omega * y, -v[..., 1:] - omega * x], axis=-1
        )

        s = (since_touchdown - stance) / swing
        returning, returning_rate = hermite_and_rate(
            jnp.where(in_stance, 0.0, s)[..., None],
            swing[..., None],
            *(drift[..., 1, :, :], drift[..., 2, :, :]),
            *(drift_rate[..., 1, :, :], drift_rate[..., 2, :, :]),
        )
        stays = in_stance[..., None]
        return (
            jnp.where(stays, drift[..., 0, :, :], returning),
            jnp.where(stays, drift_rate[..., 0, :, :], returning_rate),
        )

    def _joints(
        self,
        stepping: Float[Array, "..."],
        moment: "_BlendedPose",
        displaced: Float[Array, "... 4 2"],
    ) -> Float[Array, "... 4 3"]:
        """Return joint angles for feet between standing and the library's motion, moved
        by `displaced` (m) within reach."""
        stand = _stand(self.hardware)
        x, z = moment.feet[..., 0], moment.feet[..., 1]
        at_rest = jnp.asarray(stand.feet, x.dtype)
        feet = jnp.stack([x, jnp.broadcast_to(at_rest[:, 1], x.shape), z], axis=-1)
        feet = _mix(stepping[..., None, None], at_rest, feet)
        displaced = jnp.pad(displaced, [(0, 0)] * (displaced.ndim - 1) + [(0, 1)])
        undisplaced, wanted = _from_level(
            jnp.stack([feet, feet + displaced]), stepping * moment.pitch
        )
        radius = jnp.asarray(self.hardware.anatomy.geometry.foot_radius, x.dtype)
        # short of the lower leg's end
        centre = _mix(stepping[..., None], stand.sag, moment.spring) + radius
        return kinematics.joint_angles(
            _within_reach(undisplaced, wanted, centre, self.hardware),
            centre,
            self.hardware,
        )


class _BlendedStride(NamedTuple):
    """A stride blended from the library's strides at two speeds."""

    rows: Array  # (..., 2) indices of the two speeds
    weights: Array  # (..., 2)
    speed: Array  # (...) m/s
    stance: Array  # (...) s
    half: Array  # (...) s, half a period
    # (..., 4) m, x of each foot's centre in mid-stance, from the trunk's centre
    middle: Array


class _BlendedPose(NamedTuple):
    """A pose blended from the library's motions at one time, or its rates."""

    x: Array  # (...) m
    height: Array  # (...) m
    pitch: Array  # (...) rad
    # (..., 4, 2) m, x and z of the feet's centres from the trunk's centre, level
    feet: Array
    spring: Array  # (..., 4) m
    torque: Array  # (..., 4, 2) Nm


class _Stand(NamedTuple):
    """The robot's standing pose, on legs without mass that bear a quarter of the weight
    each."""

    feet: Float[np.ndarray, "4 3"]  # m, centres of the feet from the trunk's centre
    sag: Float[np.ndarray, "4"]  # m; zero of rigid shanks
    height: float  # m, of the trunk's centre
    torque: Float[np.ndarray, "4 2"]  # Nm, hip and knee


@functools.lru_cache(maxsize=8)
def _stand(hardware: HardwareSpec) -> _Stand:
    anatomy, legs = hardware.anatomy, hardware.anatomy.geometry
    load = hardware.mass * conventions.GRAVITY / 4.0
    angles = np.reshape(anatomy.stand, (4, 3))
    hip, lean = angles[:, 1], angles[:, 1] + angles[:, 2]
    sag = (
        load * np.cos(lean) / hardware.spring_stiffness
        if anatomy.sprung
        else np.zeros(4)
    )
    lower = legs.lower - sag - legs.foot_radius
    feet = kinematics.foot_position(angles, sag + legs.foot_radius, hardware)
    # What the joints hold is how the feet's height goes with their angles.
    knee = -load * lower * np.sin(lean)
    torque = np.stack([knee - load * legs.thigh * np.sin(hip), knee], axis=-1)
    return _Stand(feet, sag, float(np.max(legs.foot_radius - feet[:, 2])), torque)


def _moment(
    values: Float[Array, "... 23"], mirrored: Bool[Array, "..."]
) -> _BlendedPose:
    """Return a row of the library's table as a pose, with left and right exchanged
    where `mirrored`."""

    def placed(legs: Array) -> Array:
        return jnp.where(mirrored[..., None, None], mirror(legs), legs)

    legs = placed(by_leg(values[..., TRUNK:COORDINATES]))
    torque = placed(values[..., COORDINATES:].reshape(*values.shape[:-1], 4, 2))
    return _BlendedPose(
        values[..., 0],
        values[..., 1],
        values[..., 2],
        legs[..., :2],
        legs[..., 2],
        torque,
    )


def _within_reach(
    anyway: Float[Array, "... 4 3"],
    wanted: Float[Array, "... 4 3"],
    compression: Float[Array, "... 4"],
    hardware: HardwareSpec,
) -> Float[Array, "... 4 3"]:
    """Return feet displaced from `anyway` towards `wanted` (m, from the trunk's
    centre), with no knee beyond its range.

    A displacement that takes more than half of what is left of the reach gets the other
    half only by and by; so no leg straightens in a jerk. Legs that have no reach left
    keep their length.
    """
    legs, dtype = hardware.anatomy.geometry, wanted.dtype
    thigh = jnp.asarray(legs.thigh, dtype)
    lower = jnp.asarray(legs.lower, dtype) - compression
    hip = jnp.asarray(kinematics.hip_places(hardware), dtype)
    now, then = (
        jnp.sqrt(jnp.sum((feet - hip) ** 2, axis=-1)) for feet in (anyway, wanted)
    )
    cosine = jnp.asarray(np.cos(kinematics.straightest_knees(hardware)), dtype)
    straight = (
        thigh**2
        + lower**2
        + 2.0 * thigh * lower * cosine
        + jnp.asarray(legs.lateral, dtype) ** 2
    )
    half_left = jnp.maximum((jnp.sqrt(straight) - now) / 2.0, 1e-7)
    longer = then - now
    beyond = jnp.maximum(longer - half_left, 0.0)
    reached = (
        now
        + jnp.minimum(longer, half_left)
        + half_left * (1.0 - jnp.exp(-beyond / half_left))
    )
    return hip + (reached / then)[..., None] * (wanted - hip)


def _mix(
    share: Float[Array, "..."], zero: ArrayLike, one: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Return the value at a share of the way from `zero` to `one`, in the precision of
    `one`."""
    zero = jnp.asarray(zero, one.dtype)
    return zero + share * (one - zero)


def _from_level(
    p: Float[Array, "... 4 3"], pitch: Float[Array, "..."]
) -> Float[Array, "... 4 3"]:
    """Return points p of the legs, given in a level frame, in a frame pitched by
    `pitch`, nose down."""
    c, s = jnp.cos(pitch)[..., None], jnp.sin(pitch)[..., None]
    return jnp.stack(
        [c * p[..., 0] - s * p[..., 2], p[..., 1], c * p[..., 2] + s * p[..., 0]],
        axis=-1,
    )
