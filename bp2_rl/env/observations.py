"""The robot's sensors, and the observations of policy and critic."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.coordinates import (
    compression_rates,
    compressions,
    joint_positions,
    joint_velocities,
)
from bp2_rl.robot.ground import Ground, over_ground
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import foot_position, yaw_of
from bp2_rl.robot.observation import (
    COMMAND,
    JOINTS,
    LEG,
    MOTORS,
    OBSERVATION_TERMS,
    SCALAR,
    VECTOR,
    Mirror,
    ObservationInputs,
    ObservationTerm,
    Source,
)
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.settings.task import user_code
from bp2_rl.settings.terrain import TerrainConfig

if TYPE_CHECKING:
    from bp2_rl.env.episode import PipelineState

UP = np.array([0.0, 0.0, 1.0], np.float32)


Layout = tuple[tuple[str, int], ...]
"""The names and sizes of an observation's terms, in order."""


class PrivilegedInputs(NamedTuple):
    """Inputs of the critic's further observation terms, which no sensor measures."""

    episode: "PipelineState"
    velocity: Float[Array, "3"]  # m/s, of the trunk, heading frame
    foot_contact: Float[Array, "4"]  # 1 for each foot that touches the ground
    trunk_mass: Float[Array, ""]  # factor


PRIVILEGED: tuple[ObservationTerm[PrivilegedInputs], ...] = (
    ObservationTerm("velocity", VECTOR, lambda now: now.velocity),
    ObservationTerm(
        "height",
        SCALAR,
        lambda now: over_ground(now.episode.q, now.episode.randomization.ground)[2],
    ),
    ObservationTerm("spring_compression", LEG, lambda now: compressions(now.episode.q)),
    ObservationTerm(
        "spring_velocity", LEG, lambda now: compression_rates(now.episode.qd)
    ),
    ObservationTerm("foot_contact", LEG, lambda now: now.foot_contact),
    ObservationTerm("target_command", COMMAND, lambda now: now.episode.command.target),
    ObservationTerm("friction", SCALAR, lambda now: now.episode.randomization.friction),
    ObservationTerm("trunk_mass", SCALAR, lambda now: now.trunk_mass),
    ObservationTerm(
        "com_offset", VECTOR, lambda now: now.episode.randomization.com_offset
    ),
    ObservationTerm("strength", MOTORS, lambda now: now.episode.randomization.strength),
    ObservationTerm("latency", SCALAR, lambda now: now.episode.randomization.latency),
    # averaged if the reward uses averages
    ObservationTerm("tracking_error", COMMAND, lambda now: now.episode.tracking_error),
)
"""The critic's observation terms beyond the policy's, in order: quantities without a
sensor, the command's target, the robot's random parameters, and the errors in the
reward."""


AHEAD, BESIDE = (-0.4, 0.0, 0.4, 0.8, 1.2), (-0.2, 0.0, 0.2)
"""Points at which the critic observes the ground's height, relative to the point below
the trunk, m: along the robot's heading, and to its left."""


def _scan(now: PrivilegedInputs) -> Float[Array, "5 3"]:
    """Return the ground's height at these points minus its height below the trunk,
    m."""
    pose, ground = now.episode.q, now.episode.randomization.ground
    yaw, ahead, beside = yaw_of(pose[3:7]), np.array(AHEAD)[:, None], np.array(BESIDE)
    x = pose[0] + jnp.cos(yaw) * ahead - jnp.sin(yaw) * beside
    y = pose[1] + jnp.sin(yaw) * ahead + jnp.cos(yaw) * beside
    assert ground is not None
    return ground.below(x, y).height - ground.below(pose[0], pose[1]).height


def _vertical(now: PrivilegedInputs) -> Float[Array, "3"]:
    """Return the true vertical in the heading frame of a robot on a slope."""
    yaw, gravity = yaw_of(now.episode.q[3:7]), now.episode.randomization.gravity
    half = jnp.stack([jnp.cos(0.5 * yaw), 0.0 * yaw, 0.0 * yaw, -jnp.sin(0.5 * yaw)])
    assert gravity is not None
    return _rotate(gravity / -GRAVITY, half)


