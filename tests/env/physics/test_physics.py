"""The physics engines: the kernel and Warp against MJX."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.cli.train import read_arguments
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.physics.interface import TARGET_AGES, newest_active
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.settings.env import (
    EnvConfig,
    Impl,
    RandomizationConfig,
    TerminationConfig,
)

ROBOTS, STEPS = 64, 100
KEYS = jax.random.split(jax.random.PRNGKey(0), ROBOTS)
ACTIONS = 0.1 * jax.random.normal(jax.random.PRNGKey(1), (STEPS, ROBOTS, 12))
"""Small departures from the reference: every robot trots at its own speed of up to 4
m/s."""

VARIED = RandomizationConfig(
    no_load_speed=(0.7, 1.3),
    armature=(0.5, 2.0),
    spring_stiffness=(0.7, 1.4),
    spring_damping=(0.5, 10.0),
)

# contacts in the critic's observation
FEET = slice(47 + 3 + 1 + 4 + 4, 47 + 3 + 1 + 4 + 4 + 4)


@pytest.fixture(params=["kernel", "warp"])
def impl(request, monkeypatch) -> Impl:
    """Name of every engine but MJX's own. Warp is for GPUs, but its kernels run on
    processors, too."""
    if request.param == "warp":
        pytest.importorskip("warp", reason="needs the extra `warp`")
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    return request.param


@cache
def stepper(impl: Impl):
    return jax.jit(jax.vmap(BP2Env(EnvConfig(), impl=impl, num_robots=ROBOTS).step))


@cache
def start():
    """Return the state in which robots of varied designs start."""
    return jax.jit(jax.vmap(BP2Env(EnvConfig(randomization=VARIED)).reset))(KEYS)


def run(impl: Impl, state):
    """Step a state with all `ACTIONS`; return the states before and after, and which
    robots were upright before each step."""
    states, upright = [state], [np.ones(ROBOTS, bool)]
    for action in ACTIONS:
        states.append(stepper(impl)(states[-1], action))
        upright.append(upright[-1] & (np.asarray(states[-1].done) == 0.0))
    return states, np.array(upright)


@cache
def reference_run():
    return run("jax", start())


def physics(state):
    return state.pipeline_state.physics


def apart(ours, theirs, field: str) -> np.ndarray:
    """Return the largest difference between two states' field, for each robot."""
    a, b = (np.asarray(getattr(physics(state), field)) for state in (ours, theirs))
    return np.abs(a - b).reshape(ROBOTS, -1).max(axis=1)


def test_every_engine_takes_the_same_step_from_the_same_state(impl):
    """Over 100 control steps of a trot, started anew each time from where MJX stands.

    99 of 100 differ by float32's rounding: of positions of 1 m, of speeds of 10 rad/s
    and accelerations of 10^4 over 1 ms, and of the 250 Nm/rad of the joints. In a few,
    at impacts, MJX's five iterations do not converge.
    """
    engine = stepper(impl)
    states, upright = reference_run()
    differences = {"qpos": [], "qvel": [], "torque": []}
    feet = []
    for before, after, action, up in zip(
        states, states[1:], ACTIONS, upright, strict=False
    ):
        ours = engine(before, action)
        for field, found in differences.items():
            found.extend(apart(ours, after, field)[up])
        seen, expected = (
            np.asarray(state.obs["privileged_state"])[up, FEET]
            for state in (ours, after)
        )
        feet.extend(np.all(seen == expected, axis=1).tolist())
    assert len(feet) > 0.9 * STEPS * ROBOTS
    # m and rad, m/s and rad/s, Nm
    for field, usual, largest in (
        ("qpos", 2e-6, 2e-3),
        ("qvel", 3e-4, 2.0),
        ("torque", 1e-3, 5.0),
    ):
        assert np.quantile(differences[field], 0.99) < usual, field
        assert np.max(differences[field]) < largest, field
    assert np.mean(feet) > 0.999


def test_engines_drift_apart_slowly(impl):
    """Contact makes rounding grow; half a second into the trot it is still far below
    what a policy would notice."""
    (theirs, up), (ours, ours_up) = reference_run(), run(impl, start())
    for steps, usual in ((1, 1e-6), (10, 1e-5), (100, 1e-4)):
        both = up[steps] & ours_up[steps]
        assert np.median(apart(ours[steps], theirs[steps], "qpos")[both]) < usual
    assert np.quantile(apart(ours[-1], theirs[-1], "qpos")[both], 0.9) < 0.01
    assert np.sum(up[-1] != ours_up[-1]) <= 1


def test_latency_chooses_the_newest_target_that_has_got_through():
    """Targets are issued every 5 ms, and a physics step takes 1 ms."""
    latency = np.array([0.0, 0.001, 0.003, 0.005, 0.006, 0.010])
    chosen = [
        [0, 1, 1, 1, 2, 2],
        [0, 0, 1, 1, 1, 2],
        [0, 0, 1, 1, 1, 2],
        [0, 0, 0, 1, 1, 2],
        [0, 0, 0, 1, 1, 2],
    ]
    assert [list(newest_active(ages, latency)) for ages in TARGET_AGES] == chosen
    assert [
        list(newest_active(jnp.asarray(ages), jnp.asarray(latency)))
        for ages in TARGET_AGES
    ] == chosen


SOLID = EnvConfig(
    hardware=IDEAL.changed(hind_track=0.28, solid_legs=True),
    termination=TerminationConfig(max_overlap=0.005),
)


@cache
def crossed():
    """Return a state in which robot 3 stands with crossed fore legs and no other
    robot's legs touch."""
    env = BP2Env(SOLID)
    state = jax.jit(jax.vmap(env.reset))(KEYS)
    legs = (
        physics(state)
        .qpos.at[3]
        .set(
            env.starts.at_rest().qpos.at[jnp.array([7, 11])].set(jnp.array([0.4, -0.4]))
        )
    )
    still = physics(state).qvel.at[3].set(0.0)
    tangle = state.pipeline_state.replace(
        physics=physics(state).replace(qpos=legs, qvel=still)
    )
    return state.replace(pipeline_state=tangle)


def assert_self_collision(engine: Impl):
    step = jax.jit(jax.vmap(BP2Env(SOLID, impl=engine, num_robots=ROBOTS).step))
    after = step(crossed(), jnp.zeros((ROBOTS, 12)))
    np.testing.assert_array_equal(
        np.flatnonzero(after.metrics["fall/self_collision"]), [3]
    )
    assert after.done[3] == 1.0


def test_legs_in_each_other_end_an_episode_whoever_simulates_it(impl):
    assert_self_collision(impl)
    assert "fall/self_collision" not in start().metrics


def test_legs_in_each_other_end_an_episode_in_mjx():
    assert_self_collision("jax")


def test_the_large_presets_train_in_our_kernel_unless_told_otherwise():
    assert (
        read_arguments(["--preset", "cpu"]).impl
        == read_arguments(["--preset", "gpu"]).impl
        == "kernel"
    )
    assert (
        read_arguments(["--preset", "gpu", "--impl", "jax"]).impl
        == read_arguments(["--preset", "smoke"]).impl
        == "jax"
    )
