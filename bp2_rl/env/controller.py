"""What runs on the robot 200 times a second: the same functions in MJX training and in C MuJoCo rollouts.

    observation = controller.observe(state, command, measurement)
    action = policy(observation)
    state, targets, reference = controller.act(state, command, action)

The targets go to the 1 kHz PD loop.
"""

import math

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.env.observations import STAND, Measurement, actor_observation
from bp2_rl.errors import UserError
from bp2_rl.gait.collocation.gait import CollocationGait
from bp2_rl.gait.kinematic import KinematicGait
from bp2_rl.gait.reference import Reference, ReferenceMotion
from bp2_rl.gait.standing import Standing
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import Actuator
from bp2_rl.settings.env import EnvConfig


class ControllerState(struct.PyTreeNode):
    """What the controller remembers from one control step to the next."""

    phase: Float[Array, "..."]  # cycles
    last_action: Float[Array, "... 12"]
    gait_command: Float[Array, "... 3"]  # m/s and rad/s: what the reference motion follows


class Targets(struct.PyTreeNode):
    """What the joint PD loop follows until the next control step."""

    position: Float[Array, "... 12"]  # rad
    velocity: Float[Array, "... 12"]  # rad/s


class Controller:
    """Phase clock, observation, and the meaning of actions. Pure functions of arrays for one robot; vmap for more."""

    def __init__(self, config: EnvConfig):
        self._control = config.control
        self._approach = -math.expm1(-specs.CONTROL_STEP / config.control.gait_lag) if config.control.gait_lag else 1.0
        self.reference: ReferenceMotion = motion_of(config)

    def init(
        self, phase: Float[Array, "..."] | float = 0.0, command: Float[Array, "... 3"] | None = None
    ) -> ControllerState:
        """The state at the start of an episode, at rest or moving as this command says."""
        return ControllerState(
            phase=jnp.asarray(phase, jnp.float32),
            last_action=jnp.zeros(specs.NUM_MOTORS),
            gait_command=jnp.zeros(3) if command is None else command,
        )

    def observe(
        self, state: ControllerState, command: Float[Array, "... 3"], measurement: Measurement
    ) -> Float[Array, "... seen"]:
        """The policy's observation (see `observations.layout_of`) under the present command, m/s and rad/s."""
        lags = self._control.gait_lag > 0.0
        hand = 1.0 if self._control.clock_at_rest else self.reference.stepping(state.gait_command if lags else command)
        gait_command = state.gait_command if lags else None
        return actor_observation(command, state.phase, measurement, state.last_action, hand, gait_command)

    def act(
        self, state: ControllerState, command: Float[Array, "... 3"], action: Float[Array, "... 12"]
    ) -> tuple[ControllerState, Targets, Reference]:
        """Advance the phase by one control step under the present command and turn the action into joint targets.

        The reference follows g, with dg/dt = (command - g) / `gait_lag`, or the command itself. With the targets comes
        the reference at the end of the step.

        `residual`: targets are the reference at the *end* of the step, plus action_scale x action, with the
        reference's velocity; a share `feedforward` of its torque comes in as the offset that the PD law turns into it.
        `absolute`: standing pose plus action_scale x action, with zero velocity.
        """
        control = self._control
        gait = command
        if control.gait_lag:
            gait = state.gait_command + self._approach * (command - state.gait_command)
        phase = (state.phase + specs.CONTROL_STEP * self.reference.phase_rate(gait)) % 1.0
        reference = self.reference(gait, phase)
        action = jnp.clip(action, -control.action_limit, control.action_limit)
        if control.mode == "residual":
            centre = reference.joint_position + control.feedforward / control.stiffness * reference.torque
            velocity = reference.joint_velocity
        else:
            centre, velocity = jnp.asarray(STAND), jnp.zeros(specs.NUM_MOTORS)
        targets = Targets(position=centre + control.action_scale * action, velocity=velocity)
        return ControllerState(phase=phase, last_action=action, gait_command=gait), targets, reference


def motion_of(config: EnvConfig) -> ReferenceMotion:
    """The reference motion that the config names, on its robot.

    Raises:
        UserError: the motion library cannot be read, is of another robot, or trots lower than where a robot has fallen.
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
    """The motors under the controller, with its gains and at full strength."""
    control = config.control
    return Actuator.from_hardware(
        config.hardware,
        stiffness=control.stiffness,
        damping=control.damping,
        torque_rate=control.torque_rate,
    )
