"""Commands stay in range, move at limited rates, and the curriculum moves only on evidence."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env import commands
from bp2_rl.env.config import CommandConfig, CurriculumConfig, EnvConfig
from bp2_rl.errors import UserError
from bp2_rl.robot import specs

CONFIG = CommandConfig(max_forward=10.0, max_backward=1.0)
CURRICULUM = CurriculumConfig(start_speed=3.0)
KEY = jax.random.PRNGKey(0)


def test_targets_cover_their_ranges_and_respect_them():
    keys = jax.random.split(KEY, 20_000)
    targets = np.asarray(jax.vmap(lambda key: commands.draw_target(key, jnp.array(8.0), CONFIG))(keys))
    forward, lateral, yaw_rate = targets.T
    assert -1.0 <= forward.min() < -0.95
    assert 7.95 < forward.max() <= 8.0
    assert 0.4 < np.abs(lateral).max() <= CONFIG.max_lateral
    assert 0.8 < np.abs(yaw_rate).max() <= CONFIG.max_yaw_rate
    standing = np.all(targets == 0.0, axis=1)
    straight = (lateral == 0.0) & (yaw_rate == 0.0) & ~standing
    # Binomial shares of 20 000 draws: a standard deviation is below 0.004.
    assert standing.mean() == pytest.approx(CONFIG.stand_fraction, abs=0.015)
    assert straight.mean() == pytest.approx(CONFIG.straight_fraction * (1 - CONFIG.stand_fraction), abs=0.015)


def test_the_fastest_command_rises_with_the_level_from_start_to_maximum():
    speeds = [float(commands.fastest(jnp.array(level), CONFIG, CURRICULUM)) for level in (0.0, 0.5, 1.0)]
    assert speeds == [3.0, 6.5, 10.0]


def run(state, level, tracking, steps, seed=1):
    """`tracking(command)` is the speed the robot runs at."""

    def step(carry, key):
        state, level = carry
        state, level = commands.advance(state, level, tracking(state.current[0]), key, CONFIG, CURRICULUM)
        return (state, level), (level, state.current)

    return jax.lax.scan(step, (state, level), jax.random.split(jax.random.PRNGKey(seed), steps))[1]


def test_commands_move_no_faster_than_their_rates():
    start = commands.draw(KEY, jnp.zeros(3), jnp.array(10.0), CONFIG)
    _, currents = run(start, jnp.array(1.0), lambda v: v, 1500)
    currents = np.asarray(currents)
    rates = np.abs(np.diff(currents, axis=0)) / specs.CONTROL_STEP
    assert np.all(rates[:, 0] <= CONFIG.acceleration[1] * 1.001)
    assert np.all(rates[:, 1:] <= CONFIG.turn_acceleration * 1.001)
    assert np.ptp(currents[:, 0]) > 1.0  # it did move


def segment(target: float) -> commands.CommandState:
    start = commands.draw(KEY, None, jnp.array(3.0), CONFIG)
    there = jnp.array([target, 0.0, 0.0])
    return start.replace(current=there, target=there, time_left=jnp.array(0.1))


@pytest.mark.parametrize(
    ("target", "lag", "raised"),
    [(2.9, 0.0, True), (2.9, 0.4, True), (2.9, 0.6, False), (0.5, 0.0, False)],
    ids=["tracked", "within tolerance 0.12 x 3.9 = 0.47", "beyond tolerance", "far below the limit"],
)
def test_a_level_rises_only_when_a_command_near_its_limit_was_tracked(target, lag, raised):
    levels, _ = run(segment(target), jnp.array(0.0), lambda v: v - lag, 30)
    assert levels[-1] == pytest.approx(CURRICULUM.raise_by if raised else 0.0)


@pytest.mark.parametrize(
    ("group", "changes", "named"),
    [
        ("commands", {"max_forward": -1.0}, "max_forward"),
        ("commands", {"acceleration": (3.0, 1.0)}, "acceleration"),
        ("commands", {"straight_fraction": 1.5}, "straight_fraction"),
        ("curriculum", {"start_speed": 0.0}, "start_speed"),
        ("randomization", {"latency": (0.0, 0.05)}, "latency"),
        ("randomization", {"friction": (1.0, 0.5)}, "friction"),
        ("control", {"action_scale": 0.0}, "action_scale"),
        ("reset", {"standing_fraction": -0.1}, "standing_fraction"),
    ],
)
def test_impossible_settings_are_refused_by_name(group, changes, named):
    with pytest.raises(UserError, match=named):
        EnvConfig(**{group: dataclasses.replace(getattr(EnvConfig(), group), **changes)})
