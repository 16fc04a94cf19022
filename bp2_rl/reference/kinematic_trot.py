"""The kinematic gait generator: a trot for forward, lateral and yaw commands, in closed
form; and `Standing`, for learning without a gait.

Stance: a foot is fixed in the world, so in the trunk frame it obeys p' = -v - omega x p
exactly, while its spring takes the pulse of compression that carries the robot's
weight. Joint angles follow by inverse kinematics.

Swing: the joints leave with the angles and speeds of lift-off and come to those of
touchdown along a polynomial, with a bump of knee flexion that lifts the foot by much
the same at any speed. So the joint angles are continuously differentiable in time, and
no overshoot of the foot can leave the reach of the leg.

Period and duty follow the command so that the sweep of a stance stays within reach at
every speed, and everything grows smoothly out of standing still.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.reference.interface import Reference
from bp2_rl.reference.stepping import STANDING, foot_circle, nominal_feet
from bp2_rl.reference.trot_law import TrotLaw
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.settings.reference import KinematicConfig

# of a foot's force is along its spring; found on rails, where the ground then bears the
# weight
AXIAL_SHARE = 0.78
# of the phase clock that the policy sees; a trot at 10 m/s takes about a third of a
# second
CYCLES_PER_SECOND = 3.0


@dataclasses.dataclass(frozen=True)
class KinematicGait(KinematicConfig):
    """The kinematic trot of a robot, as a `ReferenceMotion`."""

    hardware: HardwareSpec = IDEAL

    @functools.cached_property
    def law(self) -> TrotLaw:
        """The `TrotLaw` of the gait, with this robot's lengths."""
        anatomy = self.hardware.anatomy
        scale = anatomy.leg_length / bp2.THIGH_LENGTH  # of the legs, relative to BP2's
        lean = np.reshape(anatomy.stand, (4, 3))[:, 1:].sum(axis=1)
        load = AXIAL_SHARE * self.hardware.mass * conventions.GRAVITY / 4.0
        return TrotLaw(
            legs=anatomy.geometry,
            nominal=nominal_feet(self.hardware),
            sole_clearance=anatomy.geometry.foot_radius * (1.0 - np.cos(lean)),
            circle=foot_circle(self.hardware),
            height=scale * self.height,
            sweep=scale * self.sweep,
            slow_stance=self.slow_stance,
            swing_time=self.swing_time,
            flexion=self.flexion,
            follow_through=self.follow_through,
            landing=self.landing,
            stepping_speed=self.stepping_speed,
            sag=load / self.hardware.spring_stiffness if anatomy.sprung else 0.0,
            spring_travel=self.hardware.spring_travel,
        )

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the frequency of the gait at a command, cycles per second."""
        return self.law.phase_rate(command)

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the size of the steps at a command: 0 when standing, close to 1 on the
        move."""
        return self.law.stepping(command)

    def __call__(
        self, command: Float[Array, "... 3"], phase: Float[Array, "..."]
    ) -> Reference:
        """Return the reference at a command and a phase (see `ReferenceMotion`)."""
        law, phase = self.law, phase - jnp.floor(phase)
        q, qd, spring, spring_rate = law.joints(command, phase, jax.jvp)
        stance_time, period = law.stance_time(command), 1.0 / law.phase_rate(command)
        tau = phase * period - stance_time / 2.0
        height, height_rate = jax.jvp(
            lambda t: law.trunk_height(command, t), (tau,), (jnp.ones_like(tau),)
        )
        zero = jnp.zeros_like(height)
        contact = law.in_stance(command, phase)[0] | (
            law.stepping(command)[..., None] < STANDING
        )
        return Reference(
            joint_position=q.reshape(*q.shape[:-2], 12),
            joint_velocity=qd.reshape(*qd.shape[:-2], 12),
            spring_compression=spring,
            spring_velocity=spring_rate,
            height=height,
            height_velocity=height_rate,
            up=jnp.stack([zero, zero, zero + 1.0], axis=-1),
            pitch=zero,
            pitch_rate=zero,
            velocity=jnp.stack(
                [command[..., 0], command[..., 1], height_rate], axis=-1
            ),
            contact=contact.astype(phase.dtype),
            torque=jnp.zeros((*height.shape, 12), dtype=height.dtype),
        )


@dataclasses.dataclass(frozen=True)
class Standing:
    """A reference motion that stands still under every command."""

    hardware: HardwareSpec = IDEAL

    @property
    def height(self) -> float:
        """Height of the trunk's centre above the ground, m."""
        return KinematicGait(hardware=self.hardware).height

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the frequency of the phase clock, cycles per second, for every
        command."""
        return jnp.full(command.shape[:-1], CYCLES_PER_SECOND)

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return 1 for every command, so that a policy without a reference gait
        observes the clock."""
        return jnp.ones(command.shape[:-1])

    def __call__(
        self, command: Float[Array, "... 3"], phase: Float[Array, "..."]
    ) -> Reference:
        """Return the standing pose, with the horizontal velocity that is commanded."""
        pose = KinematicGait(hardware=self.hardware)(jnp.zeros_like(command), phase)
        planar = jnp.concatenate(
            [command[..., :2], jnp.zeros_like(command[..., :1])], axis=-1
        )
        return pose.replace(velocity=planar)
