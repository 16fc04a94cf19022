"""The kinematic gait generator: a trot for forward, lateral and yaw commands, in closed form.

Stance: a foot is fixed in the world, so in the trunk frame it obeys p' = -v - omega x p exactly, while its spring
takes the pulse of compression that carries the robot's weight. Joint angles follow by inverse kinematics.

Swing: the joints leave with the angles and speeds of lift-off and come to those of touchdown along a polynomial,
with a bump of knee flexion that lifts the foot by much the same at any speed. So the joint angles are continuously
differentiable in time, and no overshoot of the foot can leave the reach of the leg.

Period and duty follow the command so that the sweep of a stance stays within reach at every speed, and everything
grows smoothly out of standing still. How the defaults were found is in docs/notes/kinematic_gait.md.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.reference.interface import Reference
from bp2_rl.reference.stepping import STANDING, TROT, ground, nominal_feet, square_speed
from bp2_rl.robot import bp2, conventions, kinematics
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.settings.reference import KinematicConfig

FLEXION = np.array([0.0, -0.5, 1.0])  # of abad, hip, knee: draws the foot straight towards the hip
AXIAL_SHARE = 0.78  # of a foot's force is along its spring; found on rails, where the ground then bears the weight


@dataclasses.dataclass(frozen=True)
class KinematicGait(KinematicConfig):
    """The `ReferenceMotion` that the settings make of a robot."""

    hardware: HardwareSpec = IDEAL

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Cycles per second at this command."""
        return 1.0 / (self._stance_time(command) + self.swing_time)

    def __call__(self, command: Float[Array, "... 3"], phase: Float[Array, "..."]) -> Reference:
        """The reference at this command and phase (see `ReferenceMotion`)."""
        phase = phase - jnp.floor(phase)
        stance_time = self._stance_time(command)
        period = stance_time + self.swing_time
        leg_phase = phase[..., None] + jnp.asarray(TROT, dtype=phase.dtype)
        since_touchdown = (leg_phase - jnp.floor(leg_phase)) * period[..., None]
        in_stance = since_touchdown < stance_time[..., None]

        # A foot's stance now, at lift-off and at touchdown in one batch, with rates.
        half = jnp.broadcast_to(stance_time[..., None] / 2.0, since_touchdown.shape)
        tau = jnp.stack([jnp.where(in_stance, since_touchdown - half, 0.0), half, -half], axis=-2)
        (q, spring), (qd, spring_rate) = jax.jvp(lambda t: self._stance(command, t), (tau,), (jnp.ones_like(tau),))
        s = jnp.where(in_stance, 0.0, (since_touchdown - 2.0 * half) / self.swing_time)
        q_swing, qd_swing = self._swing(
            command, s, (q[..., 1, :, :], qd[..., 1, :, :]), (q[..., 2, :, :], qd[..., 2, :, :])
        )

        def choose(stance: Array, swing: Array | float) -> Array:
            return jnp.where(in_stance.reshape(in_stance.shape + (1,) * (stance.ndim - in_stance.ndim)), stance, swing)

        def flat(q: Array) -> Array:
            return q.reshape(*q.shape[:-2], 12)

        height, height_rate = jax.jvp(
            lambda t: self._height(command, t), (phase * period - stance_time / 2.0,), (jnp.ones_like(phase),)
        )
        zero = jnp.zeros_like(height)
        at_rest = self._at_rest(command)[..., None]
        return Reference(
            joint_position=flat(choose(q[..., 0, :, :], q_swing)),
            joint_velocity=flat(choose(qd[..., 0, :, :], qd_swing)),
            spring_compression=choose(spring[..., 0, :], at_rest),
            spring_velocity=choose(spring_rate[..., 0, :], 0.0),
            height=height,
            height_velocity=height_rate,
            up=jnp.stack([zero, zero, zero + 1.0], axis=-1),
            pitch=zero,
            pitch_rate=zero,
            velocity=jnp.stack([command[..., 0], command[..., 1], height_rate], axis=-1),
            contact=(in_stance | (self.stepping(command)[..., None] < STANDING)).astype(phase.dtype),
            torque=jnp.zeros((*height.shape, 12), dtype=height.dtype),
        )

    def _stance_time(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """About the lesser of `slow_stance` and the time that the sweep takes, s."""
        s2 = square_speed(command, self.hardware)
        return self.slow_stance * jax.lax.rsqrt(1.0 + s2 * (self.slow_stance / (self._scale * self.sweep)) ** 2)

    def _height(self, command: Float[Array, "... 3"], tau: Float[Array, "..."]) -> Float[Array, "..."]:
        """Trunk centre above the ground `tau` seconds after mid-stance of either pair of legs, m.

        Rise and fall are the first harmonic of the answer to the legs' force: of relative size 2 for short
        impulses and 2/3 for half sines that follow each other without a gap.
        """
        period = 1.0 / self.phase_rate(command)
        harmonic = 2.0 - 4.0 / 3.0 * (2.0 * self._stance_time(command) / period) ** 2
        amplitude = self.stepping(command) * harmonic * conventions.GRAVITY * (period / (4.0 * jnp.pi)) ** 2
        return self._scale * self.height - amplitude * jnp.cos(4.0 * jnp.pi / period * tau)

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """0 when standing, 1 on the move."""
        s2 = square_speed(command, self.hardware)
        return s2 / (s2 + self.stepping_speed**2)

    def _at_rest(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """The part of a spring's compression that does not change with time, m: all of it when standing."""
        return (1.0 - self.stepping(command)) * self._sag

    def _stance(
        self, command: Float[Array, "... 3"], tau: Float[Array, "... k 4"]
    ) -> tuple[Float[Array, "... k 4 3"], Float[Array, "... k 4"]]:
        """Joint angles (rad) and spring compressions (m) of legs `tau` seconds from the middle of their stance."""
        command = command[..., None, :]
        stance_time = self._stance_time(command)
        mean = self.stepping(command) * self._sag / (stance_time * self.phase_rate(command))
        most = 1.2 * self.hardware.spring_travel  # beyond, the stop takes the force
        mean = mean * (1.0 + (1.5 * mean / most) ** 8) ** -0.125
        w = 1.0 - (2.0 * tau / stance_time[..., None]) ** 2
        pulse = w * (self.landing + (1.0 - self.landing) * w) / (2.0 / 3.0 - 2.0 / 15.0 * (1.0 - self.landing))
        spring = self._at_rest(command)[..., None] + mean[..., None] * pulse

        nominal = jnp.asarray(nominal_feet(self.hardware), dtype=tau.dtype)
        seen_from_above = ground(nominal, command[..., :2], command[..., 2:], tau)
        z = jnp.asarray(self._sole_clearance, tau.dtype) - self._height(command[..., None, :], tau)
        feet = jnp.concatenate([seen_from_above, z[..., None]], axis=-1)
        return kinematics.joint_angles(feet, spring, self.hardware), spring

    def _swing(
        self,
        command: Float[Array, "... 3"],
        s: Float[Array, "... 4"],
        lift_off: tuple[Float[Array, "... 4 3"], Float[Array, "... 4 3"]],
        touchdown: tuple[Float[Array, "... 4 3"], Float[Array, "... 4 3"]],
    ) -> tuple[Float[Array, "... 4 3"], Float[Array, "... 4 3"]]:
        """Joint angles and speeds at the share `s` of a swing between two pairs (angles, speeds).

        Speed is out (1 - s)^n + back s^n + mean 30 s^2 (1 - s)^2, plus that of the flexion 16 s^2 (1 - s)^2, which
        leaves every knee in mid-swing bent by `flexion` beyond its mean at lift-off and touchdown.
        """
        (start, out), (end, back) = lift_off, touchdown
        n, time = self.follow_through, self.swing_time
        mean = (end - start) / time - (out + back) / (n + 1)
        followed = time / (n + 1) * (out - back) / 2.0  # what the follow-through leaves in mid-swing
        bend = self.hardware.anatomy.geometry.bend
        flexion = (self.stepping(command) * self.flexion)[..., None] - jnp.asarray(bend, s.dtype) * followed[..., 2]
        flexion = flexion[..., None] * jnp.asarray(np.outer(bend, FLEXION), dtype=s.dtype)
        s = s[..., None]
        r = 1.0 - s
        q = start + time / (n + 1) * (out * (1.0 - r ** (n + 1)) + back * s ** (n + 1))
        q = q + time * mean * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) + flexion * 16.0 * (s * r) ** 2
        qd = out * r**n + back * s**n + mean * 30.0 * (s * r) ** 2 + flexion / time * 32.0 * s * r * (r - s)
        return q, qd

    @property
    def _scale(self) -> float:
        """Size of the legs relative to BP2's."""
        return self.hardware.anatomy.leg_length / bp2.THIGH_LENGTH

    @property
    def _sole_clearance(self) -> Float[np.ndarray, "4"]:
        """Height of each sole over the ground, m: the sphere of a leg that leans touches elsewhere."""
        anatomy = self.hardware.anatomy
        lean = np.reshape(anatomy.stand, (4, 3))[:, 1:].sum(axis=1)
        return anatomy.geometry.foot_radius * (1.0 - np.cos(lean))

    @property
    def _sag(self) -> float:
        """Compression of a spring that carries a quarter of the robot, m."""
        if not self.hardware.anatomy.sprung:
            return 0.0
        return AXIAL_SHARE * self.hardware.mass * conventions.GRAVITY / 4.0 / self.hardware.spring_stiffness