SCAN = Mirror(
    tuple(3 * i + j for i in range(len(AHEAD)) for j in (2, 1, 0)),
    (1,) * 3 * len(AHEAD),
)


def _ground_terms(config: TerrainConfig) -> list[ObservationTerm[PrivilegedInputs]]:
    """Return the critic's observation of the ground."""
    terms = []
    if config.kind != "flat":
        terms.append(ObservationTerm("ground", SCAN, _scan))
    if config.slope[1]:
        terms.append(ObservationTerm("vertical", VECTOR, _vertical))
    return terms


def observation_terms(
    config: EnvConfig,
) -> tuple[ObservationTerm[ObservationInputs], ...]:
    """Return the terms of the policy's observation at one moment: `OBSERVATION_TERMS`, then
    the task's.

    Raises:
        UserError: the task's code was not given.
    """
    return (*OBSERVATION_TERMS, *config.task.task.observations)


def privileged_terms(
    config: EnvConfig,
) -> tuple[ObservationTerm[PrivilegedInputs], ...]:
    """Return the observation terms of the critic alone: `PRIVILEGED`, then the
    ground's, then the task's."""
    ground = _ground_terms(config.terrain)
    return (*PRIVILEGED, *ground, *config.task.task.privileged)


def mirrors_under(config: EnvConfig) -> dict[str, Mirror]:
    """Return the mirrors of both observations and of the action, for left and right
    exchanged, half a cycle on."""
    own = [term.mirror for term in observation_terms(config)]
    privileged = [term.mirror for term in privileged_terms(config)]
    return {
        "state": Mirror.joined(own * (1 + len(config.control.history))),
        "privileged_state": Mirror.joined([*own, *privileged]),
        "action": JOINTS,
    }


def layout_of(config: EnvConfig) -> Layout:
    """Return names and sizes of the policy's observation: the present terms, the
    task's last, and `NAME@K`, their changes in K steps."""
    now = (*LAYOUT, *config.task.observations)
    changes = (
        (f"{name}@{k}", size) for k in config.control.history for name, size in now
    )
    return (*now, *changes)


LAYOUT: Layout = tuple((term.name, term.size) for term in OBSERVATION_TERMS)
"""Names and sizes of `OBSERVATION_TERMS`."""


def size_of(layout: Layout) -> int:
    """Return the length of the observation that a layout describes."""
    return sum(size for _, size in layout)


class Measurement(struct.PyTreeNode):
    """The readings of encoders and IMU."""

    joint_position: Float[Array, "... 12"]  # rad
    joint_velocity: Float[Array, "... 12"]  # rad/s
    up: Float[Array, "... 3"]  # the world's vertical in the body frame
    angular_velocity: Float[Array, "... 3"]  # rad/s, body frame


