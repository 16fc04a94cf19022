"""Initial states of episodes: on the running reference with its velocities, or at
rest."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.env import commands, observations, randomization, termination
from bp2_rl.env.commands import CommandState
from bp2_rl.env.controller import Controller, ControllerState, Targets
from bp2_rl.env.physics.interface import Physics
from bp2_rl.env.randomization import Randomization
from bp2_rl.reference.interface import Reference
from bp2_rl.robot import conventions
from bp2_rl.robot.coordinates import (
    compressions,
    joint_positions,
    motor_indices,
    with_legs,
)
from bp2_rl.settings.env import EnvConfig

NUM_KEYS = 5
"""Number of random keys that the draw of an episode takes."""


class PipelineState(struct.PyTreeNode):
    """The state of an episode: physics, controller, command, randomisation and
    averages."""

    physics: Physics
    controller: ControllerState
    command: CommandState
    randomization: Randomization
    mean_torque: Float[Array, "... 12"]  # Nm, over the last control step
    # m/s and rad/s: velocity minus command, averaged if the reward uses averages
    tracking_error: Float[Array, "... 3"]
    mean_action: Float[Array, "... 12"]  # averaged over `rewards.ACTION_AVERAGING`

    @property
    def q(self) -> Float[Array, "... nq"]:
        """Return the coordinates, by the name that Brax's renderer asks for."""
        return self.physics.qpos

    @property
    def qd(self) -> Float[Array, "... nv"]:
        """Return MuJoCo's velocities: m/s, rad/s."""
        return self.physics.qvel


class EpisodeStarts:
    """Draws initial states of episodes, as a config describes them, for a robot with
    this model."""

    def __init__(
        self, config: EnvConfig, controller: Controller, model: mujoco.MjModel
    ):
        self._config, self._controller, self._model = config, controller, model
        self._stand = np.asarray(model.key("stand").qpos, np.float32)

    def draw(
        self, keys: Sequence[Array] | Array, level: Float[Array, ""]
    ) -> tuple[PipelineState, Reference]:
        """Draw a new episode at a curriculum level, and return it with its reference;
        `keys` are `NUM_KEYS` random keys."""
        config = self._config
        key_command, key_stand, key_phase, key_pose, key_robot = keys
        standing = jax.random.bernoulli(key_stand, config.reset.standing_fraction)
        top = commands.max_forward_at(level, config)
        command = commands.draw(key_command, None, top, config.commands)
        command = command.replace(current=jnp.where(standing, 0.0, command.current))
        phase = jax.random.uniform(key_phase)
        reference = self._controller.reference(command.current, phase)
        initial_command = command
        if config.reset.command_error:
            initial_command = commands.with_command_error(
                jax.random.fold_in(key_command, 1), command, standing, top, config
            )
        if config.reset.standing_time[1]:
            initial_command = commands.with_standing_time(
                jax.random.fold_in(key_command, 2), initial_command, standing, config
            )
        qpos, qvel = self._pose(key_pose, standing, reference, command.current)
        targets = Targets(reference.joint_position, reference.joint_velocity)
        robot = randomization.draw(
            key_robot, config.randomization, self._model.nbody, config.hardware
        )
        # by a separate key, so that training on flat ground draws the same robots as
        # without this line
        robot = randomization.with_terrain(
            jax.random.fold_in(key_robot, 0), robot, config.terrain, level
        )
        qpos = observations.set_down(qpos, robot.ground, config.hardware)
        episode = PipelineState(
            physics=_physics_at_rest(qpos, qvel, targets),
            controller=self._controller.init(phase),
            command=initial_command,
            randomization=robot,
            mean_torque=jnp.zeros(conventions.NUM_MOTORS),
            tracking_error=jnp.zeros(3),
            mean_action=jnp.zeros(conventions.NUM_MOTORS),
        )
        return episode, reference

    def at_rest(self) -> Physics:
        """Return a standing robot, which replaces a robot whose physics exploded."""
        stand = Targets(
            jnp.asarray(joint_positions(self._stand)), jnp.zeros(conventions.NUM_MOTORS)
        )
        return _physics_at_rest(
            jnp.asarray(self._stand), jnp.zeros(self._model.nv), stand
        )

    def _pose(
        self,
        key: Array,
        standing: Array,
        reference: Reference,
        command: Float[Array, "3"],
    ) -> tuple[Array, Array]:
        """Return (qpos, qvel) on the reference with its velocities, or standing still;
        both with joint noise."""
        config = self._config.reset
        key_joint, key_velocity = jax.random.split(key)
        joints = jnp.where(
            standing, joint_positions(self._stand), reference.joint_position
        )
        joints += jax.random.uniform(
            key_joint, (12,), minval=-config.joint_noise, maxval=config.joint_noise
        )
        height = jnp.where(standing, self._stand[2], reference.height)
        half_pitch = 0.5 * jnp.where(standing, 0.0, reference.pitch)
        qpos = jnp.zeros(self._model.nq)
        qpos = (
            qpos.at[2]
            .set(height)
            .at[3]
            .set(jnp.cos(half_pitch))
            .at[5]
            .set(jnp.sin(half_pitch))
        )
        qpos = with_legs(
            qpos,
            joints,
            jnp.where(
                standing, compressions(self._stand), reference.spring_compression
            ),
        )
        qvel = jnp.zeros(self._model.nv)
        qvel = (
            qvel.at[:3]
            .set(reference.velocity)
            .at[4]
            .set(reference.pitch_rate)
            .at[5]
            .set(command[2])
        )
        qvel = with_legs(qvel, reference.joint_velocity, reference.spring_velocity)
        spread = config.velocity_noise
        qvel *= 1.0 + jax.random.uniform(
            key_velocity, qvel.shape, minval=-spread, maxval=spread
        )
        return self._without_self_collision(qpos, jnp.where(standing, 0.0, qvel))

    def _without_self_collision(
        self, qpos: Float[Array, " nq"], qvel: Float[Array, " nv"]
    ) -> tuple[Array, Array]:
        """Return (qpos, qvel) with legs that collide turned into their hips' planes."""
        self_collision = termination.self_collision(
            qpos, self._config.termination, self._config.hardware
        )
        if self_collision is None:
            return qpos, qvel
        abads = motor_indices(self._model.nv)[0::3]
        straight = qpos.at[abads + 1].set(0.0), qvel.at[abads].set(0.0)
        return jnp.where(self_collision, straight[0], qpos), jnp.where(
            self_collision, straight[1], qvel
        )


def _physics_at_rest(
    qpos: Float[Array, " nq"], qvel: Float[Array, " nv"], targets: Targets
) -> Physics:
    """Return a physics state without torque, whose target history holds only these
    joint targets."""
    # One array, taken apart again: XLA would fuse separate ones with the reference, and
    # round them otherwise.
    now = jnp.stack([targets.position, targets.velocity])
    position, velocity = jnp.moveaxis(jnp.stack([now, now]), 1, 0)
    return Physics(
        qpos=qpos,
        qvel=qvel,
        qacc_warmstart=jnp.zeros_like(qvel),
        torque=jnp.zeros(conventions.NUM_MOTORS),
        targets=Targets(position, velocity),
    )
