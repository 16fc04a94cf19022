"""The kinematic gait generator: a trot for forward, lateral and yaw commands, in closed form.

A foot in stance is fixed in the world, so in the trunk frame it obeys p' = -v - omega x p exactly. A foot in
swing leaves with that velocity and returns to it, so the reference is continuously differentiable in time.
Period and duty follow the command so that the stance sweep stays within the legs' reach at every speed, and
everything grows smoothly from standing still at zero command.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.gait.reference import Reference
from bp2_rl.robot import kinematics, specs

TROT = np.array([0.5, 0.0, 0.0, 0.5])  # cycles by which FR, FL, RR, RL are ahead: FL with RR, FR with RL


@dataclasses.dataclass(frozen=True)
class KinematicGait:
    """Configuration of the kinematic gait, and the `ReferenceMotion` it defines. Lengths are for BP2's own leg and
    scale with `hardware.leg_length`.
    """

    stand_height: float = 0.55  # m, trunk centre above the ground at zero command
    run_height: float = 0.52  # m, mean at high speed
    height_speed: float = 4.0  # m/s, at which half of that change has been made
    sweep: float = 0.58  # m, greatest path of a foot during stance
    slow_stance: float = 0.22  # s, stance time at low speed
    swing_time: float = 0.26  # s
    slow_lift: float = 0.08  # m, swing height when walking
    run_lift: float = 0.18  # m, swing height at high speed
    lift_speed: float = 5.0  # m/s, at which half of that change has been made
    start_speed: float = 0.2  # m/s: the scale on which stepping in place grows out of standing
    follow_through: int = 10  # power n: the foot overshoots by speed x swing_time / (n + 1)
    bounce: float = 1.0  # share of the trunk's ballistic rise and fall
    hardware: specs.HardwareSpec = specs.BP2

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Cycles per second at this command."""
        return 1.0 / (self._stance_time(_square_speed(command)) + self.swing_time)

    def __call__(self, command: Float[Array, "... 3"], phase: Float[Array, "..."]) -> Reference:
        """The reference at this command and phase (see `ReferenceMotion`)."""
        rate = self.phase_rate(command)
        (q, spring, height), (qd, spring_velocity, height_velocity), contact = jax.jvp(
            lambda phase: self._posture(command, phase), (phase,), (rate,), has_aux=True
        )
        zero = jnp.zeros_like(height)
        return Reference(
            joint_position=q,
            joint_velocity=qd,
            spring_compression=spring,
            spring_velocity=spring_velocity,
            height=height,
            height_velocity=height_velocity,
            up=jnp.stack([zero, zero, zero + 1.0], axis=-1),
            pitch=zero,
            pitch_rate=zero,
            velocity=jnp.stack([command[..., 0], command[..., 1], height_velocity], axis=-1),
            contact=contact,
            torque=jnp.zeros_like(q),
        )

    def _stance_time(self, square_speed):
        """Smooth minimum of the slow stance time and sweep / speed, s."""
        ratio = square_speed * (self.slow_stance / (self._scale * self.sweep)) ** 2
        return self.slow_stance * (1.0 + ratio**2) ** -0.25

    @property
    def _scale(self) -> float:
        return self.hardware.leg_length / specs.THIGH_LENGTH

    def _posture(self, command, phase):
        """Joint angles (... 12), spring compressions (... 4) and trunk height (...); with contacts (... 4)."""
        s2 = _square_speed(command)
        stance_time = self._stance_time(s2)
        period = stance_time + self.swing_time
        duty = stance_time / period
        going = s2 / (s2 + self.start_speed**2)  # 0 standing, 1 on the move

        leg_phase = phase[..., None] + TROT
        leg_phase = leg_phase - jnp.floor(leg_phase)
        contact = leg_phase < duty[..., None]
        sigma = jnp.where(contact, leg_phase / duty[..., None], (leg_phase - duty[..., None]) / (1.0 - duty[..., None]))

        # Trunk: lowest at mid-stance of either pair, by the first harmonic of a half-sine force pulse.
        rise = (2.0 - 1.33 * (2.0 * duty) ** 2) * specs.GRAVITY * (period / (4.0 * jnp.pi)) ** 2
        mean_height = self.stand_height + (self.run_height - self.stand_height) * s2 / (s2 + self.height_speed**2)
        height = self._scale * mean_height - self.bounce * going * rise * jnp.cos(4.0 * jnp.pi * (phase - duty / 2.0))

        # Springs: the weight at rest, a pulse of the same mean force in stance.
        load = self.hardware.mass_scale * specs.TOTAL_MASS * specs.GRAVITY / 4.0 / self.hardware.spring_stiffness
        pulse = jnp.where(contact, (sigma * (1.0 - sigma)) ** 2 * 30.0, 0.0)
        peak = load / duty * 0.85
        peak = peak * (1.0 + (peak * 1.875 / self.hardware.spring_travel) ** 4) ** -0.25
        spring = (1.0 - going[..., None]) * load * 0.85 + (going * peak)[..., None] * pulse

        # Feet, in the heading frame with the origin below the trunk's centre.
        feet = self._foot_plan(command, stance_time, contact, sigma)
        lift = self.slow_lift + (self.run_lift - self.slow_lift) * s2 / (s2 + self.lift_speed**2)
        bump = jnp.where(contact, 0.0, 64.0 * (sigma * (1.0 - sigma)) ** 3)
        z = self._scale * (going * lift)[..., None] * bump - height[..., None]
        feet = jnp.concatenate([feet, z[..., None]], axis=-1)
        q = kinematics.joint_angles(feet, spring, leg_length=self.hardware.leg_length)
        return (q.reshape(*q.shape[:-2], 12), spring, height), contact.astype(q.dtype)

    def _foot_plan(self, command, stance_time, contact, sigma):
        """Feet (... 4 2) seen from above: exact rolling in stance, a C1 swing between lift-off and touchdown."""
        v, yaw_rate = command[..., None, :2], command[..., 2:]
        nominal = jnp.asarray(_NOMINAL, dtype=command.dtype)
        half = stance_time[..., None] / 2.0
        tau = jnp.where(contact, (2.0 * sigma - 1.0) * half, 0.0)
        stance = _ground(nominal, v, yaw_rate, tau)

        lift_off, touchdown = _ground(nominal, v, yaw_rate, half), _ground(nominal, v, yaw_rate, -half)
        out, back = -v - _cross(yaw_rate, lift_off), -v - _cross(yaw_rate, touchdown)
        n = self.follow_through
        mean = (touchdown - lift_off) / self.swing_time - (out + back) / (n + 1)
        x = sigma[..., None]
        swing = lift_off + self.swing_time * (
            out * (1.0 - (1.0 - x) ** (n + 1)) / (n + 1)
            + back * x ** (n + 1) / (n + 1)
            + mean * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        )
        return jnp.where(contact[..., None], stance, swing)


