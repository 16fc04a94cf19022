"""The bench against environments whose duration is known, because they sleep."""

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from aim import TINY, Aim

from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning.ppo import PPO
from bp2_rl.robot.bp2 import STAND_JOINTS
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.presets import preset
from bp2_rl.tools import throughput
from bp2_rl.tools.throughput import (
    COMPILED,
    PARTS,
    BenchPart,
    TooManyRobotsError,
    compilations,
    make_parts,
    share_out,
    time_part,
    time_parts,
)

STEP, RESET = 0.012, 0.04  # s, of the whole fleet
LENGTH = TINY.unroll_length
ONE = jax.devices()[:1]


class Sleepy(Aim):
    """Environment that takes a known time, all robots together, to step and to
    begin."""

    def reset(self, rng):
        state: Any = super().reset(rng)
        return state.replace(obs=sleep(RESET, state.obs))

    def step(self, state, action):
        state = super().step(state, action)
        return state.replace(obs=sleep(STEP, state.obs))


def sleep(seconds, x):
    def wait(x):
        time.sleep(seconds)
        return np.asarray(x)

    return jax.pure_callback(
        wait, jax.ShapeDtypeStruct(x.shape, x.dtype), x, vmap_method="broadcast_all"
    )


@pytest.fixture(scope="module")
def sleepy():
    return list(time_parts(lambda robots: Sleepy(), TINY, ONE, seconds=0.6))


def test_every_part_is_measured_in_order(sleepy):
    assert [m.part for m in sleepy] == [part for part in PARTS if part != "physics"]


@pytest.mark.parametrize(
    ("part", "seconds"),
    [
        ("environment", RESET + LENGTH * STEP),
        ("resets", RESET),
        ("training", RESET + LENGTH * STEP),
    ],
)
def test_times_are_those_that_the_environment_sleeps(sleepy, part, seconds):
    measured = next(m for m in sleepy if m.part == part)
    # A sleep is never shorter than asked for; what else there is takes about a
    # millisecond on an idle machine.
    assert seconds <= measured.best_seconds <= 1.5 * seconds
    assert measured.best_seconds <= measured.seconds
    assert measured.control_steps_per_second == pytest.approx(
        16 * LENGTH / measured.seconds
    )
    assert measured.physics_steps_per_second == pytest.approx(
        5 * measured.control_steps_per_second
    )


def test_repeats_fill_the_time_given_and_what_does_not_sleep_is_fast(sleepy):
    repeats = {m.part: m.repeats for m in sleepy}
    # 0.6 s of calls, each at least as long as its sleep; a busy machine fits in fewer.
    assert 3 <= repeats["environment"] <= 1 + 0.6 / (RESET + LENGTH * STEP)
    assert 5 <= repeats["resets"] <= 1 + 0.6 / RESET
    assert repeats["resets"] < repeats["policy"] <= throughput.MOST
    seconds = {m.part: m.best_seconds for m in sleepy}
    assert max(seconds["policy"], seconds["sgd"]) < 0.5 * STEP


def test_shares_of_a_train_step_add_up(sleepy):
    shares = share_out(sleepy)
    assert sum(shares.values()) == pytest.approx(1.0)
    whole = RESET + LENGTH * STEP
    assert shares["resets"] == pytest.approx(RESET / whole, abs=0.1)
    assert shares["rest of the environment"] == pytest.approx(
        LENGTH * STEP / whole, abs=0.1
    )
    assert share_out([m for m in sleepy if m.part != "sgd"]) == {}


def test_nothing_compiles_while_it_is_timed(sleepy):
    for m in sleepy:
        assert m.compilations == 0
        assert min(m.compile_seconds, m.trace_seconds) > 0


def test_a_program_is_compiled_once_to_be_timed_and_called():
    add = jax.jit(lambda x: (x + 1.0, ()))
    learner, x = PPO(Aim(), TINY, ONE), jnp.zeros(3)
    with compilations() as compiled:
        time_part(BenchPart("policy", add, (x,), goes_on=True), learner, 1e-9)
    assert compiled[COMPILED] == 1


