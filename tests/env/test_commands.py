"""Commands stay in range, move at limited rates, and the curriculum moves only on
evidence."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.env import commands
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.controller import motion_of
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec, Losses
from bp2_rl.settings.env import (
    CommandConfig,
    ControlConfig,
    CurriculumConfig,
    EnvConfig,
    TrackingShape,
)

CONFIG = CommandConfig(max_forward=10.0, max_backward=1.0)
# at level 0 commands from 2.7 m/s on are near the limit
CURRICULUM = CurriculumConfig(start_speed=3.0)
AT_ONCE, GENTLY = ControlConfig(), ControlConfig(braking=4.0, stopping_time=0.9)
SETTINGS = EnvConfig(commands=CONFIG, curriculum=CURRICULUM, control=AT_ONCE)
LAUNCHED = ControlConfig(launching=6.0, launching_speed=18.0)
KEY = jax.random.PRNGKey(0)


def test_targets_cover_their_ranges_and_respect_them():
    keys = jax.random.split(KEY, 20_000)
    targets = np.asarray(
        jax.vmap(lambda key: commands.draw_target(key, jnp.array(8.0), CONFIG))(keys)
    )
    forward, lateral, yaw_rate = targets.T
    assert -1.0 <= forward.min() < -0.95
    assert 7.95 < forward.max() <= 8.0
    assert 0.4 < np.abs(lateral).max() <= CONFIG.max_lateral
    assert 0.8 < np.abs(yaw_rate).max() <= CONFIG.max_yaw_rate
    standing = np.all(targets == 0.0, axis=1)
    straight = (lateral == 0.0) & (yaw_rate == 0.0) & ~standing
    # Binomial shares of 20 000 draws: a standard deviation is below 0.004.
    assert standing.mean() == pytest.approx(CONFIG.stand_fraction, abs=0.015)
    assert straight.mean() == pytest.approx(
        CONFIG.straight_fraction * (1 - CONFIG.stand_fraction), abs=0.015
    )
    # Of the targets drawn from anywhere in [-1, 8] m/s, 0.8 / 9 are in the fastest
    # tenth, too.
    fast = (1 - CONFIG.stand_fraction) * (
        CONFIG.limit_fraction + (1 - CONFIG.limit_fraction) * 0.8 / 9.0
    )
    assert (forward >= 0.9 * 8.0).mean() == pytest.approx(fast, abs=0.015)


def test_a_stand_lasts_as_long_as_is_said_for_stands():
    keys = jax.random.split(KEY, 2000)

    def times(config):
        drawn = jax.vmap(lambda key: commands.draw(key, None, jnp.array(8.0), config))(
            keys
        )
        return np.all(np.asarray(drawn.target) == 0.0, axis=1), np.asarray(
            drawn.time_left
        )

    often = dataclasses.replace(CONFIG, stand_fraction=0.5, hold_time=(1.0, 3.0))
    stands, time = times(dataclasses.replace(often, stand_time=(4.0, 6.0)))
    assert time[stands].min() == pytest.approx(4.0, abs=0.02)
    assert time[stands].max() == pytest.approx(6.0, abs=0.02)
    as_others, others = times(often)
    np.testing.assert_array_equal(as_others, stands)
    np.testing.assert_array_equal(others[~stands], time[~stands])
    assert others.max() <= 3.0


def test_the_fastest_command_rises_with_the_level_from_start_to_maximum():
    speeds = [
        float(commands.max_forward_at(jnp.array(level), SETTINGS))
        for level in (0.0, 0.5, 1.0)
    ]
    assert speeds == [3.0, 6.5, 10.0]
    # without a curriculum all commands come from the first step on
    config = EnvConfig()
    fastest = commands.max_forward_at(jnp.array(0.0), config)
    assert fastest == config.commands.max_forward


def run(state, level, tracking, steps, seed=1, config=SETTINGS):
    """Advance commands and level for `steps` control steps; `tracking(command)` is the
    robot's speed."""

    def step(carry, key):
        state, level = carry
        state, level = commands.advance(
            state, level, tracking(state.current[0]), key, config
        )
        return (state, level), (level, state.current)

    return jax.lax.scan(
        step, (state, level), jax.random.split(jax.random.PRNGKey(seed), steps)
    )[1]


RISING = EnvConfig(
    commands=CommandConfig(max_forward=13.0),
    curriculum=CurriculumConfig(start_speed=4.0),
)


