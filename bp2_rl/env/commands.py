"""Velocity commands during training: drawn, ramped, drawn anew; and each robot's speed curriculum."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.env.config import CommandConfig, CurriculumConfig
from bp2_rl.robot import specs


class CommandState(struct.PyTreeNode):
    """The present command on its way to a target."""

    current: Float[Array, "... 3"]  # v_x, v_y (m/s), omega_z (rad/s)
    target: Float[Array, "... 3"]
    acceleration: Float[Array, "..."]  # m/s2, of the forward command
    time_left: Float[Array, "..."]  # s, until a new target is drawn
    error: Float[Array, "..."]  # m, time integral of the forward speed error since the target was drawn
    time: Float[Array, "..."]  # s, since the target was drawn


def fastest(level: Float[Array, ""], config: CommandConfig, curriculum: CurriculumConfig) -> Float[Array, ""]:
    """The largest forward command at a curriculum level in [0, 1], m/s."""
    return curriculum.start_speed + level * (config.max_forward - curriculum.start_speed)


def draw_target(key: Array, top: Float[Array, ""], config: CommandConfig) -> Float[Array, "3"]:
    """A command (v_x, v_y, omega_z): forward uniform up to `top`, lateral and yaw smaller at speed, often straight."""
    keys = jax.random.split(key, 5)
    forward = jax.random.uniform(keys[0], minval=-config.max_backward, maxval=top)
    turn = jax.random.uniform(keys[1], (2,), minval=-1.0, maxval=1.0)
    turn *= jnp.array([config.max_lateral, config.max_yaw_rate])
    turn *= 1.0 - 0.5 * jnp.abs(forward) / config.max_forward
    turn *= jax.random.bernoulli(keys[2], 1.0 - config.straight_fraction)
    stand = jax.random.bernoulli(keys[3], config.stand_fraction)
    return jnp.where(stand, 0.0, jnp.concatenate([forward[None], turn]))


def draw(key: Array, start: Float[Array, "3"] | None, top: Float[Array, ""], config: CommandConfig) -> CommandState:
    """A new target from `start` (None: already at the target)."""
    key_target, key_acceleration, key_time = jax.random.split(key, 3)
    target = draw_target(key_target, top, config)
    zero = jnp.zeros(())
    return CommandState(
        current=target if start is None else start,
        target=target,
        acceleration=jax.random.uniform(key_acceleration, minval=config.acceleration[0], maxval=config.acceleration[1]),
        time_left=jax.random.uniform(key_time, minval=config.hold_time[0], maxval=config.hold_time[1]),
        error=zero,
        time=zero,
    )


def advance(
    state: CommandState,
    level: Float[Array, ""],
    forward_velocity: Float[Array, ""],
    key: Array,
    config: CommandConfig,
    curriculum: CurriculumConfig,
) -> tuple[CommandState, Float[Array, ""]]:
    """One control step: (command state, curriculum level).

    When a target's time is over and the mean speed error was within tolerance, the level rises.
    """
    dt = specs.CONTROL_STEP
    rate = jnp.stack([state.acceleration, *(jnp.asarray(config.turn_acceleration),) * 2])
    moved = state.replace(
        current=state.current + jnp.clip(state.target - state.current, -rate * dt, rate * dt),
        time_left=state.time_left - dt,
        error=state.error + dt * jnp.abs(forward_velocity - state.current[0]),
        time=state.time + dt,
    )
    expired = moved.time_left <= 0.0
    # Only a segment near the robot's present limit says something about that limit.
    top = fastest(level, config, curriculum)
    near_limit = moved.target[0] > 0.6 * top
    tracked = moved.error < curriculum.tolerance * (1.0 + jnp.abs(moved.target[0])) * moved.time
    level = jnp.where(expired & near_limit & tracked, jnp.minimum(level + curriculum.raise_by, 1.0), level)
    fresh = draw(key, moved.current, fastest(level, config, curriculum), config)
    return jax.tree.map(lambda new, old: jnp.where(expired, new, old), fresh, moved), level
