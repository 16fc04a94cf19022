"""What the robot senses, what the policy sees of it, and what the critic sees beyond
that."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from bp2_rl.robot.coordinates import (
    compression_rates,
    compressions,
    joint_positions,
    joint_velocities,
)
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import foot_position, yaw_of
from bp2_rl.settings.env import ControlConfig, RandomizationConfig

UP = np.array([0.0, 0.0, 1.0], np.float32)


class Entry(NamedTuple):
    """One named part of the observation vector."""

    name: str
    size: int


LAYOUT = (
    Entry("command", 3),
    Entry("phase", 2),
    Entry("joint_position", 12),
    Entry("joint_velocity", 12),
    Entry("up", 3),
    Entry("angular_velocity", 3),
    Entry("last_action", 12),
)
"""The policy's observation, in order: what the paper lists (section RL training) plus
the last action."""

PRIVILEGED = (
    Entry("velocity", 3),
    Entry("height", 1),
    Entry("spring_compression", 4),
    Entry("spring_velocity", 4),
    Entry("foot_contact", 4),
    Entry("target_command", 3),
    Entry("friction", 1),
    Entry("trunk_mass", 1),
    Entry("com_offset", 3),
    Entry("strength", 12),
    Entry("latency", 1),
    Entry("tracking_error", 3),
)
"""What the critic sees beyond that, in order: what no sensor tells, where the command
goes, the draw of the robot, and the errors that the reward looks at."""
CRITIC_LAYOUT = (*LAYOUT, *PRIVILEGED)
"""All that the critic sees: the policy's observation of the moment, without noise, and
more."""


def layout_of(control: ControlConfig) -> tuple[Entry, ...]:
    """Return the policy's observation under this controller: the present one, and
    `NAME@K`, its change in K steps."""
    return (
        *LAYOUT,
        *(
            Entry(f"{name}@{steps}", size)
            for steps in control.history
            for name, size in LAYOUT
        ),
    )


def size_of(layout: tuple[Entry, ...]) -> int:
    """Return the length of the observation that a layout describes."""
    return sum(entry.size for entry in layout)


class Measurement(struct.PyTreeNode):
    """What encoders and IMU report."""

    joint_position: Float[Array, "... 12"]  # rad
    joint_velocity: Float[Array, "... 12"]  # rad/s
    up: Float[Array, "... 3"]  # the world's vertical in the body frame
    angular_velocity: Float[Array, "... 3"]  # rad/s, body frame


def sense(qpos: Float[Array, " nq"], qvel: Float[Array, " nv"]) -> Measurement:
    """Return the noise-free measurement of a state in MuJoCo's coordinates (free joint:
    rates in the body frame)."""
    return Measurement(
        joint_position=joint_positions(qpos),
        joint_velocity=joint_velocities(qvel),
        up=_rotate(jnp.asarray(UP), qpos[3:7] * jnp.array([1.0, -1.0, -1.0, -1.0])),
        angular_velocity=qvel[3:6],
    )


def add_noise(
    measurement: Measurement, config: RandomizationConfig, key: Array
) -> Measurement:
    """Return the measurement with Gaussian noise of the standard deviations in
    `config`."""
    flat, unflatten = ravel_pytree(measurement)
    noise: Measurement = unflatten(jax.random.normal(key, flat.shape))
    return Measurement(
        joint_position=measurement.joint_position
        + config.joint_position_noise * noise.joint_position,
        joint_velocity=measurement.joint_velocity
        + config.joint_velocity_noise * noise.joint_velocity,
        up=measurement.up + config.orientation_noise * noise.up,
        angular_velocity=measurement.angular_velocity
        + config.angular_velocity_noise * noise.angular_velocity,
    )


def actor_observation(
    command: Float[Array, "3"],
    phase: Float[Array, ""],
    measurement: Measurement,
    last_action: Float[Array, "12"],
    stand: Float[np.ndarray, "12"],
    phase_amplitude: Float[Array, ""] | float = 1.0,
) -> Float[Array, "47"]:
    """Return the observation that `LAYOUT` describes.

    Joint positions are relative to `stand`, the standing pose (rad); the phase is
    encoded as `phase_amplitude` x (sin, cos).
    """
    angle = 2.0 * jnp.pi * phase
    return jnp.concatenate(
        [
            command,
            phase_amplitude * jnp.stack([jnp.sin(angle), jnp.cos(angle)]),
            measurement.joint_position - np.asarray(stand, np.float32),
            measurement.joint_velocity,
            measurement.up,
            measurement.angular_velocity,
            last_action,
        ]
    )


class Privileged(NamedTuple):
    """The critic's observation beyond the policy's: the entries of `PRIVILEGED`, in
    their order."""

    velocity: Float[Array, "3"]  # m/s, of the trunk, heading frame
    height: Float[Array, ""]  # m, of the trunk
    spring_compression: Float[Array, "4"]  # m
    spring_velocity: Float[Array, "4"]  # m/s
    foot_contact: Float[Array, "4"]  # 1 for each foot that touches the ground
    target_command: Float[Array, "3"]  # that the present command is on its way to
    friction: Float[Array, ""]
    trunk_mass: Float[Array, ""]  # factor
    com_offset: Float[Array, "3"]  # m, of the trunk
    strength: Float[Array, "12"]  # factor
    latency: Float[Array, ""]  # s
    # m/s and rad/s, averaged where the reward asks for it
    tracking_error: Float[Array, "3"]


def critic_observation(
    policy_observation: Float[Array, "47"], privileged: Privileged
) -> Float[Array, "87"]:
    """Return the vector that `CRITIC_LAYOUT` describes, from what the policy would see
    without noise and more."""
    return jnp.concatenate([policy_observation, *(jnp.ravel(x) for x in privileged)])


class TrunkMotion(struct.PyTreeNode):
    """The trunk's motion seen from a frame that turns with its yaw."""

    velocity: Float[Array, "... 3"]  # m/s
    e_z: Float[Array, "... 3"]  # body vertical axis
    yaw_rate: Float[Array, "..."]  # rad/s, about the world's vertical

    @property
    def horizontal(self) -> Float[Array, "3"]:
        """Return what a command prescribes: v_x, v_y (m/s) and the yaw rate (rad/s)."""
        return jnp.append(self.velocity[:2], self.yaw_rate)


