"""Velocity commands during training: random targets, ramps toward them, and each
robot's speed curriculum."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.base.arrays import ArrayT
from bp2_rl.robot import conventions
from bp2_rl.robot.operator import approach
from bp2_rl.settings.env import CommandConfig, EnvConfig


class CommandState(struct.PyTreeNode):
    """The command, its target, and how well the robot tracked commands near its
    limit."""

    current: Float[Array, "... 3"]  # v_x, v_y (m/s), omega_z (rad/s)
    target: Float[Array, "... 3"]
    acceleration: Float[Array, "..."]  # m/s2, of the forward command
    # s, from reaching the target's forward speed to the next draw
    time_left: Float[Array, "..."]
    # m, integral of the forward speed error near the limit, since the last draw
    error: Float[Array, "..."]
    time: Float[Array, "..."]  # s, spent near the limit since the last draw


def max_forward_at(level: Float[Array, ""], config: EnvConfig) -> Float[Array, ""]:
    """Return the largest forward command at a curriculum level in [0, 1], m/s."""
    top, start = config.commands.max_forward, config.curriculum.start_speed
    start = top if start is None else start
    return start + level * (top - start)


def sideways_limits(forward: ArrayT, config: CommandConfig) -> tuple[ArrayT, ArrayT]:
    """Return the largest lateral command (m/s) and yaw rate (rad/s) at a forward speed.

    The yaw rate times the speed is the turn's lateral acceleration. NumPy and JAX
    alike.
    """
    xp = forward.__array_namespace__()
    speed = xp.abs(forward)
    lateral = config.max_lateral * (1.0 - 0.5 * speed / config.max_forward)
    turn = config.max_turn / xp.maximum(speed, 1e-6)
    return lateral, xp.minimum(config.max_yaw_rate, turn)


def draw_target(
    key: Array, top: Float[Array, ""], config: CommandConfig
) -> Float[Array, "3"]:
    """Draw a target command (v_x, v_y, omega_z), m/s and rad/s.

    The forward speed is at most `top`, often near `top` or slow; lateral and yaw
    commands are smaller at speed.
    """
    keys = jax.random.split(key, 6)
    anywhere = jax.random.uniform(keys[0], minval=-config.max_backward, maxval=top)
    near_top = jax.random.uniform(keys[1], minval=0.9, maxval=1.0) * top
    forward = jnp.where(
        jax.random.bernoulli(keys[2], config.limit_fraction), near_top, anywhere
    )
    if config.slow_fraction:
        key_whether, key_how = jax.random.split(jax.random.fold_in(key, 6))
        slowly = jax.random.uniform(key_how, maxval=jnp.minimum(config.slow, top))
        forward = jnp.where(
            jax.random.bernoulli(key_whether, config.slow_fraction), slowly, forward
        )
    lateral, yaw_rate = jax.random.uniform(keys[3], (2,), minval=-1.0, maxval=1.0)
    most_lateral, most_yaw_rate = sideways_limits(forward, config)
    lateral, yaw_rate = lateral * most_lateral, yaw_rate * most_yaw_rate
    turning = jax.random.bernoulli(keys[4], 1.0 - config.straight_fraction)
    stand = jax.random.bernoulli(keys[5], config.stand_fraction)
    return jnp.where(
        stand, 0.0, jnp.stack([forward, turning * lateral, turning * yaw_rate])
    )


def draw(
    key: Array,
    start: Float[Array, "3"] | None,
    top: Float[Array, ""],
    config: CommandConfig,
) -> CommandState:
    """Draw a new target, and return the command state on its way there from `start`
    (None: already at the target)."""
    key_target, key_acceleration, key_time = jax.random.split(key, 3)
    target = draw_target(key_target, top, config)
    hold = jnp.asarray(config.hold_time)
    if config.stand_time is not None:
        hold = jnp.where(jnp.any(target != 0.0), hold, jnp.asarray(config.stand_time))
    return CommandState(
        current=target if start is None else start,
        target=target,
        acceleration=jax.random.uniform(
            key_acceleration,
            minval=config.acceleration[0],
            maxval=config.acceleration[1],
        ),
        time_left=jax.random.uniform(key_time, minval=hold[0], maxval=hold[1]),
        error=jnp.zeros(()),
        time=jnp.zeros(()),
    )


def with_command_error(
    key: Array,
    state: CommandState,
    standing: Array,
    top: Float[Array, ""],
    config: EnvConfig,
) -> CommandState:
    """Return a command that differs from the speed at which a running robot starts, as
    in fast launches and in braking.

    The difference is the cube of a uniform number, so that most differences are small.
    """
    error = (
        config.reset.command_error
        * jax.random.uniform(key, minval=-1.0, maxval=1.0) ** 3
    )
    forward = jnp.clip(state.current[0] + error, -config.commands.max_backward, top)
    return state.replace(
        current=jnp.where(standing, state.current, state.current.at[0].set(forward))
    )


def with_standing_time(
    key: Array, state: CommandState, standing: Array, config: EnvConfig
) -> CommandState:
    """Command a robot that starts at rest to stand for a while, before its first target
    is drawn."""
    time = jax.random.uniform(
        key, minval=config.reset.standing_time[0], maxval=config.reset.standing_time[1]
    )
    return state.replace(
        target=jnp.where(standing, state.current, state.target),
        time_left=jnp.where(standing, time, state.time_left),
    )


def advance(
    state: CommandState,
    level: Float[Array, ""],
    forward_velocity: Float[Array, ""],
    key: Array,
    config: EnvConfig,
) -> tuple[CommandState, Float[Array, ""]]:
    """Return the command state and the curriculum level one control step later.

    Before a new target is drawn, the level rises if the robot was commanded near its
    limit for long enough and followed within tolerance. Commands far from the limit do
    not count, because they do not show whether the robot can go faster. Without a start
    speed the limit does not rise, the level concerns only the ground, and all commands
    count.

    The hold begins when the command reaches the target's forward speed; lateral and yaw
    commands may need another half second, or a second from a stand.
    """
    dt, curriculum = conventions.CONTROL_STEP, config.curriculum
    top = max_forward_at(level, config)
    rate = jnp.stack(
        [state.acceleration, *(jnp.asarray(config.commands.turn_acceleration),) * 2]
    )
    everywhere = curriculum.start_speed is None
    near = state.current[0] >= (0.0 if everywhere else curriculum.near) * top
    reached = state.current[0] == state.target[0]
    asked = approach(state.current, state.target, rate * dt)
    current = config.control.tell(state.current, asked)
    # The target's yaw rate may exceed the limit at the present speed.
    _, turn = sideways_limits(current[0], config.commands)
    moved = state.replace(
        current=current.at[2].set(jnp.clip(current[2], -turn, turn)),
        time_left=state.time_left - dt * reached,
        error=state.error + dt * near * jnp.abs(forward_velocity - state.current[0]),
        time=state.time + dt * near,
    )
    expired = moved.time_left <= 0.0
    tracked = (moved.time >= curriculum.evidence) & (
        moved.error < curriculum.tolerance * (1.0 + top) * moved.time
    )
    level = jnp.where(
        expired & tracked, jnp.minimum(level + curriculum.raise_by, 1.0), level
    )
    fresh = draw(key, moved.current, max_forward_at(level, config), config.commands)
    return jax.tree.map(
        lambda new, old: jnp.where(expired, new, old), fresh, moved
    ), level