_NOMINAL = kinematics.LEG_ORIGINS[:, :2] + np.stack([np.zeros(4), kinematics.SIDE * specs.THIGH_LATERAL], axis=-1)
_HIP_RADIUS = float(np.max(np.linalg.norm(_NOMINAL, axis=-1)))  # m, of the farthest nominal foot from the centre


def _square_speed(command):
    """Square of the planar speed demanded of a foot, yaw included, (m/s)^2."""
    vx, vy, yaw_rate = command[..., 0], command[..., 1], command[..., 2]
    return vx * vx + vy * vy + (yaw_rate * _HIP_RADIUS) ** 2


def _cross(yaw_rate, p):
    """omega x p for omega along z: (... 4 2)."""
    return yaw_rate[..., None] * jnp.stack([-p[..., 1], p[..., 0]], axis=-1)


def _turn(angle, p):
    """Rotation of p (... 4 2) by `angle` (... 4) about z."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * p[..., 0] - s * p[..., 1], s * p[..., 0] + c * p[..., 1]], axis=-1)


def _ground(nominal, v, yaw_rate, tau):
    """Where a point of the ground is, seen from the trunk, `tau` seconds after it was at `nominal`: (... 4 2).

    The trunk turns at `yaw_rate` and moves at `v` in its own frame, so p' = -v - omega x p, whose solution is
    R(-omega tau) nominal - V v with V = integral of R(-omega u) du from 0 to tau: a chord, of length
    tau sinc(omega tau / 2) and direction R(-omega tau / 2).
    """
    half = yaw_rate * tau / 2.0
    y = half * half
    chord = tau * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0))))  # sinc: exact for |half| < 1
    return _turn(-2.0 * half, nominal) - chord[..., None] * _turn(-half, v)