def run_fleet(tracking, seconds, robots=32, config=RISING):
    """Return levels (robot, time) and commands (robot, time, 3) of robots that start at
    level 0 and never fall."""

    def one(seed):
        key = jax.random.PRNGKey(seed)
        start = commands.draw(
            key, None, jnp.array(config.curriculum.start_speed), config.commands
        )
        steps = round(seconds / conventions.CONTROL_STEP)
        return run(start, jnp.array(0.0), tracking, steps, seed, config)

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(jnp.arange(robots)))


def test_a_robot_that_cannot_run_faster_is_not_commanded_much_faster():
    """It runs at min(command, 5 m/s) without ever falling; slow commands, which it
    follows, must not count."""
    levels, _ = run_fleet(lambda command: jnp.minimum(command, 5.0), 120.0)

    def limit(level):
        return float(commands.max_forward_at(jnp.array(level), RISING))

    assert limit(levels.max()) <= 7.0
    assert limit(levels[:, -1].min()) > 5.0  # what it can run it is commanded


def test_a_robot_that_follows_every_command_reaches_the_top():
    levels, currents = run_fleet(lambda command: command, 300.0)
    assert np.all(levels[:, -1] == 1.0)
    assert currents[..., 0].max() > 0.98 * RISING.commands.max_forward


def test_no_command_asks_for_more_lateral_acceleration_than_max_turn():
    """Neither a target nor any command on the way from a fast straight one to a slow
    tight one."""
    config = RISING
    keys = jax.random.split(KEY, 20_000)
    targets = jax.vmap(
        lambda key: commands.draw_target(key, jnp.array(13.0), config.commands)
    )(keys)
    _, currents = run_fleet(lambda command: command, 200.0)
    for forward, _, yaw_rate in (np.asarray(targets).T, np.moveaxis(currents, -1, 0)):
        turn = np.abs(forward * yaw_rate)
        # float32
        assert (
            0.9 * config.commands.max_turn
            < turn.max()
            <= config.commands.max_turn * (1 + 1e-6)
        )


def test_the_hold_time_counts_from_reaching_the_target():
    """Of 1 m/s2 to a target 2.7 m/s away and a hold of 0.1 s, the next draw is 2.8 s
    off."""
    state = segment(2.7).replace(current=jnp.zeros(3), acceleration=jnp.array(1.0))
    _, currents = run(state, jnp.array(0.0), lambda v: v, 600)
    forward = np.asarray(currents)[:, 0]
    there = np.flatnonzero(forward == np.float32(2.7))
    # Each side of the interval may be off by the step in which the float32 sum of
    # increments gets there.
    assert there[0] == pytest.approx(2.7 / conventions.CONTROL_STEP, abs=2)
    assert there[-1] - there[0] == pytest.approx(0.1 / conventions.CONTROL_STEP, abs=2)


def test_commands_move_no_faster_than_their_rates():
    start = commands.draw(KEY, jnp.zeros(3), jnp.array(10.0), CONFIG)
    _, currents = run(start, jnp.array(1.0), lambda v: v, 1500)
    currents = np.asarray(currents)
    rates = np.abs(np.diff(currents, axis=0)) / conventions.CONTROL_STEP
    assert np.all(rates[:, 0] <= CONFIG.acceleration[1] * 1.001)
    assert np.all(rates[:, 1:] <= CONFIG.turn_acceleration * 1.001)
    assert np.ptp(currents[:, 0]) > 1.0  # it did move


def told(asked, start, control=GENTLY, seconds=6.0):
    """Return the forward command that a policy observes at each control step, under a
    constant wish."""

    def step(command, _):
        after = control.tell(command, jnp.array([asked, 0.1, 0.2]))
        return after, after

    steps = round(seconds / conventions.CONTROL_STEP)
    seen = np.asarray(jax.lax.scan(step, jnp.array([start, 0.0, 0.0]), length=steps)[1])
    assert np.all(seen[:, 1:] == np.array([0.1, 0.2], np.float32))
    return np.append(start, seen[:, 0]).astype(np.float32)


