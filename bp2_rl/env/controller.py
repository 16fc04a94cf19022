"""The robot's controller, 200 times a second: one law for training and for C MuJoCo.

    state, observation = controller.observe(state, command, measurement)
    action = policy(observation)
    state, targets, reference = controller.act(state, command, action)

The targets go to the 1 kHz PD loop.
"""

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.base.errors import UserError
from bp2_rl.env.observations import (
    Measurement,
    observation_terms,
    observe,
)
from bp2_rl.reference.interface import Reference, ReferenceMotion
from bp2_rl.reference.kinematic_trot import KinematicGait, Standing
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.observation import ObservationInputs
from bp2_rl.settings.env import EnvConfig


class ControllerState(struct.PyTreeNode):
    """The controller's memory from one control step to the next."""

    phase: Float[Array, "..."]  # cycles
    last_action: Float[Array, "... 12"]
    # In the last control steps, newest first, as far back as `history` asks.
    past_frames: Float[Array, "... longest frame"]
    steps: Float[Array, "..."]  # number of valid rows since the start


class Targets(struct.PyTreeNode):
    """The targets of the joint PD loop until the next control step."""

    position: Float[Array, "... 12"]  # rad
    velocity: Float[Array, "... 12"]  # rad/s


class Controller:
    """Phase clock, observation, and the meaning of actions. Pure functions of arrays
    for one robot; vmap for more."""

    def __init__(self, config: EnvConfig):
        self._control = config.control
        self._terms = observation_terms(config)
        self._stand = np.array(config.hardware.anatomy.stand, np.float32)
        self.reference: ReferenceMotion = motion_of(config)

    def init(self, phase: Float[Array, "..."] | float = 0.0) -> ControllerState:
        """Return the controller's state at the start of an episode."""
        return ControllerState(
            phase=jnp.asarray(phase, jnp.float32),
            last_action=jnp.zeros(conventions.NUM_MOTORS),
            # At least a row: an array of no size, split over devices, crashes JAX
            # 0.11.2's compiler.
            past_frames=jnp.zeros(
                (
                    max((1, *self._control.history)),
                    sum(term.size for term in self._terms),
                )
            ),
            steps=jnp.zeros(()),
        )

    def observe(
        self,
        state: ControllerState,
        command: Float[Array, "3"],
        measurement: Measurement,
    ) -> tuple[ControllerState, Float[Array, " observation"]]:
        """Return the state with this observation in its history, and the policy's
        observation (see `observations.layout_of`).

        The command is in m/s and rad/s. A policy without a history leaves the state
        unchanged.
        """
        frame = self.frame(state, command, measurement)
        if not self._control.history:
            return state, frame
        steps = np.array(self._control.history)
        changes = jnp.where(
            steps[:, None] <= state.steps, frame - state.past_frames[steps - 1], 0.0
        )
        remembers = state.replace(
            past_frames=jnp.concatenate([frame[None], state.past_frames[:-1]]),
            steps=state.steps + 1.0,
        )
        return remembers, jnp.concatenate([frame, changes.reshape(-1)])

    def frame(
        self,
        state: ControllerState,
        command: Float[Array, "... 3"],
        measurement: Measurement,
    ) -> Float[Array, "... frame"]:
        """Return the observation at this control step, without a history."""
        amplitude = (
            1.0 if self._control.clock_at_rest else self.reference.stepping(command)
        )
        angle = 2.0 * jnp.pi * state.phase
        now = ObservationInputs(
            command=command,
            clock=amplitude * jnp.stack([jnp.sin(angle), jnp.cos(angle)]),
            **vars(measurement),
            last_action=state.last_action,
            stand=self._stand,
        )
        return observe(self._terms, now)

    def act(
        self,
        state: ControllerState,
        command: Float[Array, "... 3"],
        action: Float[Array, "... 12"],
    ) -> tuple[ControllerState, Targets, Reference]:
        """Advance the phase by one control step under the present command and turn the
        action into joint targets.

        With them comes the reference at the end of the step.

        `residual`: targets are the reference at the *end* of the step, plus
        action_scale x action, with the reference's velocity; a share `feedforward` of
        its torque comes in as the offset that the PD law turns into it.
        `absolute`: standing pose plus action_scale x action, with zero velocity.
        """
        control = self._control
        phase = (
            state.phase + conventions.CONTROL_STEP * self.reference.phase_rate(command)
        ) % 1.0
        reference = self.reference(command, phase)
        action = jnp.clip(action, -control.action_limit, control.action_limit)
        if control.mode == "residual":
            centre = (
                reference.joint_position
                + control.feedforward / control.stiffness * reference.torque
            )
            velocity = reference.joint_velocity
        else:
            centre = jnp.asarray(self._stand)
            velocity = jnp.zeros(conventions.NUM_MOTORS)
        targets = Targets(
            position=centre + control.action_scale * action, velocity=velocity
        )
        return state.replace(phase=phase, last_action=action), targets, reference


def motion_of(config: EnvConfig) -> ReferenceMotion:
    """Return the reference motion that the config names, on its robot.

    Raises:
        UserError: the motion library cannot be read, belongs to another robot, or trots
            below the height of a fall.
    """
    match config.reference:
        case "kinematic":
            motion = KinematicGait(**vars(config.gait), hardware=config.hardware)
        case "collocation":
            motion = CollocationGait(**vars(config.library), hardware=config.hardware)
        case "none":
            motion = Standing(config.hardware)
    if config.termination.min_height >= motion.height:
        raise UserError(
            f"termination.min_height ({config.termination.min_height:g}) must be below the reference's height of "
            f"{motion.height:.3f} m"
        )
    return motion


def motors_of(config: EnvConfig) -> Actuator:
    """Return the motors that a config's controller drives, with its gains and at full
    strength."""
    control = config.control
    return Actuator.from_hardware(
        config.hardware,
        stiffness=control.stiffness,
        damping=control.damping,
        torque_rate=control.torque_rate,
    )