def sense(
    qpos: Float[Array, " nq"],
    qvel: Float[Array, " nv"],
    gravity: Float[Array, "3"] | None = None,
) -> Measurement:
    """Return the noise-free measurement of a state in MuJoCo's coordinates (free joint:
    rates in the body frame); `gravity`, m/s2, is straight down if it is None."""
    up = jnp.asarray(UP) if gravity is None else gravity / -GRAVITY
    return Measurement(
        joint_position=joint_positions(qpos),
        joint_velocity=joint_velocities(qvel),
        up=_rotate(up, qpos[3:7] * jnp.array([1.0, -1.0, -1.0, -1.0])),
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


def observe(
    terms: Sequence[ObservationTerm[Source]], source: Source
) -> Float[Array, " observation"]:
    """Return the observation vector of these terms, read from their source.

    Raises:
        UserError: a term of a task fails, or is not as long as its mirror image.
    """
    parts = []
    for term in terms:
        with user_code(
            f"observation {term.name} ({term.size} numbers by its mirror image)"
        ):
            parts.append(jnp.reshape(term.read(source), term.size))
    return jnp.concatenate(parts)


def own_number(
    what: str, function: Callable[..., Array], *inputs: object
) -> Float[Array, ""]:
    """Return the number that a function of a task returns, `what` in words.

    Raises:
        UserError: the function fails, or returns more than one number.
    """
    with user_code(f"{what} (one number)"):
        return jnp.asarray(function(*inputs), jnp.float32).reshape(())


class TrunkMotion(struct.PyTreeNode):
    """The trunk's motion seen from a frame that turns with its yaw."""

    velocity: Float[Array, "... 3"]  # m/s
    e_z: Float[Array, "... 3"]  # body vertical axis
    yaw_rate: Float[Array, "..."]  # rad/s, about the world's vertical

    @property
    def horizontal(self) -> Float[Array, "3"]:
        """Return the velocities that a command prescribes: v_x, v_y (m/s) and the yaw
        rate (rad/s)."""
        return jnp.append(self.velocity[:2], self.yaw_rate)


def trunk_motion(qpos: Float[Array, " nq"], qvel: Float[Array, " nv"]) -> TrunkMotion:
    """Return the trunk's velocity, vertical axis and yaw rate in the heading frame."""
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
    """Return `v` rotated by a unit quaternion. Brax has such a function, but importing
    Brax would delay the judge by a second."""
    w, u = quaternion[0], quaternion[1:]
    return (
        2.0 * jnp.dot(u, v) * u
        + (w * w - jnp.dot(u, u)) * v
        + 2.0 * w * jnp.cross(u, v)
    )


def set_down(
    qpos: Float[Array, " nq"], ground: Ground | None, hardware: HardwareSpec
) -> Float[Array, " nq"]:
    """Return a robot moved vertically until its lowest sole is as high over the ground
    as it was over the flat floor."""
    if ground is None:
        return qpos
    soles, below = _on_legs(qpos, compressions(qpos), ground, hardware)
    return qpos.at[2].add(jnp.min(soles) - jnp.min(soles - below))


def shank_in_ground(
    qpos: Float[Array, " nq"], ground: Ground, hardware: HardwareSpec
) -> Bool[Array, ""]:
    """Return whether a knee, or the middle of a shank, is below the ground, for
    instance at the edge of a step. In training only feet have contacts."""
    lower = jnp.asarray(hardware.anatomy.geometry.lower, qpos.dtype)
    shortened = jnp.stack([lower, 0.5 * (lower + compressions(qpos))])
    shanks, below = _on_legs(qpos, shortened, ground, hardware)
    return jnp.any(shanks < below)


def _on_legs(
    qpos: Float[Array, " nq"],
    shortened: Float[Array, "*several 4"],
    ground: Ground,
    hardware: HardwareSpec,
) -> tuple[Float[Array, " ends"], Float[Array, " ends"]]:
    """Return the heights of the ends of legs whose lower parts are shorter by
    `shortened` (m), and the ground's heights below them, m."""
    joints = joint_positions(qpos).reshape(4, 3)
    ends = foot_position(joints, shortened, hardware).reshape(-1, 3)
    x, y, z = (qpos[:3] + jax.vmap(_rotate, (0, None))(ends, qpos[3:7])).T
    return z, ground.below(x, y).height


def soles(
    qpos: Float[Array, " nq"],
    qvel: Float[Array, " nv"],
    hardware: HardwareSpec,
    ground: Ground | None = None,
) -> tuple[Float[Array, "4"], Float[Array, "4"]]:
    """Return each sole's height over the ground below it, m, and the speed it rises at,
    m/s."""
    now = sense(qpos, qvel)
    joints = now.joint_position.reshape(4, 3), compressions(qpos)
    rates = now.joint_velocity.reshape(4, 3), compression_rates(qvel)
    feet, relative = jax.jvp(
        lambda angles, springs: foot_position(angles, springs, hardware), joints, rates
    )
    velocity = relative + jnp.cross(now.angular_velocity, feet)
    height = qpos[2] + feet @ now.up
    if ground is not None:
        height = height - _on_legs(qpos, compressions(qpos), ground, hardware)[1]
    return height, qvel[2] + velocity @ now.up