def test_a_stop_is_a_ramp_and_then_an_exponential():
    """From 10 m/s at 4 m/s2 to 3.1 m/s, as (3.1 + 0.5) / 0.9 s is 4 m/s2; from there
    0.5 + v = 3.6 exp(-t / 0.9)."""
    forward = told(0.0, 10.0)
    time = conventions.CONTROL_STEP * np.arange(len(forward))
    ramp, end = 6.9 / 4.0, 0.9 * np.log(3.6 / 0.5)
    law = np.where(
        time < ramp, 10.0 - 4.0 * time, 3.6 * np.exp(-(time - ramp) / 0.9) - 0.5
    )
    # Euler's steps of 5 ms in a time constant of 0.9 s are 0.3 % of a speed off, at
    # most.
    np.testing.assert_allclose(
        forward[time < ramp + end], law[time < ramp + end], atol=0.011
    )
    assert np.all(forward[time > ramp + end + 0.02] == 0.0)


def test_a_launch_is_an_exponential():
    """At 6 m/s2 from a stand, and towards 18 m/s: v = 18 (1 - exp(-6 t / 18))."""
    forward = told(12.0, 0.0, LAUNCHED)
    law = 18.0 * (
        1.0 - np.exp(-conventions.CONTROL_STEP * np.arange(len(forward)) / 3.0)
    )
    # Euler's steps, as above
    np.testing.assert_allclose(forward, np.minimum(law, 12.0), atol=0.011)
    assert forward[-1] == 12.0
    constant = told(12.0, 0.0, ControlConfig(launching=6.0))
    np.testing.assert_allclose(
        constant, np.minimum(0.03 * np.arange(len(constant)), 12.0), atol=1e-4
    )


@pytest.mark.parametrize(
    ("control", "asked", "before", "after"),
    [
        # only what takes speed from a robot on its way forward is eased
        (GENTLY, 9.0, 2.0, 9.0),
        (GENTLY, -1.0, 0.0, -1.0),
        (GENTLY, 2.0, -1.0, 2.0),
        (GENTLY, 9.99, 10.0, 9.99),  # slower than it may be
        (AT_ONCE, 0.0, 10.0, 0.0),
        # only what gives speed to a robot on its way forward is launched
        (LAUNCHED, 3.0, 10.0, 3.0),
        (LAUNCHED, 25.0, 20.0, 20.0),  # faster than it would rise to
        (LAUNCHED, 5.01, 5.0, 5.01),  # slower than it may be
        # who goes backwards may be stopped at once
        (LAUNCHED, 9.0, -1.0, 0.03),
        (LAUNCHED, -1.0, 0.0, -1.0),
    ],
)
def test_a_command_is_eased_or_launched_only_on_the_way_forward(
    control, asked, before, after
):
    assert told(asked, before, control)[1] == np.float32(after)


def test_a_command_backwards_is_eased_until_the_stand():
    back = told(-1.0, 1.0)
    falls = -np.diff(back[back > 0.0]) / conventions.CONTROL_STEP
    assert falls.max() <= 4.001
    assert back[-1] == -1.0


@pytest.mark.parametrize(
    ("control", "beyond_by", "tolerance"),
    [
        # m/s2 that a command changes faster than its law has it, now (m/s)
        (
            GENTLY,
            lambda now, change: -change - np.minimum(4.0, (now + 0.5) / 0.9),
            1e-3,
        ),
        (LAUNCHED, lambda now, change: change - 6.0 * (1.0 - now / 18.0), 1e-2),
    ],
)
def test_in_training_commands_are_eased_and_launched_likewise(
    control, beyond_by, tolerance
):
    """In 30 s, in which they change faster where nothing eases them."""
    start, beyond = commands.draw(KEY, jnp.zeros(3), jnp.array(10.0), CONFIG), []
    for law in (AT_ONCE, control):
        config = dataclasses.replace(SETTINGS, control=law)
        _, currents = run(start, jnp.array(1.0), lambda v: v, 6000, config=config)
        forward = np.asarray(currents)[:, 0]
        now, change = forward[:-1], np.diff(forward) / conventions.CONTROL_STEP
        ahead = now > 0.0 if control is GENTLY else now >= 0.0
        beyond.append(np.max(beyond_by(now, change)[ahead]))
    assert beyond[0] > 0.5
    assert beyond[1] <= tolerance


def segment(target: float, hold: float = 0.1) -> commands.CommandState:
    start = commands.draw(KEY, None, jnp.array(3.0), CONFIG)
    there = jnp.array([target, 0.0, 0.0])
    return start.replace(current=there, target=there, time_left=jnp.array(hold))