def test_a_program_that_compiles_at_every_call_is_caught():
    grow = jax.jit(lambda x: (jnp.append(x, 0.0), ()))
    measured = time_part(
        BenchPart("policy", grow, (jnp.zeros(1),), goes_on=True),
        PPO(Aim(), TINY, ONE),
        1e-9,
    )
    assert measured.compilations >= measured.repeats == throughput.FEWEST


def test_memory_is_that_of_the_arrays():
    add = jax.jit(lambda x, y: (x + y, ()))
    x = jnp.zeros(1000)
    measured = time_part(BenchPart("policy", add, (x, x)), PPO(Aim(), TINY, ONE), 1e-9)
    # Two arguments and one result, 4 bytes a number; the rest is bookkeeping.
    assert measured.program_bytes is not None
    assert measured.program_bytes == pytest.approx(3 * 4000, abs=64)


def test_gradient_steps_are_timed_on_data_like_the_learners():
    learner = PPO(Aim(), TINY, ONE)
    state = learner.init(0)
    *_, sgd = make_parts(learner, state, ["sgd"])
    ours = sgd.arguments[1]
    keys = jax.random.split(jax.random.PRNGKey(0), TINY.num_envs)
    _, theirs, _ = jax.eval_shape(
        learner.unroll, state.params, state.normalizer, state.fleet, keys
    )
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), ours) == jax.tree.map(
        lambda x: (x.shape, x.dtype), theirs
    )
    params, _, metrics = sgd.program(*sgd.arguments)
    assert all(np.isfinite(value) for value in metrics.values())
    assert any(
        np.any(a != b)
        for a, b in zip(*map(jax.tree.leaves, (params, state.params)), strict=True)
    )


def test_the_physics_alone_runs_an_unroll_of_every_robot(monkeypatch):
    """With a simulation that only counts its control steps, and keeps the targets that
    it was given."""

    def simulate(physics, targets, robot):
        held = jax.tree.map(
            lambda before, now: before.at[0].set(now), physics.targets, targets
        )
        return physics.replace(qvel=physics.qvel + 1, targets=held), None, None

    env = BP2Env(EnvConfig())
    monkeypatch.setattr(env, "engine", simulate)
    config = dataclasses.replace(preset("imitation", "smoke").ppo, num_envs=8)
    learner = PPO(env, config, ONE)
    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), learner.shape)
    (part,) = make_parts(learner, state, ["physics"])
    after = part.program(*part.arguments)
    np.testing.assert_array_equal(after.qvel, np.full((8, 22), config.unroll_length))
    # Without command or action the joints are to stay near the stand: rad, a trot's
    # sweep on the spot.
    np.testing.assert_allclose(
        after.targets.position[:, 0], np.tile(STAND_JOINTS, (8, 1)), atol=0.6
    )


def test_memory_that_runs_out_ends_a_size_and_keeps_what_was_measured():
    class Huge(Aim):
        def step(self, state, action):
            # 2^46 numbers
            rows = jnp.outer(jnp.ones(1 << 24) * action, jnp.ones(1 << 22))
            return super().step(state, action + jnp.sort(rows, axis=0)[0, 0])

    timings = time_parts(lambda robots: Huge(), TINY, ONE, ["resets", "training"], 0.01)
    assert next(timings).part == "resets"
    with pytest.raises(TooManyRobotsError, match=r"^out of memory$"):
        next(timings)


def test_other_failures_are_not_taken_for_a_lack_of_memory():
    class Failing(Aim):
        def step(self, state, action):
            def fail(x):
                raise ArithmeticError("wrong")

            shape = jax.ShapeDtypeStruct(action.shape, action.dtype)
            obs = jax.pure_callback(fail, shape, action, vmap_method="broadcast_all")
            return super().step(state, action).replace(obs=obs)

    with pytest.raises(jax.errors.JaxRuntimeError, match="wrong"):
        next(time_parts(lambda robots: Failing(), TINY, ONE, ["environment"]))