def trunk_motion(qpos: Float[Array, " nq"], qvel: Float[Array, " nv"]) -> TrunkMotion:
    """Return velocity, body vertical axis and yaw rate in the heading frame."""
    quat = qpos[3:7]
    yaw = yaw_of(quat)
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    to_heading = jnp.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return TrunkMotion(
        velocity=to_heading @ qvel[:3],
        e_z=to_heading @ _rotate(jnp.asarray(UP), quat),
        yaw_rate=_rotate(qvel[3:6], quat)[2],
    )


def _rotate(v: Float[Array, "3"], quaternion: Float[Array, "4"]) -> Float[Array, "3"]:
    """Return `v` turned by a unit quaternion. Brax has the like, but its import takes a
    second of the judge's start."""
    w, u = quaternion[0], quaternion[1:]
    return (
        2.0 * jnp.dot(u, v) * u
        + (w * w - jnp.dot(u, u)) * v
        + 2.0 * w * jnp.cross(u, v)
    )


class Soles(struct.PyTreeNode):
    """How high the soles are, and how fast they go up."""

    height: Float[Array, "... 4"]  # m
    rate: Float[Array, "... 4"]  # m/s


def soles(
    qpos: Float[Array, " nq"], qvel: Float[Array, " nv"], hardware: HardwareSpec
) -> Soles:
    """Return how high each sole is over flat ground, and how fast it rises."""
    now = sense(qpos, qvel)
    joints = now.joint_position.reshape(4, 3), compressions(qpos)
    rates = now.joint_velocity.reshape(4, 3), compression_rates(qvel)
    feet, relative = jax.jvp(
        lambda angles, springs: foot_position(angles, springs, hardware), joints, rates
    )
    velocity = relative + jnp.cross(now.angular_velocity, feet)
    return Soles(height=qpos[2] + feet @ now.up, rate=qvel[2] + velocity @ now.up)