@pytest.mark.parametrize(
    ("target", "hold", "lag", "raised"),
    [
        (2.8, 0.6, 0.0, True),
        (2.8, 0.6, 0.39, True),
        (2.8, 0.6, 0.41, False),
        (2.8, 0.4, 0.0, False),
        (2.6, 0.6, 0.0, False),
    ],
    ids=[
        "tracked",
        "within tolerance 0.1 x (1 + 3) = 0.4",
        "beyond tolerance",
        "too short",
        "far below the limit",
    ],
)
def test_a_level_rises_only_when_commands_near_its_limit_were_tracked_for_long_enough(
    target, hold, lag, raised
):
    # Until shortly after the hold, so that what was drawn next does not count.
    levels, _ = run(
        segment(target, hold),
        jnp.array(0.0),
        lambda v: v - lag,
        round(hold / conventions.CONTROL_STEP) + 5,
    )
    assert levels[-1] == pytest.approx(CURRICULUM.raise_by if raised else 0.0)


NAN, INF = float("nan"), float("inf")


def test_a_latency_beyond_what_training_remembers_is_refused():
    with pytest.raises(
        UserError,
        match=r"^hardware\.losses\.latency \(0\.015 s\) must be at most 0\.01 s in training",
    ):
        BP2Env(EnvConfig(hardware=HardwareSpec(losses=Losses(latency=0.015))))


def test_a_reference_below_the_height_of_a_fall_is_refused_by_name():
    config = EnvConfig(
        termination=dataclasses.replace(EnvConfig().termination, min_height=0.7)
    )
    with pytest.raises(
        UserError,
        match=r"^termination.min_height \(0.7\) must be below the reference's height",
    ):
        motion_of(config)


@pytest.mark.parametrize(
    ("named", "value"),
    [
        ("commands.max_forward", -1.0),
        ("commands.max_forward", INF),
        ("commands.max_turn", -1.0),
        ("commands.acceleration", (3.0, 1.0)),
        ("commands.acceleration", (1.0, INF)),
        ("commands.hold_time", (0.0, 0.0)),
        ("commands.stand_time", (2.0, 1.0)),
        ("commands.straight_fraction", 1.5),
        ("commands.limit_fraction", -0.5),
        ("control.action_scale", 0.0),
        ("control.action_limit", -1.0),
        ("control.launching", 0.0),
        ("control.launching_speed", 18.0),  # says nothing without control.launching
        ("control.torque_rate", -1.0),
        ("control.torque_rate", -INF),
        ("curriculum.start_speed", 0.0),
        ("curriculum.start_speed", 16.0),
        ("curriculum.tolerance", -1.0),
        ("curriculum.raise_by", NAN),
        ("curriculum.near", 1.0),
        ("hardware.rotor_inertia", 1e308),
        ("hardware.rebound_damping", 1000.0),
        ("hardware.losses.current_lag", -1.0),
        ("hardware.losses.gear_efficiency", 0.0),
        ("hardware.losses.latency", 0.05),
        ("randomization.friction", (0.0, 0.0)),
        ("randomization.friction", (1.0, 0.5)),
        ("randomization.armature", (0.0, 1.0)),
        ("randomization.no_load_speed", (1.2, 0.8)),
        ("randomization.spring_damping", (-1.0, 1.0)),
        ("randomization.spring_stiffness", (1.0, INF)),
        ("randomization.joint_velocity_noise", NAN),
        ("randomization.latency", (0.0, 0.05)),
        ("randomization.push_interval", 0.0),
        ("reset.standing_fraction", -0.1),
        ("reward.imitation", NAN),
        ("reward.tracking_shape", TrackingShape(width=0.0)),
        ("termination.min_up", 5.0),
        ("termination.max_speed", INF),
    ],
)
def test_impossible_settings_are_refused_by_name(named, value):
    with pytest.raises(UserError, match=rf"^{named}\b.*") as error:
        changed(EnvConfig(), named.split("."), value)
    assert "\n" not in str(error.value)


def changed(settings, path, value):
    """Return the settings with another value of the field at the end of a path."""
    field, *deeper = path
    if deeper:
        value = changed(getattr(settings, field), deeper, value)
    return dataclasses.replace(settings, **{field: value})


def test_what_has_a_meaning_when_infinite_may_be():
    for path in ("control.torque_rate", "reward.tracking_shape.width"):
        changed(EnvConfig(), path.split("."), INF)
